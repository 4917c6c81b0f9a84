"""Arrays and tables that are damaged, hidden or not what they claim: one line each."""

import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import write_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.foreign.compiled_readers import LIBRARIES

MAP = "joints: [a, b]\ntimes: {key: t, unit: %s}\nlink: {position: {key: q%s}}\n"


def imported(tmp_path: Path, unit: str = "s", more: str = "", **arrays: np.ndarray) -> object:
    """Write arrays and a mapping, and import them."""
    given = {"t": np.arange(5.0), "q": np.arange(10.0).reshape(5, 2), **arrays}
    np.savez(tmp_path / "a.npz", **given)
    (tmp_path / "map.yaml").write_text(MAP % (unit, more))
    return import_arrays(tmp_path / "a.npz", tmp_path / "map.yaml")


def refused(tmp_path: Path, unit: str = "s", more: str = "", **arrays: np.ndarray) -> str:
    """Return the line of the refusal."""
    with pytest.raises(RecordingError) as caught:
        imported(tmp_path, unit, more, **arrays)
    assert len(str(caught.value)) < 2300
    return str(caught.value)


@pytest.mark.parametrize("kind", [np.float64, np.int64, np.uint64])
def test_times_beyond_the_stamps_of_ros_are_refused(tmp_path: Path, kind: type) -> None:
    """Stamps of ROS have 32 bits of seconds: later times would wrap to the past."""
    late = (np.arange(5) + 2**31).astype(kind)
    assert "2038" in refused(tmp_path, t=late)
    assert "2038" in refused(tmp_path, "ms", t=(late * 1000).astype(kind))
    assert imported(tmp_path, t=(np.arange(5) + 2**31 - 10).astype(kind))


def test_a_recording_beyond_the_stamps_of_ros_is_not_written(tmp_path: Path) -> None:
    """Nor is one that began before and ends after."""
    recording = imported(tmp_path, t=np.arange(5.0) + 2**31 - 5)
    later = type(recording)(
        recording.joints,
        type(recording.link)(recording.link.stamp_ns + 10**9, recording.link.position),
    )  # type: ignore[attr-defined]
    with pytest.raises(RecordingError, match="2038"):
        write_recording(tmp_path / "bag", later)
    assert not (tmp_path / "bag").exists()


def test_a_million_names_are_cut(tmp_path: Path) -> None:
    """An error that would list every array shows the first and the last ones."""
    (tmp_path / "map.yaml").write_text(MAP % ("s", ""))
    (tmp_path / "a.csv").write_text(
        ",".join(f"name_{i}" for i in range(100_000)) + "\n" + ",".join(["1"] * 100_000)
    )
    with pytest.raises(RecordingError) as caught:
        import_arrays(tmp_path / "a.csv", tmp_path / "map.yaml")
    assert len(str(caught.value)) < 2300


HEAD = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1125899906842624,), }"
FILES: dict[str, tuple[str, bytes, str]] = {
    "2^50 numbers": (
        "a.npy",
        b"\x93NUMPY\x01\x00" + bytes([len(HEAD), 0]) + HEAD + bytes(100),
        "cannot be read",
    ),
    "two columns of one name": ("a.csv", b"t,q,q\n1,2,3\n", "two columns are called 'q'"),
    "names and comments alone": ("a.csv", b"t,q\n# none\n", "no numbers below the first line"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("what", FILES)
def test_files_that_hold_no_arrays_are_refused(tmp_path: Path, what: str) -> None:
    """Nothing is allocated for a head that claims it, no column is lost, and no library warns."""
    name, content, words = FILES[what]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        load_arrays(tmp_path / name)


def changed_zip(path: Path, at: int, value: int) -> None:
    """Change a field of two bytes in the local head and in the directory of a zip file."""
    content = bytearray(path.read_bytes())
    for mark, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        place = content.find(mark) + at + shift
        content[place : place + 2] = value.to_bytes(2, "little")
    path.write_bytes(content)


def test_encrypted_and_strangely_packed_arrays_are_told_apart(tmp_path: Path) -> None:
    """Neither is called a MATLAB file."""
    for at, value, words in ((6, 1, "is encrypted"), (8, 9, "compression method is not supported")):
        np.savez(tmp_path / "a.npz", t=np.arange(5.0))
        changed_zip(tmp_path / "a.npz", at, value)
        with pytest.raises(RecordingError, match=words):
            load_arrays(tmp_path / "a.npz")


def test_a_zip_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What unpacks to more than the limit is not unpacked."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(5_000_000))
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "2")
    with pytest.raises(RecordingError, match="the limit is 2000000"):
        load_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".csv", ".mat", ".parquet", ".h5"])
