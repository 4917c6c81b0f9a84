"""MATLAB, Parquet and HDF5 files are read in a process of their own: what ends it is one line of an
error."""

import os
import resource
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign import compiled_readers
from elastic_arm.recording.foreign.array_files import load_arrays


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run.mat"
    scipy.io.savemat(
        path,
        {
            "q": np.arange(6.0).reshape(3, 2),
            "s": {"x": {"y": 3.0}},
            "c": np.array([1, "a"], object),
        },
    )
    return path


def test_arrays_and_fields_of_structs_come_back(file: Path) -> None:
    """As SciPy reads them; cells are there but hold no numbers."""
    found = load_arrays(file)
    np.testing.assert_array_equal(found["q"], np.arange(6.0).reshape(3, 2))
    assert found["s.x.y"].item() == 3.0
    assert found["c"].dtype.kind == "U"


def test_a_file_that_ends_its_reader_is_refused_in_one_line(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signal is named; this process lives."""
    crash = file.with_name("crash.py")
    crash.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    monkeypatch.syspath_prepend(str(crash.parent))
    monkeypatch.setattr(compiled_readers, "MODULE", "crash")
    with pytest.raises(RecordingError, match="SIGSEGV") as refused:
        load_arrays(file)
    assert "\n" not in str(refused.value)


def test_modules_beside_the_files_are_not_run(file: Path) -> None:
    """A folder of data may hold a numpy.py: reading in it runs nothing of it."""
    file.with_name("numpy.py").write_text("raise SystemExit('owned')")
    script = (
        "import sys; from elastic_arm.recording.foreign.array_files import load_arrays; from"
        " pathlib import Path; "
    )
    script += "print(load_arrays(Path('run.mat'))['q'].sum())"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-P", "-c", script]
    done = subprocess.run(
        command, cwd=file.parent, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "15.0", done.stderr


def test_claimed_sizes_do_not_take_this_process_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An array that claims 400 MB, with 100 allowed, is refused, and nothing of it was taken
    here."""
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "100")
    header = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
    size = 400_000_000
    flags = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1, size // 8)
    name = struct.pack("<HH4s", 1, 1, b"q\0\0\0")
    content = flags + name + struct.pack("<II", 9, size)
    path = tmp_path / "claims.mat"
    path.write_bytes(header + struct.pack("<II", 14, len(content) + size) + content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError, match=r"claims\.mat cannot be read"):
        load_arrays(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


def test_a_reader_that_never_ends_is_ended(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the time on the clock that a file of this size may take."""
    sleep = file.with_name("sleep.py")
    sleep.write_text("import time\ntime.sleep(60)\n")
    monkeypatch.syspath_prepend(str(sleep.parent))
    monkeypatch.setattr(compiled_readers, "MODULE", "sleep")
    monkeypatch.setattr(compiled_readers, "START_SECONDS", 1)
    monkeypatch.setattr(compiled_readers, "PATIENCE", 1)
    with pytest.raises(RecordingError, match="takes longer than 1 s"):
        load_arrays(file)


def test_a_file_is_read_where_the_user_s_own_limit_is_lower(tmp_path: Path) -> None:
    """A shell that allows a process less memory than the reader would take (ulimit -v) still reads
    files."""
    scipy.io.savemat(tmp_path / "a.mat", {"q": np.arange(3.0)})
    script = (
        "import sys; from elastic_arm.recording.foreign.array_files import load_arrays; from"
        " pathlib import Path; "
    )
    script += "print(load_arrays(Path(sys.argv[1]))['q'].sum())"
    command = ["bash", "-c", 'ulimit -v 5000000; exec "$@"', "bash", sys.executable, "-c", script]
    command.append(str(tmp_path / "a.mat"))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "3.0", done.stderr


@pytest.mark.parametrize("name", ["run.parquet", "run.h5"])
def test_damaged_bytes_end_in_one_line_and_never_this_process(tmp_path: Path, name: str) -> None:
    """Five files with bytes changed at random, as episodes of a dataset: what their libraries abort
    on is named."""
    pa, pq, h5py = (
        pytest.importorskip(library) for library in ("pyarrow", "pyarrow.parquet", "h5py")
    )
    numbers = np.arange(60.0).reshape(30, 2)
    if name.endswith("h5"):
        with h5py.File(tmp_path / name, "w") as file:
            file["q"] = numbers
            file["t"] = numbers[:, 0]
    else:
        pq.write_table(pa.table({"q": numbers.tolist(), "t": numbers[:, 0]}), tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    rng = np.random.default_rng(0)
    (tmp_path / name).unlink()
    for k in range(5):
        content = bytearray(whole)
        for at in rng.integers(len(whole), size=6):
            content[at] = rng.integers(256)
        (tmp_path / f"{k}_{name}").write_bytes(content)
    for source in (tmp_path, *sorted(tmp_path.iterdir())):
        try:
            load_arrays(source)
        except RecordingError as refused:
            assert "\n" not in str(refused)
