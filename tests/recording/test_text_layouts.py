"""Tables as others write them: long ones, lists in cells, dates, JSON, MATLAB 7.3; the same numbers
from each."""

import json
import pickle
from collections.abc import Callable
from datetime import date
from decimal import Decimal
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from scipy.io import savemat

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.foreign.guess import guess_mapping
from elastic_arm.recording.foreign.text_layouts import arrays_of
from elastic_arm.recording.foreign.text_tables import Arrays
from elastic_arm.robot import load_robot, to_urdf
from tests.helpers.command_line import refusal, run
from tests.helpers.shared_data import DATA, needs_data

REPORTS = DATA / "public_reports_2"
T = np.arange(60) * 0.01
Q = np.sin(np.outer(T, [2.0, 3.0]) + np.array([0.3, 1.0]))
NAMES = ("shoulder", "elbow")


def long_by_signal(file: Path) -> None:
    """Write a row for each signal and time."""
    rows = [
        f"{t:.3f},{name}/pos,{q:.9f}"
        for t, qs in zip(T, Q, strict=True)
        for name, q in zip(NAMES, qs, strict=True)
    ]
    file.write_text("\n".join(["time,signal,value", *rows]))


def long_by_joint(file: Path) -> None:
    """Write a row for each joint and time, with a column a quantity."""
    rows = [
        f"{t:.3f};{n};{q:.9f};{2 * q:.9f}"
        for t, qs in zip(T, Q, strict=True)
        for n, q in zip(NAMES, qs, strict=True)
    ]
    file.write_text("\n".join(["stamp;joint;pos;load", *rows]))


def lists_in_cells(file: Path) -> None:
    """Write arrays as text, whose names come in another order every other row."""
    rows = []
    for k, (t, q) in enumerate(zip(T, Q, strict=True)):
        way = slice(None, None, 1 if k % 2 else -1)
        rows.append(f'{t:.3f},"{list(NAMES)[way]}","{[round(x, 9) for x in q.tolist()][way]}"')
    file.write_text("\n".join(["time,name,pos", *rows]))


def json_lines(file: Path) -> None:
    """Write a message a line, with ROS's stamps."""
    stamps = [{"sec": 1_700_000_000 + int(t), "nanosec": round(1e9 * (t % 1.0))} for t in T]
    records = zip(stamps, Q.round(9).tolist(), strict=True)
    lines = [json.dumps({"header": {"stamp": s}, "name": NAMES, "pos": q}) for s, q in records]
    file.write_text("\n".join(lines))


def json_columns(file: Path) -> None:
    """Write an object of lists."""
    columns = {f"pos.{name}": q.tolist() for name, q in zip(NAMES, Q.T.round(9), strict=True)}
    file.write_text(json.dumps({"time": T.tolist(), **columns}))