def test_damaged_files_are_refused(tmp_path: Path, suffix: str) -> None:
    """Every kind of file, cut at every place of its beginning, ends in one line."""
    whole = tmp_path / "whole.npz"
    np.savez(whole, t=np.arange(50.0))
    cuts = [0, 1, 5, 30, 80, 200, len(whole.read_bytes()) - 1]
    if suffix in LIBRARIES:
        cuts = [0, 30, cuts[-1]]  # each takes a process
    for cut in cuts:
        (tmp_path / f"a{suffix}").write_bytes(whole.read_bytes()[:cut])
        with pytest.raises(RecordingError, match="cannot be read"):
            load_arrays(tmp_path / f"a{suffix}")


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    """A table without end is not read."""
    os.mkfifo(tmp_path / "a.csv")
    (tmp_path / "b.csv").symlink_to("/dev/zero")
    for name in ("a.csv", "b.csv"):
        with pytest.raises(RecordingError, match="pipe or a device"):
            load_arrays(tmp_path / name)


def test_arrays_of_one_name_are_refused(tmp_path: Path) -> None:
    """The last one would count, whatever it holds; in a file, and in the files of a folder."""
    np.save(tmp_path / "q.npy", np.arange(5.0))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.write(tmp_path / "q.npy", "q.npy")
        archive.write(tmp_path / "q.npy", "q")
    with pytest.raises(RecordingError, match="two arrays called 'q'"):
        load_arrays(tmp_path / "a.npz")
    (tmp_path / "a.npz").unlink()
    (tmp_path / "q.csv").write_text("1 2\n3 4\n")
    with pytest.raises(RecordingError, match="two files contain an array 'q'"):
        load_arrays(tmp_path)


def test_the_mark_of_excel_is_no_part_of_a_name(tmp_path: Path) -> None:
    """Excel writes a byte order mark before the first column's name."""
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbft;q\r\n0;1\r\n1;2\r\n")
    assert list(load_arrays(tmp_path / "a.csv")) == ["t", "q"]


@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".csv", "x" * 5000 + ".npz", "x\0.csv"])
def test_names_that_no_file_can_have_are_refused(tmp_path: Path, name: str) -> None:
    """Before they are asked for."""
    with pytest.raises(RecordingError):
        load_arrays(tmp_path / name)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (", columns: []", "columns: has 0 entries"),
        (", columns: [-1, 0]", r"columns\[0\]"),
        (", columns: [true, false]", r"columns\[0\]: is yes or no"),
        (", offset: true", "offset: is yes or no"),
        (", factor: [true, 1]", r"factor\[0\]: is yes or no"),
        (", sign: yes", "sign: is yes or no"),
        (", ratio: [on, null]", r"ratio\[0\]: is yes or no"),
        ("}}\nrows: {key: t, value: true}\nmotor: {effort: {key: q", "rows.value: is yes or no"),
        ("}}\ncoupling: {a: {b: true}}\nmotor: {effort: {key: q", "coupling.a.b: is yes or no"),
    ],
)
def test_truths_and_lists_of_nothing_are_no_numbers(
    tmp_path: Path, more: str, problem: str
) -> None:
    """Python takes true for 1, and counts negative columns from the end."""
    assert re.search(problem, refused(tmp_path, more=more))


@pytest.mark.parametrize(("key", "words"), [("q", "complex128"), ("t", "no numbers")])
def test_a_complex_array_is_refused(tmp_path: Path, key: str, words: str) -> None:
    """Its imaginary part would be lost."""
    assert words in refused(tmp_path, **{key: np.ones((5, 2) if key == "q" else 5, complex)})
