"""Drafts of array mappings."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays, load_array_map
from elastic_arm.recording.foreign.guess import guess_mapping
from elastic_arm.recording.sides import matched_names

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
JOINTS = ("a", "b", "c")
T = np.arange(0.0, 8.0, 0.002)
Q = np.column_stack([np.sin((1 + 0.3 * k) * T + k) for k in range(3)])
DQ = np.column_stack([(1 + 0.3 * k) * np.cos((1 + 0.3 * k) * T + k) for k in range(3)])
TAU = np.random.default_rng(1).normal(0.0, 20.0, Q.shape)


def test_a_draft_of_named_arrays_is_imported_as_it_is(tmp_path: Path) -> None:
    """Degrees and rpm are recognised by the derivative, the times by their rate, and the import has
    SI units."""
    np.savez(
        tmp_path / "run.npz",
        stamps=T * 1e3,
        angles=np.degrees(Q),
        speeds=DQ * 30 / np.pi,
        torques=TAU,
    )
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    assert not draft.missing
    assert draft.times is not None and draft.times.unit == "ms"
    np.testing.assert_allclose(taken.link.position, Q, atol=1e-12)
    np.testing.assert_allclose(taken.link.velocity, DQ, atol=1e-12)
    np.testing.assert_allclose(taken.motor.effort, TAU)


def test_the_names_of_robot_learners_are_known(tmp_path: Path) -> None:
    """A dataset's state is the angles, its action what they were told."""
    tables = {"observation.state": Q, "observation.effort": TAU, "action": Q + 1e-3}
    np.savez(tmp_path / "run.npz", timestamp=T, **tables)
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    taken = {(guess.side, guess.channel): guess.table.name for guess in draft.channels}
    state = {("link", "position"): "observation.state", ("motor", "effort"): "observation.effort"}
    assert taken == {**state, ("command", "position"): "action"}


def test_a_table_without_names_is_cut_by_its_derivatives(tmp_path: Path) -> None:
    """Ten columns of numbers: the first grows as time does, the others are three joints each, told
    by derivatives."""
    np.savetxt(tmp_path / "run.csv", np.column_stack([T, TAU, Q, DQ]), delimiter=",")
    draft = guess_mapping(load_arrays(tmp_path / "run.csv"), JOINTS)
    found = {(g.side, g.channel): (g.table.keys, g.unit) for g in draft.channels}
    assert found == {
        ("motor", "effort"): (("1", "2", "3"), "Nm"),
        ("link", "position"): (("4", "5", "6"), "rad"),
        ("link", "velocity"): (("7", "8", "9"), "rad/s"),
    }
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    assert load_array_map(tmp_path / "map.yaml").times.key == "0"


def test_columns_are_grouped_by_the_joints_names(tmp_path: Path) -> None:
    """Columns called by joint and quantity are tables in the robot's order, whatever the order in
    the file."""
    joints = ("lift", "arm_1", "arm_10")
    tables = {"position": Q, "velocity": DQ, "effort": TAU}
    columns = {
        f"{name}_{what}": v[:, k]
        for what, v in tables.items()
        for k, name in [*enumerate(joints)][::-1]
    }
    draft = guess_mapping({"t": T, **columns}, joints)
    assert {guess.channel: guess.table.keys for guess in draft.channels} == {
        what: tuple(f"{name}_{what}" for name in joints) for what in tables
    }
    assert [guess.table.name for guess in draft.channels] == [
        "*_position",
        "*_velocity",
        "*_effort",
    ]
    assert not draft.ignored


def test_a_torque_that_follows_the_velocity_is_no_velocity() -> None:
    """Friction does so; what is the derivative of no position in any unit is a torque, and stays
    one beside others."""
    friction = 9.0 * np.sign(DQ) + 2.0 * DQ
    draft = guess_mapping({"times": T, "q": Q, "dq": DQ, "motor": friction}, JOINTS)
    found = {(guess.side, guess.channel): guess.table.name for guess in draft.channels}
    assert found == {
        ("link", "position"): "q",
        ("link", "velocity"): "dq",
        ("motor", "effort"): "motor",
    }
    draft = guess_mapping({"times": T, "q": Q, "dq": DQ, "torque": TAU, "motor": friction}, JOINTS)
    assert not any(
        guess.side == "motor" and guess.channel == "velocity" for guess in draft.channels
    )
    assert draft.ignored == (("motor", "also a candidate for motor effort; torque was chosen"),)


