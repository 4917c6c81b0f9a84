"""Arrays as robots' makers and laboratories leave them: structs, tables without names, folders,
zeros and scales."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, read_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.foreign.guess import guess_mapping
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    imported,
    joint_state,
    stamps,
    write_foreign,
    write_yaml,
)

KR300 = Path(__file__).parents[3] / "shared" / "data" / "kuka_kr300" / "run_A.mat"


def motion(count: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, angles and torques of two joints."""
    t = np.arange(count) * 0.01
    return t, np.column_stack([np.sin(t), np.cos(t)]), np.column_stack([5 * np.cos(t), t])


def test_fields_of_nested_structs_are_keys(tmp_path: Path) -> None:
    """A .mat file's struct in a struct is mapped as `rec.motor.q`; other fields are ignored by a
    pattern."""
    t, q, tau = motion()
    rec = {"time": t, "motor": {"q": q.T, "tau": tau}, "name": "run A", "gains": np.eye(3)}
    scipy.io.savemat(tmp_path / "run.mat", {"rec": rec, "para": {"u": 3.0, "v": [1, 2]}})
    motor = {"position": {"key": "rec.motor.q"}, "effort": {"key": "rec.motor.tau"}}
    ignore = ["rec.name", "rec.gain?", "para.*"]
    recording = imported(tmp_path / "run.mat", "ab", "rec.time", motor=motor, ignore=ignore)
    np.testing.assert_array_equal(recording.motor.position, q)
    np.testing.assert_array_equal(recording.motor.effort, tau)
    with pytest.raises(RecordingError, match=r"para\.u, para\.v are not mapped"):
        imported(tmp_path / "run.mat", "ab", "rec.time", motor=motor, ignore=["rec.*"])


@pytest.mark.parametrize("delimiter", [",", ";", " "])
def test_columns_without_names_go_by_their_numbers(tmp_path: Path, delimiter: str) -> None:
    """A table whose first line is numbers loses no sample; its columns are 0, 1, 2, ..."""
    t, q, tau = motion()
    np.savetxt(
        tmp_path / "run.csv", np.column_stack([t, q, tau, 0 * t]), fmt="%.17g", delimiter=delimiter
    )
    sides = {"link": {"position": {"key": [1, 2]}}, "motor": {"effort": {"key": [3, 4]}}}
    recording = imported(tmp_path / "run.csv", "ab", 0, **sides, ignore=["5"])
    np.testing.assert_array_equal(recording.link.position, q)
    np.testing.assert_array_equal(recording.motor.effort, tau)


def test_a_folder_of_files_is_one_set_of_arrays(tmp_path: Path) -> None:
    """One file a quantity, one value a joint and line: each file is an array of its own name."""
    t, q, tau = motion()
    folder = tmp_path / "run"
    folder.mkdir()
    np.savetxt(folder / "q.txt", q, fmt="%.17g")
    np.savetxt(folder / "tau.csv", tau, fmt="%.17g", delimiter=",")
    np.save(folder / "time.npy", t)
    (folder / "README").write_text("two joints")
    link = {"position": {"key": "q"}, "effort": {"key": "tau"}}
    recording = imported(folder, "ab", "time", link=link, ignore=["*.?"])
    np.testing.assert_array_equal(recording.link.position, q)
    np.testing.assert_array_equal(recording.link.effort, tau)
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="contains no arrays"):
        load_arrays(tmp_path / "empty")


def test_an_offset_is_taken_in_the_recorded_unit(tmp_path: Path) -> None:
    """Counts that read 2048 at zero become radians: (number + offset) x factor x unit, one for all
    joints or each."""
    t, q, _ = motion()
    np.savez(
        tmp_path / "run.npz", t=t, counts=np.rad2deg(q) / 0.1 + [2048, -100], volts=q * 50 + 2.5
    )
    link = {
        "position": {"key": "counts", "unit": "deg", "factor": 0.1, "offset": [-2048, 100]},
        "effort": {"key": "volts", "offset": -2.5, "sign": [1, -1]},
    }
    recording = imported(tmp_path / "run.npz", "ab", "t", link=link)
    np.testing.assert_allclose(recording.link.position, q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.link.effort, q * [50, -50], rtol=0, atol=1e-12)