def dates(file: Path) -> None:
    """Write ISO dates."""
    rows = [f"2026-11-28T06:00:{t:06.3f}Z,{a:.9f},{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)]
    file.write_text("\n".join(["time,shoulder_pos,elbow_pos", *rows]))


def clock(file: Path) -> None:
    """Write times of day, over midnight."""
    day = [(86_399.7 + t) % 86_400.0 for t in T]
    times = [f"{int(s // 3600):02d}:{int(s // 60 % 60):02d}:{s % 60:06.3f}" for s in day]
    rows = [f"{t};{a:.9f};{b:.9f}" for t, (a, b) in zip(times, Q, strict=True)]
    file.write_text("\n".join(["time;shoulder_pos;elbow_pos", *rows]))


def long_by_number(file: Path) -> None:
    """Write a row for each joint's number and time; no cell is a text."""
    rows = [
        f"{t:.3f},{j + 1},{q:.9f}"
        for t, qs in zip(T, Q, strict=True)
        for j, q in enumerate(qs.tolist())
    ]
    file.write_text("\n".join(["timestamp,joint_id,position", *rows]))


def long_by_two_columns(file: Path) -> None:
    """Write a row for each joint, channel and time, beside a column of one text."""
    rows = [
        f"{t:.3f},run_1,{n},{channel},{factor * q:.9f}"
        for t, qs in zip(T, Q, strict=True)
        for n, q in zip(NAMES, qs, strict=True)
        for channel, factor in (("pos", 1.0), ("load", 2.0))
    ]
    file.write_text("\n".join(["time,test,joint,channel,value", *rows]))


def long_parquet(file: Path) -> None:
    """Write a row for each joint and time as Parquet."""
    columns = {
        "time": np.repeat(T, 2),
        "joint": np.tile(NAMES, len(T)),
        "position": Q.round(9).ravel(),
    }
    pq.write_table(pa.table(columns), file)


def printed_in_cells(file: Path) -> None:
    """Write arrays as NumPy prints them, over two lines."""
    rows = [f'{t:.3f},"[{q[0]:.9f}\n {q[1]:.9f}]"' for t, q in zip(T, Q, strict=True)]
    file.write_text("\n".join(["time,pos", *rows]))


def bare_in_cells(file: Path) -> None:
    """Write arrays without brackets."""
    rows = [f"{t:.3f},{q[0]:.9f};{q[1]:.9f}" for t, q in zip(T, Q, strict=True)]
    file.write_text("\n".join(["time,pos", *rows]))


def json_objects(file: Path) -> None:
    """Write a list of objects a line, a joint each."""
    lines = []
    for t, q in zip(T.tolist(), Q.round(9).tolist(), strict=True):
        joints = [{"name": n, "position": x} for n, x in zip(NAMES, q, strict=True)]
        lines.append(json.dumps({"t": t, "joints": joints}))
    file.write_text("\n".join(lines))


def json_topics(file: Path) -> None:
    """Write messages of two topics in turn, with ROS's stamps."""
    lines = []
    for t, q in zip(T, Q.round(9).tolist(), strict=True):
        stamp = {"sec": 1_700_000_000, "nanosec": round(1e9 * t)}
        data = {"header": {"stamp": stamp}, "name": NAMES, "position": q}
        lines.append(json.dumps({"topic": "/joint_states", "data": data}))
        lines.append(json.dumps({"topic": "/temperature", "data": {"header": {"stamp": stamp}}}))
    file.write_text("\n".join(lines))


def json_beside_others(file: Path) -> None:
    """Write a list of records beside what describes them."""
    rows = zip(T.tolist(), Q.round(9).tolist(), strict=True)
    records = [{"t": t, "q": q} for t, q in rows]
    file.write_text(json.dumps({"meta": {"arm": "b", "joints": NAMES}, "data": records}))


def json_by_joint(file: Path) -> None:
    """Write a list of numbers a joint, not a sample."""
    file.write_text(json.dumps({"t": T.tolist(), "q": Q.T.round(9).tolist()}))


def american_dates(file: Path) -> None:
    """Write the month first, and the half of the day behind."""
    rows = [
        f"11/28/2026 12:00:{t:06.3f} PM,{a:.9f},{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)
    ]
    file.write_text("\n".join(["time,shoulder_pos,elbow_pos", *rows]))


def minutes(file: Path) -> None:
    """Write minutes and seconds over a full hour, as Excel shows times."""
    hour = [(3_599.7 + t) % 3_600.0 for t in T]
    rows = [
        f"{int(s // 60):02d}:{s % 60:06.3f},{a:.9f},{b:.9f}"
        for s, (a, b) in zip(hour, Q, strict=True)
    ]
    file.write_text("\n".join(["time,shoulder_pos,elbow_pos", *rows]))


def days(file: Path) -> None:
    """Write days since the year 0, as MATLAB's datenum."""
    rows = [
        f"{738_000.5 + t / 86_400.0:.17g},{a:.9f},{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)
    ]
    file.write_text("\n".join(["time,shoulder_pos,elbow_pos", *rows]))


def matlab_cells(file: Path) -> None:
    """Write a cell a joint within a struct."""
    cells = np.empty(2, object)
    cells[:] = list(Q.T)
    savemat(file, {"log": {"q": cells, "t": T}})


def matlab_structs(file: Path) -> None:
    """Write a struct a joint."""
    joints = np.array([(column,) for column in Q.T], dtype=[("position", "O")])
    savemat(file, {"joint": joints, "time": T})


def matlab_7_3_cells(file: Path) -> None:
    """Write a cell a joint, as references."""
    with h5py.File(file, "w", userblock_size=512) as content:
        parts = [content.create_dataset(f"#refs#/{j}", data=Q[:, [j]].T) for j in range(2)]
        cells = np.array([part.ref for part in parts], dtype=h5py.ref_dtype)[:, None]
        content["log/q"] = cells
        content["log/q"].attrs["MATLAB_class"] = np.bytes_("cell")
        content["log/t"] = T[None]
    data = file.read_bytes()
    file.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + data[128:])