def test_what_is_called_a_velocity_and_is_none_is_left_out_with_the_reason() -> None:
    """Noise is the derivative of no angle; without times, or angles, nothing speaks against the
    name."""
    arrays = {"times": T, "pos": Q, "vel": TAU}
    ((key, reason),) = guess_mapping(arrays, JOINTS).ignored
    assert key == "vel" and "not the derivative of any position" in reason
    for left_out in ("times", "pos"):
        rest = {name: values for name, values in arrays.items() if name != left_out}
        assert "velocity" in [guess.channel for guess in guess_mapping(rest, JOINTS).channels]


def test_one_table_in_two_forms_is_used_once(tmp_path: Path) -> None:
    """Files of numbers alone are tables and columns; rates before their angles are told by them,
    too."""
    (tmp_path / "run").mkdir()
    for name, values in {"A_cur": TAU, "B_rates": DQ, "C_data": Q, "stamps": T[:, None]}.items():
        np.savetxt(tmp_path / "run" / f"{name}.txt", values)
    draft = guess_mapping(load_arrays(tmp_path / "run"), JOINTS)
    found = {(guess.side, guess.channel): guess.table.name for guess in draft.channels}
    assert found == {
        ("link", "position"): "C_data",
        ("link", "velocity"): "B_rates",
        ("motor", "effort"): "A_cur",
    }
    assert "another candidate" not in draft.to_yaml()
    assert "- B_rates.*    # the same numbers as B_rates" in draft.to_yaml()


def test_large_angles_alone_may_be_a_rotors() -> None:
    """Angles beyond a joint's range are taken as degrees, and the draft names the other reading."""
    draft = guess_mapping({"time": T, "pos": np.degrees(Q), "current": TAU}, JOINTS)
    (position,) = [guess for guess in draft.channels if guess.channel == "position"]
    assert position.unit == "deg" and "rad of a rotor" in draft.to_yaml()


def test_rotor_angles_get_their_ratio_and_currents_ask_for_theirs(tmp_path: Path) -> None:
    """The ratio and sign follow from both sides' angles; a torque constant is left open and
    named."""
    ratio = np.array([121.0, -101.0, 80.0])
    arrays = {
        "time": T,
        "q_link": Q,
        "theta_motor": Q * ratio,
        "dtheta_motor": DQ * ratio,
        "motor_current": TAU,
    }
    draft = guess_mapping(arrays, JOINTS)
    motor = next(g for g in draft.channels if (g.side, g.channel) == ("motor", "position"))
    assert motor.scales == {"ratio": [121.0, 101.0, 80.0], "sign": [1.0, -1.0, 1.0]}
    assert draft.missing == ["motor.effort.torque_constant", "motor.effort.ratio"]
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    with pytest.raises(RecordingError, match="torque_constant"):
        load_array_map(tmp_path / "map.yaml")


def test_joints_that_slide_have_lengths_and_forces(tmp_path: Path) -> None:
    """A gantry carries an arm: its travel in mm is told by its size, the units are given joint by
    joint."""
    positions, speeds = (v * np.array([300.0, 1.0, 1.0]) for v in (Q, DQ))
    arrays = {"time": T, "positions": positions, "speeds": speeds, "torques": TAU}
    draft = guess_mapping(arrays, JOINTS, prismatic=("a",))
    assert [list(guess.units) for guess in draft.channels if guess.side == "link"] == [
        ["mm", "rad", "rad"],
        ["mm/s", "rad/s", "rad/s"],
    ]
    np.savez(tmp_path / "run.npz", **arrays)  # type: ignore[arg-type]
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    np.testing.assert_allclose(taken.link.position, Q * [0.3, 1.0, 1.0])
    np.testing.assert_allclose(taken.motor.effort, TAU)