def test_a_channel_map_takes_an_offset_too(tmp_path: Path) -> None:
    """A foreign bag's angles in degrees, 90 at the zero of the robot description."""
    messages = [
        ("/arm", JOINT_STATE, int(stamp), joint_state(stamp, JOINTS, [row, row, row]))
        for row, stamp in enumerate(stamps(50))
    ]
    channels = {
        "defaults": {"motor": {"position": {"topic": "/arm", "unit": "deg"}}},
        "joints": {JOINTS[0]: {}, JOINTS[1]: {"motor": {"position": {"offset": -90, "sign": -1}}}},
    }
    bag = write_foreign(tmp_path / "bag", messages)
    recording = read_recording(bag, write_yaml(tmp_path / "map.yaml", channels))
    np.testing.assert_allclose(recording.motor.position[:, 0], np.deg2rad(np.arange(50)))
    np.testing.assert_allclose(recording.motor.position[:, 1], np.deg2rad(90 - np.arange(50)))


@pytest.mark.skipif(not KR300.exists(), reason="needs the recordings of a real KUKA KR300")
def test_axes_with_two_encoders_of_a_real_arm_are_imported(tmp_path: Path) -> None:
    """The first three of six axes of a KR300, both encoders and the torque at the motors'
    shafts."""
    ratio = np.abs(scipy.io.loadmat(KR300)["para"]["u"].item().ravel()[:3]).tolist()
    axes = {"columns": [0, 1, 2]}
    link = {"position": {"key": "rec.act_pos_se_deg", "unit": "deg", **axes}}
    motor = {
        "position": {"key": "rec.act_pos_mot_deg", "unit": "deg", **axes},
        "effort": {"key": "rec.act_torque_abs_nm", "unit": "Nm_motor", "ratio": ratio, **axes},
    }
    (tmp_path / "run.mat").symlink_to(KR300)
    sides = {"link": link, "motor": motor}
    recording = imported(
        tmp_path / "run.mat", ("a1", "a2", "a3"), "rec.time_cont", **sides, ignore=["*"]
    )
    assert recording.motor.position.shape == (2501, 3)
    assert 1e-4 < np.abs(recording.motor.position - recording.link.position).max() < 1e-2


@pytest.mark.parametrize("layout", ["table", "turned", "flat"])
def test_a_file_of_numbers_a_channel_is_mapped_by_its_name_alone(
    tmp_path: Path, layout: str
) -> None:
    """`key: q` is all of q.txt, its columns no strays; one number a line is told by `flat`."""
    q, tau = np.random.default_rng(3).normal(size=(2, 30, 3))
    (tmp_path / "run").mkdir()
    for name, values in {"q": q, "tau": tau}.items():
        shaped = {"table": values, "turned": values.T, "flat": values.ravel()}[layout]
        np.savetxt(tmp_path / "run" / f"{name}.txt", shaped, fmt="%.17g")
    rest = {"flat": True} if layout == "flat" else {}
    link = {"position": {"key": "q", **rest}, "effort": {"key": "tau", **rest}}
    taken = imported(tmp_path / "run", "abc", 100.0, link=link).link
    np.testing.assert_array_equal(taken.position, q)
    np.testing.assert_array_equal(taken.effort, tau)


def test_what_is_left_of_a_folder_is_named_once(tmp_path: Path) -> None:
    """A table that is not used by its file's name, one that is used in part by its other
    columns."""
    (tmp_path / "run").mkdir()
    for name in ("q", "tau", "other"):
        np.savetxt(tmp_path / "run" / f"{name}.txt", np.arange(90.0).reshape(30, 3))
    link = {"position": {"key": "q"}, "effort": {"key": ["tau.0", "tau.1"], "joints": ["a", "b"]}}
    with pytest.raises(RecordingError, match=r"arrays other, tau\.2 are not mapped"):
        imported(tmp_path / "run", "abc", 100.0, link=link)


def test_numbers_one_a_line_are_asked_for_their_layout(tmp_path: Path) -> None:
    """What it may be is said."""
    (tmp_path / "run").mkdir()
    np.savetxt(tmp_path / "run" / "q.txt", np.arange(90.0))
    with pytest.raises(RecordingError) as caught:
        imported(tmp_path / "run", "abc", 100.0, link={"position": {"key": "q"}})
    assert (
        "If it contains 3 numbers per sample one after the other, add flat: true"
        in caught.value.remedy
    )