def lists_of_topics(file: Path) -> None:
    """Write a row for each topic and time, with the numbers of all joints in a list, as Parquet."""
    commands = Q + 0.01 * np.cos(7.0 * Q)
    both = np.stack([Q, commands], axis=1).reshape(-1, 2)
    columns = {"time": np.repeat(T, 2), "topic": ["/state", "/cmd"] * 60, "pos": list(both)}
    pq.write_table(pa.table(columns), file)


def messages_in_parquet(file: Path) -> None:
    """Write messages of ROS as structs and lists, whose names come in another order every other
    row."""
    stamps = [{"sec": 1_700_000_000, "nanosec": round(1e9 * t)} for t in T]
    ways = [slice(None, None, 1 if k % 2 else -1) for k in range(len(T))]
    columns = {
        "header": [{"stamp": stamp, "frame_id": ""} for stamp in stamps],
        "name": [list(NAMES[way]) for way in ways],
        "position": [q[way].tolist() for q, way in zip(Q, ways, strict=True)],
    }
    pq.write_table(pa.table(columns), file)


def objects_in_parquet(file: Path) -> None:
    """Write a list of objects a row, a joint each."""
    rows = [[{"name": n, "pos": x} for n, x in zip(NAMES, q, strict=True)] for q in Q.tolist()]
    pq.write_table(pa.table({"t": T, "joints": rows}), file)


def typed_parquet(file: Path) -> None:
    """Write a categorical column of names, decimal numbers and times of day."""
    day = pa.array(np.repeat(np.round(1e6 * T).astype(int), 2) + 10**9, pa.time64("us"))
    columns = {
        "time": day,
        "joint": pa.array(np.tile(NAMES, len(T))).dictionary_encode(),
        "position": [Decimal(f"{x:.9f}") for x in Q.ravel()],
    }
    pq.write_table(pa.table(columns), file)


def records_in_hdf5(file: Path) -> None:
    """Write one dataset of records."""
    with h5py.File(file, "w") as content:
        content["log"] = records_of_numpy()


def texts_in_hdf5(file: Path) -> None:
    """Write a row for each joint and time."""
    with h5py.File(file, "w") as content:
        content["time"] = np.repeat(T, 2)
        content["joint"] = np.array([*NAMES] * len(T), dtype=h5py.string_dtype())
        content["position"] = Q.ravel()


def records_of_numpy() -> np.ndarray:
    """Return times and angles as records."""
    records = np.zeros(len(T), dtype=[("t", "f8"), ("q", "f8", (2,))])
    records["t"] = T
    records["q"] = Q
    return records


def dates_of_numpy(file: Path) -> None:
    """Write NumPy's dates."""
    start = np.datetime64("2026-11-28T06:00:00", "ns")
    np.savez(file, time=start + np.round(1e9 * T).astype("m8[ns]"), q=Q)


def pandas_columns(file: Path) -> None:
    """Write an object of columns, each by the numbers of its rows: `DataFrame.to_json`."""
    columns = dict(zip(("time", "shoulder_pos", "elbow_pos"), (T, *Q.T), strict=True))
    numbered = {name: dict(enumerate(cells.tolist())) for name, cells in columns.items()}
    file.write_text(json.dumps(numbered))


def pandas_rows(file: Path) -> None:
    """Write an object of records by their numbers: `to_json(orient="index")`."""
    rows = zip(T.tolist(), *Q.T.tolist(), strict=True)
    names = ("time", "shoulder_pos", "elbow_pos")
    file.write_text(json.dumps({k: dict(zip(names, r, strict=True)) for k, r in enumerate(rows)}))


def pandas_split(file: Path) -> None:
    """Write names and rows apart: `to_json(orient="split")`."""
    rows = np.column_stack([T, Q]).tolist()
    names = ["time", "shoulder_pos", "elbow_pos"]
    file.write_text(json.dumps({"columns": names, "index": list(range(len(T))), "data": rows}))


def json_of_protobuf(file: Path) -> None:
    """Write what `mcap cat --json` makes of Foxglove's JointStates."""
    lines = []
    for t, q in zip(T, Q.round(9).tolist(), strict=True):
        joints = [{"name": n, "position": x} for n, x in zip(NAMES, q, strict=True)]
        stamp = f"2026-11-28T06:00:{t:012.9f}Z"
        message = {"timestamp": stamp, "joints": joints}
        lines.append(json.dumps({"topic": "/joint_states", "log_time": 1.0, "data": message}))
    file.write_text("\n".join(lines))


