"""A real Dynamixel XL330 that swings a pendulum, in closed loop on a motion that was not fitted.

    python -m benchmarks.bench_servo_xl330 FOLDER [--diagnose] [--gain 100]

FOLDER holds logs of the project BAM as CSV, kpGAIN_MOTION.csv, with goal_rad, position_rad and
time_s. The first two motions are fitted at all gains together; printed are the numbers found with
their deviations, and the error of each log in closed loop, mrad rms: described → written → the
written MJCF alone, without friction by load and sag. With --diagnose the causes are those of the
whole diagnosis; without, the numbers that every servo has are fitted alone. The description is the
data sheet's: kt / R 0.0963 Nm/V, 7.4 V, and no more.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elastic_arm.cli.diagnose import correct
from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects import EFFECTS
from elastic_arm.mujoco import Exported, export_mjcf
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.judgement import Judging, closed_loop
from elastic_arm.mujoco.refinable import RATIOS, Moved
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.mjcf import open_mjcf

FITTED = ("sin_sin", "up_and_down")
JUDGED = "sin_time_square"
# Of the data sheet.
TORQUE_PER_VOLT = 0.0963  # Nm/V
BACK_EMF = 0.4  # V s/rad
SUPPLY = 7.4  # V
DUTY = 4096 / (2 * np.pi * 256 * 885)  # per rad and number of the register of the gain
PENDULUM = """<mujoco model="pendulum"><option timestep="0.001"/>
<custom><numeric name="firmware_gain" data="1"/></custom>
<worldbody><body name="rod" pos="0 0 1">
<joint name="servo" axis="0 1 0" armature="0.0018" frictionloss="0.03" solreffriction="0.002 1"/>
<inertial pos="0 0 -0.09804" mass="0.51" diaginertia="1.2e-5 1.2e-5 1e-6"/>
</body></worldbody>
<actuator><dcmotor name="motor" joint="servo" input="pos" {motor}/></actuator></mujoco>
"""


def described(file: Path) -> Robot:
    """Write the bench as an MJCF, with the gain 1 in its register, and read it."""
    damping = TORQUE_PER_VOLT * BACK_EMF
    kp = DUTY * SUPPLY * TORQUE_PER_VOLT
    motor = f'motorconst="{BACK_EMF} {BACK_EMF}" resistance="{BACK_EMF / TORQUE_PER_VOLT:.10g}"'
    controller = f'controller="{kp:.10g} 0 {damping:.10g} 0 0 {SUPPLY}"'
    file.write_text(PENDULUM.format(motor=f"{motor} {controller}"))
    return load_robot(file)


def recorded(folder: Path, gain: int, motion: str) -> Recording:
    """Read a log."""
    file = folder / f"kp{gain}_{motion}.csv"
    names = file.read_text().split("\n", 1)[0].split(",")
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    t, goal, position = (
        table[:, names.index(f"{n}")] for n in ("time_s", "goal_rad", "position_rad")
    )
    stamps = np.round(1e9 * t).astype(np.int64)
    return Recording(
        ("servo",),
        link=Side(stamps, position=position[:, None]),
        reference=Side(stamps, position=goal[:, None]),
        source=file.stem,
        firmware_gains={"servo": float(gain)},
    )


def told(moved: Sequence[Moved]) -> None:
    """Print numbers that were fitted, with their deviations."""
    for one in moved:
        size = np.exp(one.by) if one.number.what in RATIOS.values() else one.by - one.number.stated
        print(f"{one.number.what:24} {size:8.4f} ± {one.std:.4f}")


def main() -> None:
    """Print numbers and errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--gain", type=int, action="append", help="fitted gains; 100 and 400")
    parser.add_argument("--diagnose", action="store_true")
    asked = parser.parse_args()
    gains = asked.gain or [100, 400]
    logs = {file.stem for file in asked.folder.glob("kp*_*.csv")}
    fit = [recorded(asked.folder, gain, motion) for gain in gains for motion in FITTED]
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary) / "arm.xml"
        robot = described(base)
        correction = Correction(base, None, None, EFFECTS)
        judge = [recorded(asked.folder, gain, JUDGED) for gain in gains]
        if asked.diagnose:
            found = diagnose(fit, Question(robot, refit=True), judge)
            said = [f"{one.effect} ({one.confidence:.2f})" for one in found.causes]
            print(f"{found.verdict}: {', '.join(said) or 'no cause'}")
            done = correct(found, robot, base.parent, correction, judge, fit)
        else:
            done = correction.judged(
                robot,
                lambda back: robot,
                robot.joint_names,
                list(map(Judging, judge)),
                base.parent,
                caused=False,
                fitted=list(map(Judging, fit)),
            )
        told(done.fitted)
        print("\n".join(done.notes()))
        file = correction.path(base.parent)
        assert file is not None
        arms = [open_mjcf(base)]
        if done.robot is not None:
            plain = base.parent / "with_laws.xml"
            export_mjcf(done.robot, base, plain)
            arms.append(with_controllers(open_mjcf(plain), done.robot))
        if isinstance(done.file, Exported):
            print("\n".join(done.file.stand_ins))
            arms.append(open_mjcf(file))
        for stem in sorted(logs, key=lambda name: (JUDGED in name, int(name.split("_")[0][2:]))):
            gain, _, motion = stem[2:].partition("_")
            judging = [Judging(recorded(asked.folder, int(gain), motion))]
            plays = [closed_loop(arm, judging) for arm in arms]
            sizes = [np.nan if one is None else 1e3 * one.errors[0] for one in plays]
            print(f"{stem:24} {' → '.join(f'{size:7.1f}' for size in sizes)}")
    print(f"{time.process_time() - begin:.0f} s of processor")


if __name__ == "__main__":
    main()