def test_other_words_for_a_field_are_answered_with_its_name(tmp_path: Path) -> None:
    """A scale is a factor, a zero an offset."""
    np.savez(tmp_path / "run.npz", q=np.zeros((9, 1)))
    with pytest.raises(RecordingError) as caught:
        imported(
            tmp_path / "run.npz",
            "a",
            100.0,
            link={"position": {"key": "q", "scale": 2.0, "zero": 0.3}},
        )
    assert "scale: unknown key (the name is factor)" in caught.value.problem
    assert "zero: unknown key (the name is offset)" in caught.value.problem


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t;q1;tau1\n0;0,1;1\n0,01;0,2;2\n", "line 2: '0,1' has a decimal comma"),
        ("0;0,1;1\n0,01;0,2;2\n", "line 1: '0,1' has a decimal comma"),
        ("t,q\n0,1\n\n1\n", "line 4: 1 columns, where the lines before have 2"),
        ("t,q\n0,1\n1,abc\n", "q: line 3: 'abc' is not a number"),
        ("t,q\n0,1\n# made by hand\n1,abc\n", "q: line 4: 'abc' is not a number"),
        ("", "is empty"),
    ],
)
def test_a_table_that_cannot_be_read_is_told_by_line(tmp_path: Path, text: str, words: str) -> None:
    """With what to do, in words of the table."""
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(RecordingError) as caught:
        imported(tmp_path / "run.csv", "a", 100.0, link={"position": {"key": "q"}}, ignore=["t"])
    assert words in caught.value.problem and caught.value.remedy


def test_semicolons_beside_commas_in_names_part_the_columns(tmp_path: Path) -> None:
    """As spreadsheets write them."""
    (tmp_path / "run.csv").write_text("time, s;angle, rad\n0;1.5\n1;2.5\n")
    np.testing.assert_array_equal(load_arrays(tmp_path / "run.csv")["angle, rad"], [1.5, 2.5])


def log(tmp_path: Path, text: str, times: object = "Time [ms]", **more: object) -> Recording:
    """The recording of one joint of a table with columns `Time [ms]` and `q`."""
    (tmp_path / "run.csv").write_text(text)
    return imported(tmp_path / "run.csv", "a", times, link={"position": {"key": "q"}}, **more)


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_decimal_commas_are_read_where_the_mapping_has_them(tmp_path: Path, mark: str) -> None:
    """Whatever parts the columns, and with a number that has no digits behind its comma."""
    name = "Time [ms]" if mark != " " else "t"
    text = mark.join([name, "q"]) + "\n" + "".join(f"{k}0,0{mark}{k},5\n" for k in range(5))
    side = log(tmp_path, text, {"key": name, "unit": "ms"}, decimal=",").link
    np.testing.assert_array_equal(side.position[:, 0], np.arange(5) + 0.5)
    np.testing.assert_array_equal(side.stamp_ns, np.arange(5) * 10_000_000)


def test_a_row_of_units_blank_cells_and_texts_are_read(tmp_path: Path) -> None:
    """Degrees by the row of units, rows with holes left out and counted, a text column refuses
    nothing."""
    rows = "".join(f"{k},{'' if k == 3 else k},{'ok' if k else ''},true\n" for k in range(8))
    run = log(tmp_path, "Time [ms],q,status,moving\nms,deg,-,-\n" + rows)
    np.testing.assert_allclose(run.link.position[:, 0], np.deg2rad([0, 1, 2, 4, 5, 6, 7]))
    np.testing.assert_array_equal(run.link.stamp_ns, np.array([0, 1, 2, 4, 5, 6, 7]) * 1_000_000)
    assert run.notes == ("1 of 8 rows have missing values on the link side and were skipped",)


@pytest.mark.parametrize(
    "text", ["t,q,\n0,1,\n1,2,\n", "t,q\n0,1,\n1,2,\n", '"t","q"\n"0,0","1,0"\n"1,0","2,0"\n']
)
def test_marks_at_the_end_of_lines_and_numbers_in_quotes_are_read(
    tmp_path: Path, text: str
) -> None:
    """As loggers and spreadsheets write them."""
    (tmp_path / "run.csv").write_text(text)
    arrays = load_arrays(tmp_path / "run.csv", None)
    assert list(arrays) == ["t", "q"]
    np.testing.assert_array_equal(arrays["q"], [1.0, 2.0])