def under_two_lines(file: Path) -> None:
    """Write names of two levels, as data frames have them."""
    rows = [f"{t:.3f},{a:.9f},{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)]
    file.write_text("\n".join(["time,position,position", ",shoulder,elbow", *rows]))


def under_a_title(file: Path) -> None:
    """Write lines about the recording before the names, and units in brackets below them."""
    degrees = np.degrees(Q)
    rows = [f"{1e3 * t:.0f},{a:.9f},{b:.9f}" for t, (a, b) in zip(T, degrees, strict=True)]
    head = ["Robot logger 1.2", "Started 28.11.2026", "", "time,shoulder,elbow", "(ms),(deg),[deg]"]
    file.write_text("\n".join([*head, *rows]))


def under_excel_s_mark(file: Path) -> None:
    """Write the mark that parts the columns first."""
    rows = [f"{t:.3f};{a:.9f};{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)]
    file.write_text("\n".join(["sep=;", "time;shoulder_pos;elbow_pos", *rows]))


def under_matlab_s_comments(file: Path) -> None:
    """Write comments with per cent, the names in the last."""
    rows = [f"{t:.3f} {a:.9f} {b:.9f}" for t, (a, b) in zip(T, Q, strict=True)]
    file.write_text("\n".join(["% logged on 28.11.2026", "% time pos1 pos2", *rows]))


def stamps_in_two_columns(file: Path) -> None:
    """Write nothing but numbers, parted by tabs."""
    rows = [
        f"1700000000\t{round(1e9 * t)}\t{a:.9f}\t{b:.9f}" for t, (a, b) in zip(T, Q, strict=True)
    ]
    file.write_text("\n".join(["stamp.sec\tstamp.nanosec\tpos1\tpos2", *rows]))


WRITERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "long by signal": (".csv", long_by_signal),
    "long by joint": (".csv", long_by_joint),
    "lists in cells": (".csv", lists_in_cells),
    "JSON Lines": (".jsonl", json_lines),
    "JSON": (".json", json_columns),
    "dates": (".csv", dates),
    "times of day": (".csv", clock),
    "long by number": (".csv", long_by_number),
    "long by two columns": (".csv", long_by_two_columns),
    "long Parquet": (".parquet", long_parquet),
    "printed in cells": (".csv", printed_in_cells),
    "bare in cells": (".csv", bare_in_cells),
    "objects in JSON": (".jsonl", json_objects),
    "topics in JSON": (".jsonl", json_topics),
    "JSON beside others": (".json", json_beside_others),
    "JSON by joint": (".json", json_by_joint),
    "American dates": (".csv", american_dates),
    "minutes": (".csv", minutes),
    "days": (".csv", days),
    "cells of MATLAB": (".mat", matlab_cells),
    "structs of MATLAB": (".mat", matlab_structs),
    "cells of MATLAB 7.3": (".mat", matlab_7_3_cells),
    "lists of topics": (".parquet", lists_of_topics),
    "messages in Parquet": (".parquet", messages_in_parquet),
    "objects in Parquet": (".parquet", objects_in_parquet),
    "typed Parquet": (".parquet", typed_parquet),
    "records in HDF5": (".h5", records_in_hdf5),
    "texts in HDF5": (".h5", texts_in_hdf5),
    "records of NumPy": (".npy", lambda file: np.save(file, records_of_numpy())),
    "dates of NumPy": (".npz", dates_of_numpy),
    "columns of pandas": (".json", pandas_columns),
    "rows of pandas": (".json", pandas_rows),
    "split by pandas": (".json", pandas_split),
    "JSON of protobuf": (".jsonl", json_of_protobuf),
    "names of two levels": (".csv", under_two_lines),
    "a title": (".csv", under_a_title),
    "a mark": (".csv", under_excel_s_mark),
    "comments of MATLAB": (".txt", under_matlab_s_comments),
    "stamps in two columns": (".tsv", stamps_in_two_columns),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_same_numbers_come_of_every_layout(tmp_path: Path, kind: str) -> None:
    """Drafted and imported: times and angles are those that were written."""
    suffix, write = WRITERS[kind]
    file = tmp_path / f"log{suffix}"
    write(file)
    draft = tmp_path / "map.yaml"
    draft.write_text(guess_mapping(load_arrays(file, None), NAMES).to_yaml())
    recording = import_arrays(file, draft)
    assert recording.link is not None
    np.testing.assert_allclose(recording.link.position, Q, atol=1e-9)
    np.testing.assert_allclose(
        (recording.link.stamp_ns - recording.link.stamp_ns[0]) * 1e-9, T, atol=2e-5
    )


def test_nothing_of_a_file_vanishes(tmp_path: Path) -> None:
    """What is no table says so; commands with times of their own, and runs below each other, are
    kept as they are."""
    file = tmp_path / "run.parquet"
    lists = [[1.0] * (1 + k % 2) for k in range(len(T))]
    pq.write_table(pa.table({"time": T, "pos": lists, "at": [date(2026, 11, 28)] * len(T)}), file)
    with pytest.raises(RecordingError, match=r"pos \('lists of 1 to 2 numbers' is not a number"):
        guess_mapping(load_arrays(file), NAMES)
    assert load_arrays(file)["at"][0] == "2026-11-28"
    commands = [{"t": t, "goal": q} for t, q in zip(T[::2].tolist(), Q[::2].tolist(), strict=True)]
    states = [{"t": t, "q": q} for t, q in zip(T.tolist(), Q.tolist(), strict=True)]
    (tmp_path / "run.json").write_text(json.dumps({"states": states, "commands": commands}))
    found = load_arrays(tmp_path / "run.json")
    assert found["q"].shape == (60, 2) and found["commands.goal"].shape == (30, 2)
    rows = [f"{t:.2f},{k},lift,{q[0]}" for k in range(2) for t, q in zip(T, Q, strict=True)]
    (tmp_path / "runs.csv").write_text("\n".join(["timestamp,episode_index,task,q", *rows]))
    assert len(load_arrays(tmp_path / "runs.csv")["q"]) == 2 * len(T)


@needs_data
def test_the_reports_are_read() -> None:
    """A long table, lists in cells, and MATLAB 7.3 as .mat and as .h5 hold six axes."""
    long = load_arrays(REPORTS / "tidy_csv" / "r8_fg.csv")
    assert long["/joint_states.position[1]"][0] == 0.314448267 and len(long) == 13
    cells = load_arrays(REPORTS / "array_text_cells" / "log.csv")
    assert cells["effort.axis_2"][0] == -88.852218 and cells["header.stamp"].dtype == np.int64
    logged = load_arrays(REPORTS / "mat73_timestamps" / "yarp73.mat")
    assert logged["robot_logger_device.joints_state.positions.data"].shape == (3000, 6)


def test_matlab_7_3_is_read_as_hdf5_is(tmp_path: Path) -> None:
    """Texts and cells are left out, axes of length one too; another layout than the report's:
    joints x samples."""
    file = tmp_path / "a.mat"
    with h5py.File(file, "w", userblock_size=512) as content:
        content["log/q"] = Q.T
        content["log/t"] = T[None]
        content["log/name"] = np.array([[97], [98]], np.uint16)
        content["log/name"].attrs["MATLAB_class"] = np.bytes_("char")
        content["#refs#/a"] = np.zeros((6, 1))
    data = file.read_bytes()
    file.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + data[128:])
    found = load_arrays(file)
    assert set(found) == {"log.q", "log.t"} and found["log.q"].shape == (2, 60)


@pytest.mark.parametrize(
    ("cells", "unit", "first"),
    [
        (["2026-11-28 06:00:00.000000001"] * 3, "ns", 1_795_845_600_000_000_001),
        (["2026-11-28T08:00:00+02:00"] * 3, "ns", 1_795_845_600_000_000_000),
        (["28.11.2026 06:00:00.25"] * 3, "ns", 1_795_845_600_250_000_000),
        (["2026-11-28 06:00:00.25 UTC"] * 3, "ns", 1_795_845_600_250_000_000),
        (["28-Nov-2026 06:00:00.000000001"] * 3, "ns", 1_795_845_600_000_000_001),
        (["28/11/2026 6:00:00 AM"] * 3, "ns", 1_795_845_600_000_000_000),
        (["2026:11:28 06:00:00"] * 3, "ns", 1_795_845_600_000_000_000),
        (["20261128T060000.5"] * 3, "ns", 1_795_845_600_500_000_000),
        (["23:59:59,5", "0:00:00,5"], "s", 86_399.5),
        (["11:59:59 pm", "12:00:01 am"], "s", 86_399.0),
        (["59:59.5", "00:00.5"], "s", 3_599.5),
    ],
)
def test_dates_of_all_kinds_are_times(cells: list[str], unit: str, first: float) -> None:
    """With zones, German ones, nanoseconds, and over midnight."""
    arrays, units = arrays_of({"t": list(cells)})
    assert units == {"t": unit} and arrays["t"][0] == first and np.all(np.diff(arrays["t"]) >= 0)


def test_a_list_of_joints_beside_columns_is_no_table(tmp_path: Path) -> None:
    """Records that describe joints or sensors do not replace the samples beside them."""
    file = tmp_path / "run.json"
    joints = [{"name": name, "id": k} for k, name in enumerate(NAMES)]
    file.write_text(json.dumps({"joints": joints, "time": T.tolist(), "q": Q[:, 0].tolist()}))
    arrays = load_arrays(file)
    np.testing.assert_array_equal(arrays["time"], T)
    np.testing.assert_array_equal(arrays["q"], Q[:, 0])


def test_a_quote_in_a_comment_ends_no_table(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    rows = [f"{t:.2f},{q[0]:.6f}" for t, q in zip(T, Q, strict=True)]
    rows.insert(3, '# stopped here, "see log')
    file.write_text("\n".join(["time,q", *rows]))
    assert len(load_arrays(file)["q"]) == len(T)


def test_two_numbers_in_a_text_are_no_list() -> None:
    """They may be one with a decimal comma, or a date and a time."""
    columns, _ = arrays_of({"q": ["1,5", "1,6"], "at": ["20240105 101112.5", "20240105 101113.5"]})
    assert np.ndim(columns["q"]) == 1 and np.ndim(columns["at"]) == 1


def test_fractions_of_seconds_follow_the_time_of_day() -> None:
    """Not the dots of a date; years of two digits are of this century, the day first."""
    stamps = ["1.5.24 10:00:00.25", "1.5.24 10:00:00.50"]
    columns, _ = arrays_of({"time": stamps})
    assert columns["time"][0] == 1714557600_250000000
    assert np.diff(columns["time"]).tolist() == [250000000]


def test_texts_of_parquet_neither_break_nor_part_a_data_set(tmp_path: Path) -> None:
    """A text column called `time` stays one, and a null among the tasks of one file keeps the files
    together."""
    for k, task in enumerate((["pick"] * 60, ["pick"] * 59 + [None])):
        table = {"timestamp": T, "q": Q[:, 0], "task": task}
        pq.write_table(pa.table(table), tmp_path / f"file-{k:03d}.parquet")
    assert len(load_arrays(tmp_path)["q"]) == 2 * len(T)
    file = tmp_path / "texts.parquet"
    texts = [f"step {k // 2}" for k in range(60)]
    pq.write_table(pa.table({"time": texts, "q": Q[:, 0]}), file)
    np.testing.assert_array_equal(load_arrays(file)["q"], Q[:, 0])


def test_texts_that_are_none_of_these_stay_texts(tmp_path: Path) -> None:
    """A column of modes beside numbers is no long table, and lists of several lengths are no
    table."""
    file = tmp_path / "a.csv"
    file.write_text("time,mode,q\n" + "\n".join(f"{t},run,{t}" for t in T))
    found = load_arrays(file)
    assert found["mode"].dtype.kind == "U" and len(found["q"]) == 60 and "mode" in found.faults
    file.write_text('time,q\n0,"[1, 2]"\n1,"[1, 2, 3]"\n')
    assert "lists of 2 to 3 numbers" in load_arrays(file).faults["q"]
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(RecordingError, match="contains no table"):
        load_arrays(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("suffix", "words"),
    [
        (".pkl", "read_pickle"),
        (".npy", "pickled objects"),
        (".feather", "Parquet"),
        (".xlsx", "sheet as .csv"),
        (".csv.gz", "Unpack it"),
        (".yaml", "ros2 bag record"),
        (".log", "rename it to .csv"),
    ],
)
def test_what_is_not_read_has_a_way_out(tmp_path: Path, suffix: str, words: str) -> None:
    """Pickled frames are refused for safety."""
    file = tmp_path / f"a{suffix}"
    file.write_bytes(pickle.dumps([1.0]))
    (tmp_path / "arm.urdf").write_text(to_urdf(load_robot()))
    assert words in refusal(
        "bag",
        "import",
        file,
        "--guess",
        "--robot",
        tmp_path / "arm.urdf",
        "--out",
        tmp_path / "a.yaml",
    )


@pytest.mark.parametrize(
    ("encoding", "words"), [("protobuf", "mcap cat --json"), ("ros1msg", "rosbags-convert")]
)
def test_messages_of_others_are_refused_with_the_converter(
    tmp_path: Path, encoding: str, words: str
) -> None:
    """Foxglove's protobuf, and ROS 1 within MCAP."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.JointStates", encoding, b"\x0a\x04abcd")
        channel = writer.register_channel("/joint_states", encoding, schema)
        writer.add_message(channel, 0, b"\x08\x01", 0)
        writer.finish()
    with pytest.raises(RecordingError, match=r"foxglove\.JointStates") as caught:
        read_recording(tmp_path / "a.mcap")
    assert words in caught.value.remedy


@needs_data
def test_times_in_single_precision_are_named() -> None:
    """Seconds since 1970 as float32 step by 128 s: neither they nor another column are times."""
    arrays = load_arrays(REPORTS / "float32_stamps" / "log.csv")
    with pytest.raises(RecordingError, match=r"single precision .* 128 s"):
        guess_mapping(arrays, [f"axis_{k}" for k in range(1, 7)])
    for unit in (1.0, 1e3, 1e6):
        stamps = np.float32(unit * (1.7e9 + np.arange(60) * 4.0)).astype(np.float64)
        with pytest.raises(RecordingError, match=r"single precision .* 1\d\d s"):
            guess_mapping({"stamp": stamps, "q": Q}, NAMES)


def guessed(**arrays: np.ndarray) -> dict[tuple[str, str], tuple[str, str]]:
    """Return the draft's channels: name and unit."""
    draft = guess_mapping(Arrays({"time": T, **arrays}), NAMES)
    return {(one.side, one.channel): (one.table.name, one.unit) for one in draft.channels}


def test_a_draft_goes_by_names_and_values() -> None:
    """Efforts that end in ff, stamps that hold amp, goals, counts, and positions that are current
    ones."""
    tau = 5.0 * np.cos(Q)
    assert guessed(q=Q, joint_eff=tau)["motor", "effort"] == ("joint_eff", "Nm")
    assert guessed(q=Q, tau_coeff=tau, timestamps_raw=tau * 0 + T[:, None]).keys() == {
        ("link", "position"),
        ("motor", "effort"),
    }
    assert guessed(current_position=Q) == {("link", "position"): ("current_position", "rad")}
    assert guessed(position=Q, goal_rad=Q + 0.01)["command", "position"] == ("goal_rad", "rad")
    assert guessed(position=Q, x=Q + 0.01 * np.cos(Q))["command", "position"] == ("x", "rad")
    draft = guess_mapping(Arrays({"time": T, "q": Q, "present_load": np.round(885.0 * Q)}), NAMES)
    (counts,) = [one for one in draft.channels if one.channel == "effort"]
    assert "factor" in counts.missing and "counts of a register" in " ".join(counts.reasons)
    assert counts.side == "motor"  # "load" is no load side here
    ticks = guess_mapping(
        Arrays({"time": T, "position": np.round(2048 + 900.0 * Q)}), NAMES
    ).channels[0]
    assert ticks.unit == "turns" and "1/4096" in ticks.missing["factor"]


def test_a_draft_knows_names_of_simulators_and_controllers() -> None:
    """MuJoCo's ctrl, of angles or torques, what a controller adds or wants, forces at the tool,
    currents of an axis, and encoders."""
    tau = 5.0 * np.cos(Q)
    angles = guessed(qpos=Q, ctrl=Q + 0.01 * np.cos(Q))
    assert angles["command", "position"] == ("ctrl", "rad")
    assert guessed(qpos=Q, ctrl=tau)["command", "effort"] == ("ctrl", "Nm")
    measured = guessed(q=Q, torque_feedforward=0.5 * tau, external_torque=0.1 * tau, torque=tau)
    assert measured["motor", "effort"] == ("torque", "Nm")
    franka = guessed(q=Q, q_d=Q + 0.01, tau_J=tau, tau_J_d=0.9 * tau, tau_ext_hat_filtered=0.1 * Q)
    assert franka == {
        ("link", "position"): ("q", "rad"),
        ("link", "effort"): ("tau_J", "Nm"),
        ("command", "position"): ("q_d", "rad"),
        ("command", "effort"): ("tau_J_d", "Nm"),
    }
    assert guessed(q=Q, iq=tau)["motor", "effort"] == ("iq", "A")
    assert guessed(q=Q, tcp_force=tau) == {("link", "position"): ("q", "rad")}
    assert guessed(enc=np.round(4096.0 * Q))["link", "position"] == ("enc", "turns")


@pytest.mark.parametrize("values", [np.round(885.0 * Q), 0.8 * Q, 80.0 * Q])
@pytest.mark.parametrize("name", ["pwm", "present_pwm", "duty_cycle"])
def test_a_share_of_the_voltage_is_a_duty_of_which_the_full_one_is_asked(
    name: str, values: np.ndarray
) -> None:
    """Counts, shares and per cent; the largest number is told, but is no full scale."""
    draft = guess_mapping(Arrays({"time": T, "q": Q, name: values}), NAMES)
    channels = [(one.side, one.channel) for one in draft.channels]
    assert channels == [("link", "position"), ("motor", "pwm")]
    assert draft.missing == ["motor.pwm.full_scale"]
    assert f"the largest one here is {np.abs(values).max():.6g}" in draft.to_yaml()


def test_a_duty_is_left_out_where_it_is_no_measurement_or_a_torque_is_there() -> None:
    """A commanded duty is not what was applied; a current is a better torque."""
    told = guess_mapping(Arrays({"time": T, "q": Q, "goal_pwm": 0.8 * Q}), NAMES)
    assert [one.channel for one in told.channels] == ["position"]
    assert "a commanded duty" in dict(told.ignored)["goal_pwm"]
    beside = {"time": T, "q": Q, "motor_current": np.cos(3.0 * Q), "pwm": 0.8 * Q}
    both = guess_mapping(Arrays(beside), NAMES)
    assert {one.channel for one in both.channels} == {"position", "effort"}
    assert "beside the motor torque motor_current" in dict(both.ignored)["pwm"]


@pytest.mark.parametrize(("later", "words"), [(0, "q: not"), (1, "1 sample later"), (3, "3 samp")])
def test_commands_that_are_positions_are_left_out(later: int, words: str) -> None:
    """Of the same sample, the next one, or a later one; those of a drive that follows are taken."""
    made = np.vstack([Q[later:], Q[-1:].repeat(later, axis=0)])
    draft = guess_mapping(Arrays({"time": T, "q": Q, "action": made}), NAMES)
    assert words in dict(draft.ignored)["action"]
    assert guessed(q=Q, action=Q + 1e-3)["command", "position"] == ("action", "rad")


def test_commands_followed_closely_beside_torques_are_taken() -> None:
    """A drive with computed torque errs by its encoder alone; beside torques only the same digits
    were copied."""
    noise = 1e-5 * np.random.default_rng(1).normal(size=Q.shape)
    arrays = {"q": np.roll(Q, 2, axis=0)[2:] + noise[2:], "target_q": Q[2:], "time": T[2:]}
    torques = {"tau": 5.0 * np.cos(Q[2:])}
    drafted = guess_mapping(Arrays(arrays | torques), NAMES)
    assert ("command", "position") in {(one.side, one.channel) for one in drafted.channels}


def test_units_of_other_quantities_are_no_torque() -> None:
    """Volts and degrees Celsius, by the end of a name or in brackets."""
    for name in ("supply_V", "bus [V]", "motor_C", "board_degC", "x_mV", "battery"):
        assert guessed(q=Q, **{name: 7.0 + 0.1 * Q}) == {("link", "position"): ("q", "rad")}, name
    assert guessed(q=Q, x=7.0 * np.cos(Q))["motor", "effort"] == ("x", "Nm")


def test_commands_have_the_unit_of_the_positions() -> None:
    """Per cent of ranges show in the encoders' steps alone; commands beside them are no degrees."""
    ranges = np.array([220.0, 190.0])
    step = 200.0 / ranges * 360.0 / 4096.0
    position = np.round(60.0 * Q / step) * step
    found = guess_mapping(Arrays({"time": T, "state": position, "action": 61.0 * Q}), NAMES)
    state, action = found.channels
    assert action.side == "command" and action.missing == state.missing != {}
    assert "in the unit of state" in action.reasons


def test_an_order_that_is_assumed_is_said() -> None:
    """Columns by number are taken in the order of the arm; those by the joints' names are not
    assumed."""
    numbered = guess_mapping(
        Arrays({"time": T, "position[0]": Q[:, 0], "position[1]": Q[:, 1]}), NAMES
    )
    named = guess_mapping(Arrays({"time": T, "shoulder_pos": Q[:, 0], "elbow_pos": Q[:, 1]}), NAMES)
    assert "in the order of the arm's joints" in numbered.to_yaml()
    assert "in the order of the arm's joints" not in named.to_yaml()


@needs_data
def test_the_draft_of_the_report_has_its_efforts(tmp_path: Path) -> None:
    """Columns *_eff are torques."""
    folder = REPORTS / "guess_eff"
    out = tmp_path / "map.yaml"
    assert (
        run(
            "bag",
            "import",
            folder / "log.csv",
            "--guess",
            "--robot",
            folder / "b.urdf",
            "--out",
            out,
        ).exit_code
        == 0
    )
    recording = import_arrays(folder / "log.csv", out)
    assert recording.motor is not None and recording.motor.effort is not None
    assert recording.motor.effort[0, 1] == -88.8522182
