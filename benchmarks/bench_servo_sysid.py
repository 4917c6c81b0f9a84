"""The correction of servo arms beside `mujoco.sysid` (MuJoCo's own, extra `sysid`): the same bags.

    python -m benchmarks.bench_servo_sysid --seed 626262 --level servo [--only payload]

Arms are those of :mod:`.bench_servo_correction`. `mujoco.sysid` starts from the description and
fits kp, kv, armature, damping, friction loss, mass and centre of mass of every joint to the
recorded positions, from the rest with which a recording begins, or in windows from the recorded
state. Both are judged by the MJCF that each writes, loaded alone, in closed loop on the recording
that judges: mrad of each joint, description → correction and sysid (true arm). Processor seconds
are those of the whole process, threads included; those of the correction include the diagnosis. At
the end: the ratio of the times, and at how many joints which of the two errs less.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.bench_mujoco_sysid import _body, _setter, processor_time
from benchmarks.bench_servo_correction import arm_options, arms_of, played
from elastic_arm.arrays import Array
from elastic_arm.cli.diagnose import correct
from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects import EFFECTS
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.robot.mjcf import open_mjcf
from elastic_arm.studies.blind_challenge.draw import Request
from elastic_arm.studies.blind_challenge.levels import LEVELS
from elastic_arm.studies.blind_challenge.servo_arms import drawn, mjcf, opened

WIDE = 5.0  # ratio within which sysid may move a number
MOVED = 0.1  # m, by which it may move a centre of mass


@dataclass(frozen=True)
class Compared:
    """An arm that both corrected: errors (n,) rad, and processor seconds."""

    name: str
    described: Array
    ours: Array
    theirs: Array
    true: Array
    seconds: tuple[float, float]


def compared(
    folder: Path, level: str, seed: int, kind: str | None, window: float, iterations: int
) -> Compared:
    """Draw an arm and correct it in both ways."""
    of = LEVELS[level]
    number = (None, *of.effects, *of.foreign).index(kind)
    name = f"{level}_{seed}_{number:02d}_{kind or 'clean'}"
    one = drawn(
        folder, Request(name, () if kind is None else (kind,), (seed, number), of.seconds), of
    )
    true = opened(one.true, folder / "true.xml", one.step)
    base = folder / "arm.xml"
    fit, judge = (record_commands(true, told, rate=one.rate, bits=of.bits) for told in one.commands)
    base.write_text(mjcf(one.stated, one.step))
    begin = processor_time()
    robot = load_robot(base)
    found = diagnose([fit], Question(robot, refit=True), [judge])
    correction = Correction(base, None, None, EFFECTS)
    correct(found, robot, folder, correction, [judge], [fit])
    file = correction.path(folder)
    assert file is not None
    middle = processor_time()
    theirs(fit, base, folder / "sysid.xml", window, iterations)
    end = processor_time()
    paths = (base, file if file.exists() else base, folder / "sysid.xml")
    errors = [played(open_mjcf(path), judge) for path in paths]
    return Compared(name, *errors, played(true, judge), (middle - begin, end - middle))


def theirs(recording: Recording, base: Path, out: Path, window: float, iterations: int) -> None:
    """Fit a description by `mujoco.sysid`, and write it."""
    from mujoco import sysid

    spec = mujoco.MjSpec.from_file(str(base))
    for joint, actuator in zip(spec.joints, spec.actuators, strict=True):
        actuator.name = f"servo_{joint.name}"
        # sysid wants as many sensors as there are measured signals, which are states, see below.
        kind = mujoco.mjtSensor.mjSENS_JOINTPOS
        reads = mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"q_{joint.name}", type=kind, objtype=reads, objname=joint.name)
    params = sysid.ParameterDict()

    def add(name: str, value: Any, modifier: Any, by: float | None = None) -> None:
        low, high = (value / WIDE, WIDE * value) if by is None else (value - by, value + by)
        params.add(sysid.Parameter(name, value, low, high, modifier=modifier))

    for joint, actuator in zip(spec.joints, spec.actuators, strict=True):
        for number in ("armature", "damping", "frictionloss"):
            value = float(np.atleast_1d(getattr(joint, number))[0])
            add(f"{joint.name}_{number}", value, _setter(joint.name, number))
        kp = actuator.gainprm[0]
        kv = -actuator.biasprm[2]
        add(f"{joint.name}_kp", kp, _gain(sysid.apply_pgain, actuator.name))
        add(f"{joint.name}_kv", kv, _gain(sysid.apply_dgain, actuator.name))
        body = joint.parent
        add(f"{body.name}_mass", body.mass, _body(body.name, "mass"))
        add(f"{body.name}_com", np.array(body.ipos), _body(body.name, "ipos"), MOVED)
    sequences = _sequences(sysid, spec, recording, window)
    best, _ = sysid.optimize(
        initial_params=params,
        residual_fn=sysid.build_residual_fn(models_sequences=[sequences]),
        optimizer="mujoco",
        max_iters=iterations,
        verbose=False,
    )
    found = sysid.apply_param_modifiers_spec(best, spec) or spec
    found.compile()
    out.write_text(found.to_xml())


def _gain(apply: Any, actuator: str) -> Any:
    return lambda spec, parameter: apply(spec, actuator, float(parameter.value[0]))


def _sequences(sysid: Any, spec: Any, recording: Recording, window: float) -> Any:
    """Return the recording cut into windows, each from the recorded state, with held commands."""
    model = spec.compile()
    side = recording.link
    reference = recording.reference
    assert side is not None and side.position is not None
    assert reference is not None and reference.position is not None
    step = float(model.opt.timestep)
    t = (side.stamp_ns - side.stamp_ns[0]) * 1e-9
    given = (reference.stamp_ns - side.stamp_ns[0]) * 1e-9
    rates = np.gradient(side.position, t, axis=0, edge_order=2)
    whole = len(t) - 1
    samples = int(min(whole, window // float(np.median(np.diff(t)))))
    states = []
    controls = []
    sensors = []
    names = []
    # Not sensors: in a rollout those are of the state before a step, and sysid takes them as after.
    kind = sysid.SignalType.MjStateQPos
    measured = [(name, kind) for name in recording.joints]
    for k in range(0, len(t) - samples, samples):
        part = slice(k, k + samples + 1)
        angles = np.array(side.position[part])
        states.append(sysid.create_initial_state(model, angles[0], rates[k]))
        at = step * np.arange(round((t[k + samples] - t[k]) / step) + 1)
        last = np.searchsorted(given, t[k] + at + 1e-6, side="right") - 1
        controls.append(sysid.TimeSeries(at, reference.position[last]))
        sensors.append(sysid.TimeSeries.from_names(t[part] - t[k], angles, model, measured))
        names.append(f"window_{k}")
    return sysid.ModelSequences("arm", spec, names, states, controls, sensors)


def lines(one: Compared) -> Sequence[str]:
    """Return what is printed of an arm."""
    ours, theirs = one.seconds
    rows = [f"{one.name}  {ours:.1f} s, sysid {theirs:.1f} s"]
    sizes = (one.described, one.ours, one.theirs, one.true)
    for k, (described, mine, other, true) in enumerate(zip(*sizes, strict=True)):
        both = f"{1e3 * mine:7.2f} and {1e3 * other:7.2f}"
        rows.append(f"  joint_{k + 1}  {1e3 * described:7.2f} → {both} ({1e3 * true:5.2f})")
    return rows


def summary(found: Sequence[Compared]) -> str:
    """Return ratios of times and errors over all arms."""
    ratio = np.array([theirs / ours for ours, theirs in (one.seconds for one in found)])
    ours = np.concatenate([one.ours for one in found])
    theirs = np.concatenate([one.theirs for one in found])
    true = np.concatenate([one.true for one in found])
    less = int(np.sum(ours <= theirs))
    return (
        f"sysid takes {np.median(ratio):.1f} ({ratio.min():.1f} to {ratio.max():.1f}) times as"
        f" long; errors over the true arm's: {np.median(ours / true):.2f}, 90 %"
        f" {np.quantile(ours / true, 0.9):.2f}; of sysid {np.median(theirs / true):.2f}, 90 %"
        f" {np.quantile(theirs / true, 0.9):.2f}; no larger than sysid's at {less} of"
        f" {len(ours)} joints"
    )


def main() -> None:
    """Print a table of each arm, and the ratios."""
    parser = arm_options(__doc__, 626262)
    parser.add_argument("--window", type=float, default=np.inf, help="of sysid, s")
    parser.add_argument("--iterations", type=int, default=6, help="of sysid, at most")
    asked = parser.parse_args()
    found = []
    for folder, effect in arms_of(asked):
        one = compared(folder, asked.level, asked.seed, effect, asked.window, asked.iterations)
        print("\n".join(lines(one)), flush=True)
        found.append(one)
    print(summary(found))


if __name__ == "__main__":
    main()