def test_every_third_row_is_taken(tmp_path: Path) -> None:
    """As of a log that repeats each sample."""
    run = log(tmp_path, "Time [ms],q\n" + "".join(f"{k},{k // 3}\n" for k in range(30)), every=3)
    np.testing.assert_array_equal(run.link.position[:, 0], np.arange(10))
    np.testing.assert_array_equal(run.link.stamp_ns, np.arange(10) * 3_000_000)


@pytest.mark.parametrize("name", ["torque [%]", "torque_%", "torque (percent)", "torque [counts]"])
def test_a_share_of_a_torque_is_no_torque(tmp_path: Path, name: str) -> None:
    """Without a unit in the mapping it is refused, and a guess asks how many Nm one is."""
    t = np.arange(200) * 0.01
    rows = "".join(f"{a},{np.sin(3 * a)},{np.cos(3 * a)}\n" for a in t)
    (tmp_path / "run.csv").write_text(f"t,q,{name}\n{rows}")
    word = name.split()[-1].strip("[]()").replace("torque_", "")
    link = {"position": {"key": "q"}}
    with pytest.raises(RecordingError, match=re.escape(f"is in {word}. Give effort a unit")):
        imported(tmp_path / "run.csv", "a", "t", link=link, motor={"effort": {"key": name}})
    draft = guess_mapping(load_arrays(tmp_path / "run.csv"), ["a"])
    assert (
        draft.missing == ["motor.effort.factor"] and f"number of Nm per {word}" in draft.to_yaml()
    )
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    with pytest.raises(RecordingError, match=r"motor\.effort\.factor"):
        import_arrays(tmp_path / "run.csv", tmp_path / "map.yaml")
    for factor, notes in ((0.5, 0), (1.0, 1)):
        effort = {"key": name, "unit": "Nm", "factor": factor}
        assert (
            len(imported(tmp_path / "run.csv", "a", "t", link=link, motor={"effort": effort}).notes)
            == notes
        )


@pytest.mark.parametrize("name", ["tau [mNm]", "tau / mNm", "tau in mNm", "tau_mNm", "tau (mN m)"])
def test_units_in_names_are_those_of_the_channels(tmp_path: Path, name: str) -> None:
    """Millinewtonmetres are a thousandth; a number in brackets counts, and is no unit."""
    np.savez(tmp_path / "run.npz", **{name: np.arange(5.0), "q[0]": np.arange(5.0)})
    motor = {"position": {"key": ["q[0]"]}, "effort": {"key": [name]}}
    run = imported(tmp_path / "run.npz", "a", 100.0, motor=motor)
    np.testing.assert_allclose(run.motor.effort[:, 0], np.arange(5.0) * 1e-3)
    np.testing.assert_array_equal(run.motor.position[:, 0], np.arange(5.0))


@pytest.mark.parametrize("name", ["t [ms]", "t (ms)", "Zeit / ms", "t in ms"])
def test_units_in_the_name_of_the_times_count(tmp_path: Path, name: str) -> None:
    """Where the mapping gives none."""
    np.savez(tmp_path / "run.npz", **{name: np.arange(5.0), "q": np.arange(5.0)})
    run = imported(tmp_path / "run.npz", "a", name, motor={"position": {"key": "q"}})
    np.testing.assert_array_equal(run.motor.stamp_ns, np.arange(5) * 1_000_000)


@pytest.mark.parametrize(
    ("head", "gap", "encoding"),
    [
        ("t [s];q1 [°];q2 [°]\n", "", "utf-16"),
        ("t [s];q1 [°];q2 [°]\n", "n/a", "cp1252"),
        ("# arm 7\n# Größe\nt [s];q1 [deg];q2 [deg]\n", "NA", "utf-8-sig"),
        ("# arm 7\n# t [s];q1 [deg];q2 [deg]\n", "NULL", "utf-8"),
    ],
)
def test_tables_are_read_as_other_programs_write_them(
    tmp_path: Path, head: str, gap: str, encoding: str
) -> None:
    """Encodings of Windows, comments above the names, and what stands for no number."""
    (tmp_path / "run.csv").write_text(f"{head}0;90;1\n1;{gap};2\n2;180;3\n", encoding)
    names = list(load_arrays(tmp_path / "run.csv"))
    side = imported(
        tmp_path / "run.csv", "ab", names[0], link={"position": {"key": names[1:]}}
    ).link
    np.testing.assert_allclose(side.position, np.radians([[90, 1], [180, 3]]))
    np.testing.assert_array_equal(side.stamp_ns, [0, 2_000_000_000])