def test_a_single_axis_has_columns_of_one_name_each() -> None:
    """A log of a linear drive: position, speed and force are told by their names."""
    arrays = {
        "time": T,
        "position": 0.1 * Q[:, 0],
        "speed": 0.1 * DQ[:, 0],
        "motor_force": TAU[:, 0],
    }
    draft = guess_mapping(arrays, ("axis",), prismatic=("axis",))
    found = {(guess.side, guess.channel): guess.unit for guess in draft.channels}
    assert found == {
        ("link", "position"): "m",
        ("link", "velocity"): "m/s",
        ("motor", "effort"): "N",
    }
    (stated,) = guess_mapping(
        {"time": T, "position [mm]": Q[:, 0]}, ("axis",), prismatic=("axis",)
    ).channels
    assert stated.unit == "mm"


def test_arrays_of_other_joints_or_without_a_sample_are_refused() -> None:
    """Three columns are no arm of seven joints; and numpy has no remark about the mean of
    nothing."""
    with pytest.raises(RecordingError, match="no array contains positions or torques of 7 joints"):
        guess_mapping({"time": T, "q": Q}, [f"joint_{k}" for k in range(7)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RecordingError, match="no array contains"):
            guess_mapping({"t": np.empty(0), "q": np.empty((0, 2))}, JOINTS)


def test_columns_without_a_sensor_are_left_out(tmp_path: Path) -> None:
    """Zeros of a joint that turns by its motor's encoder; one that stands on both sides keeps its
    columns."""
    link = Q * [1.0, 1.0, 0.0]
    motor = Q * [1.0, 0.0, 1.0]
    link[:, 1] = motor[:, 1]
    arrays = {
        "time": T,
        "link_pos": link,
        "link_vel": DQ * [1.0, 0.0, 0.0],
        "motor_pos": motor,
        "motor_torque": TAU,
    }
    draft = guess_mapping(arrays, JOINTS)
    places = {(guess.side, guess.channel): guess.places for guess in draft.channels}
    assert places[("link", "position")] == (0, 1) and places[("motor", "position")] is None
    np.savez(tmp_path / "run.npz", **arrays)  # type: ignore[arg-type]
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    np.testing.assert_array_equal(np.isnan(taken.link.position).all(axis=0), [False, False, True])
    assert "column 2 is constant while its joint moves: no sensor, not mapped" in draft.to_yaml()


def test_a_torque_by_the_current_comes_before_one_without_a_side() -> None:
    """Beside a torque sensor and a torque of the motor's current, the third is the controller's
    model."""
    columns = {"Torque": TAU, "TorqueSensor": TAU + 1.0, "TorqueCur": TAU + 2.0, "Cur": 0.1 * TAU}
    arrays = {f"{name}{k + 1}": values[:, k] for name, values in columns.items() for k in range(3)}
    draft = guess_mapping({"time": T, "pos": Q, **arrays}, JOINTS)
    taken = {
        guess.side: guess.table.keys[0] for guess in draft.channels if guess.channel == "effort"
    }
    assert taken == {"link": "TorqueSensor1", "motor": "TorqueCur1"}


def test_columns_beyond_the_joints_are_said() -> None:
    """An arm of two joints takes two of three columns, of one array or counted."""
    arrays = {"time": T, "pos": Q, **{f"tau_{k}": TAU[:, k] for k in range(3)}}
    text = guess_mapping(arrays, JOINTS[:2]).to_yaml()
    assert text.count("the first 2 of 3 columns: check that these are the arm's joints") == 2


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recordings of real robots")
@pytest.mark.parametrize(
    ("file", "n", "expected"),
    [
        (
            "kuka_lwr4/measurements_1.npz",
            7,
            {"position": "positions", "velocity": "velocities", "effort": "torques"},
        ),
        ("kinova_gen3/opti_traj_testing1.csv", 7, {"position": "Position1", "effort": "TorqueSm1"}),
        ("kuka_kr300/run_A.mat", 3, {"position": "rec.act_pos_se_deg"}),
    ],
)
def test_files_of_real_robots(file: str, n: int, expected: dict[str, str]) -> None:
    """The measured arrays are found among commands, models and temperatures."""
    draft = guess_mapping(load_arrays(SHARED / file), [f"joint_{k}" for k in range(n)])
    first = {
        channel: next(g for g in draft.channels if g.channel == channel).table.keys[0]
        for channel in expected
    }
    assert first == expected


def test_an_array_of_a_joint_without_a_sensor_is_ignored(tmp_path: Path) -> None:
    """Of numbered arrays, one a joint, the one that stays as it is: the draft is imported as it
    is."""
    torques = {f"motor_torque_{k + 1}": TAU[:, k] for k in range(2)}
    np.savez(tmp_path / "run.npz", t=T, q=Q, dq=DQ, **torques, motor_torque_3=np.zeros(len(T)))
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    np.testing.assert_allclose(taken.motor.effort[:, :2], TAU[:, :2])
    assert np.isnan(taken.motor.effort[:, 2]).all()


def test_a_number_that_is_missing_makes_no_degrees(tmp_path: Path) -> None:
    """One NaN among the angles, and one among the times."""
    q = Q.copy()
    t = T.copy()
    q[10, 1] = t[20] = np.nan
    np.savez(tmp_path / "run.npz", time=t, pos=q, vel=DQ, torque=TAU)
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    assert {guess.channel: guess.unit for guess in draft.channels} == {
        "position": "rad",
        "velocity": "rad/s",
        "effort": "Nm",
    }
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    assert taken.notes[0] == "2 of 4000 rows have missing values on the link side and were skipped"


@pytest.mark.parametrize("decimal", [".", ","])
def test_names_with_brackets_and_units_give_a_mapping_that_is_read(
    tmp_path: Path, decimal: str
) -> None:
    """As a spreadsheet writes them, with decimal commas too: no name is taken for YAML or for a
    pattern."""
    columns = {
        "Time [ms]": T * 1e3,
        **{f"Pos {j}: [deg]": np.degrees(Q[:, k]) for k, j in enumerate(JOINTS)},
    }
    columns |= {"Temp [°C]": T, "# {note}": T}
    rows = [";".join(f"{values[k]:.9f}" for values in columns.values()) for k in range(len(T))]
    text = ";".join(columns) + "\n" + "\n".join(rows).replace(".", decimal) + "\n"
    (tmp_path / "run.csv").write_text(text)
    draft = guess_mapping(load_arrays(tmp_path / "run.csv", None), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.csv", tmp_path / "map.yaml")
    np.testing.assert_allclose(taken.link.position, Q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("layout", ["flat", "a file a joint"])
def test_folders_of_one_number_a_line(tmp_path: Path, layout: str) -> None:
    """The numbers of all joints one after the other, or a file for each joint: the draft is
    imported as it is."""
    folder = tmp_path / "run"
    folder.mkdir()
    np.savetxt(folder / "time.txt", T)
    for name, values in {"pos": Q, "torque": TAU}.items():
        if layout == "flat":
            np.savetxt(folder / f"{name}.txt", values.ravel())
        else:
            for k in range(3):
                np.savetxt(folder / f"{name}_{k + 1}.txt", values[:, k])
    draft = guess_mapping(load_arrays(folder), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(folder, tmp_path / "map.yaml")
    np.testing.assert_allclose(taken.link.position, Q)
    np.testing.assert_allclose(taken.motor.effort, TAU)


@pytest.mark.parametrize(("own", "written"), [("fer_", "panda_"), ("fer_", ""), ("", "panda_")])
def test_names_with_and_without_a_prefix_are_those_of_one_arm(
    tmp_path: Path, own: str, written: str
) -> None:
    """In columns of a table, in a recording and in a bag, which notes it."""
    joints = [f"{own}joint{k + 1}" for k in range(3)]
    columns = {f"{written}joint{k + 1}.pos": Q[:, k] for k in (2, 0, 1)}
    draft = guess_mapping({"t": T, **columns}, joints)
    assert [guess.table.keys for guess in draft.channels] == [
        tuple(f"{written}joint{k}.pos" for k in (1, 2, 3))
    ]
    recorded = Recording(
        tuple(f"{written}joint{k + 1}" for k in (2, 0, 1)), Side(np.arange(len(T)), Q[:, [2, 0, 1]])
    )
    read = read_recording(write_recording(tmp_path / "bag", recorded), joints=joints)
    for taken in (recorded.select(joints), read):
        assert taken.joints == tuple(joints) and taken.link is not None
        np.testing.assert_array_equal(taken.link.position, Q)
        assert "after removing the common part of the names" in taken.notes[-1]
    called = [f"{written}joint{k}" for k in (1, 2, 3)]
    assert matched_names(joints, [*recorded.joints, "gripper"]) == called
    assert matched_names(joints, [f"{arm}_{name}" for name in called for arm in "lr"]) is None
    with pytest.raises(RecordingError, match="no joint arm_1"):
        recorded.select(["arm_1", "arm_2", "arm_3"])


def test_units_after_an_underscore_name_the_channel() -> None:
    """`turn_Ist_deg` is an angle in degrees and `turn_Strom_A` a current, in a table of other
    languages, too."""
    t = np.linspace(0.0, 10.0, 2001)
    angle = 60.0 * np.sin(t)
    current = np.cos(t)
    arrays = {
        "Zeit": t,
        **{f"{j}_Ist_deg": angle for j in "ab"},
        **{f"{j}_Strom_A": current for j in "ab"},
    }
    found = {(g.side, g.channel): g.unit for g in guess_mapping(arrays, ["a", "b"]).channels}
    assert found == {("link", "position"): "deg", ("motor", "effort"): "A"}


@pytest.mark.parametrize(
    ("rows", "fault"),
    [
        (np.random.default_rng(2).permutation(len(T)), "jumps back in time"),
        (np.repeat(np.arange(len(T)), 2), "repeats the stamp"),
        (np.r_[2000:4000, 0:2000], "jumps back in time"),
    ],
    ids=["unsorted", "repeated", "two files joined"],
)
def test_times_that_do_not_increase_are_named_and_kept(
    tmp_path: Path, rows: np.ndarray, fault: str
) -> None:
    """A sample rate in their place would take rows in a wrong order for motion; the import refuses
    them and names what to do."""
    np.savez(tmp_path / "run.npz", time=T[rows], q=Q[rows], tau=TAU[rows])
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    assert draft.times is not None and fault in draft.times.fault
    assert fault in draft.to_yaml() and "times.rate" not in draft.missing
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    with pytest.raises(RecordingError, match=fault) as refused:
        import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    assert "sort the rows" in refused.value.remedy


def test_states_of_named_joints_are_positions(tmp_path: Path) -> None:
    """A dataset as a table has a column a joint; its commands are then compared with the states."""
    sent = {f"action.{joint}": Q[1:, k] for k, joint in enumerate(JOINTS)}
    states = {f"observation.state.{joint}": Q[:-1, k] for k, joint in enumerate(JOINTS)}
    np.savez(tmp_path / "run.npz", timestamp=T[:-1], **states, **sent)
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    (only,) = draft.channels
    assert (only.side, only.channel, only.table.name) == ("link", "position", "observation.state.*")
    assert "1 sample later: not commands that were sent" in draft.to_yaml()


@pytest.mark.parametrize(
    ("name", "size"),
    [("torque_{}_Ncm", 1e-2), ("tau {} [kg·cm]", 9.80665e-2), ("m_{} [cNm]", 1e-2)],
)
def test_torques_of_small_drives_have_their_units(tmp_path: Path, name: str, size: float) -> None:
    """The factor follows from the name, as for mNm."""
    torques = {name.format(joint): TAU[:, k] / size for k, joint in enumerate(JOINTS)}
    angles = {f"q_{joint}": Q[:, k] for k, joint in enumerate(JOINTS)}
    np.savez(tmp_path / "run.npz", time=T, **angles, **torques)
    draft = guess_mapping(load_arrays(tmp_path / "run.npz"), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    taken = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
    assert taken.motor is not None
    np.testing.assert_allclose(taken.motor.effort, TAU)


def test_times_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    """A table with thousands separators in its times says so where it asks for the rate."""
    rows = [f"{1e6 * t:,.1f};{q[0]};{q[1]};{q[2]}" for t, q in zip(T, Q, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time_us;q_a;q_b;q_c", *rows]) + "\n")
    draft = guess_mapping(load_arrays(tmp_path / "run.csv"), JOINTS)
    assert draft.times is None
    assert "time_us is named like times, but not numbers" in draft.to_yaml()
