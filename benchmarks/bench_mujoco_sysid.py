"""Identification beside `mujoco.sysid` (MuJoCo's own, extra `sysid`): the same recording, model and
parameters.

    python benchmarks/bench_mujoco_sysid.py --joints 3

A MuJoCo arm whose mass, centre of mass, inertia, armature, damping and friction loss differ from
its file is recorded with noise. `identify` and `mujoco.sysid` start from the file; each result is
judged by the torque error and by the open-loop prediction of a motion that neither has seen,
replayed in MuJoCo, by the armatures and frictions found, and by the base parameters that the
recording determines well (their errors over what is natural for them, rms and largest). Times are
of processor, all threads and compilers included. The first call of `identify` loads libraries and
compiles kernels, which later processes find on disk.
"""

import argparse
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.excitation import MotionLimits, liveliest, random_trajectories
from elastic_arm.identification import Identification, identify
from elastic_arm.mujoco import export_mjcf, record, replay
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

RATE = 500.0
NOISE = {"torque_noise": 0.05, "encoder_noise": 1e-5}


def model_text(n: int, rng: np.random.Generator | None = None) -> str:
    """Return an MJCF of n hinges; with a generator every number is off by some 20 %."""

    def off(value: float, spread: float = 0.2) -> float:
        return value if rng is None else value * float(rng.uniform(1.0 - spread, 1.0 + spread))

    bodies = []
    ends = []
    for i in range(n):
        size = 0.75**i
        mass = off(4.0 * size)
        inertia = [off(k * mass * 0.01, 0.1) for k in (1.0, 0.9, 0.6)]
        axis = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1", "1 0 0")[i]
        numbers = (
            f'armature="{off(0.2 * size)}" damping="{off(0.8 * size)}"'
            f' frictionloss="{off(1.5 * size)}"'
        )
        com = f"{off(0.03)} {off(0.02)} {off(0.12)}"
        bodies.append(
            f'<body name="link{i + 1}" pos="0 0 {0.3 if i else 0.1}"><inertial pos="{com}"'
            f' mass="{mass}" diaginertia="{" ".join(map(str, inertia))}"/><joint'
            f' name="joint{i + 1}" axis="{axis}" range="-2.5 2.5" {numbers} solreffriction="0.002'
            ' 1"/>'
        )
        ends.append("</body>")
    motors = "".join(
        f'<motor name="m{i + 1}" joint="joint{i + 1}" ctrlrange="-300 300"/>' for i in range(n)
    )
    sensors = "".join(f'<jointpos name="p{i + 1}" joint="joint{i + 1}"/>' for i in range(n))
    sensors += "".join(f'<jointvel name="v{i + 1}" joint="joint{i + 1}"/>' for i in range(n))
    return (
        '<mujoco model="bench"><compiler angle="radian"/><option timestep="0.001"'
        ' integrator="implicitfast"/>'
        "<worldbody>"
        f"{''.join(bodies)}{''.join(ends)}</worldbody><actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )


def processor_time() -> float:
    """Return the processor time, s, of this process and of those that it started."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def ours(recording: Recording, base: Path, out: Path) -> tuple[Identification, MjcfArm, float]:
    """Identify by this package and write the result into a copy of the file."""
    begin = processor_time()
    result = identify(recording, load_robot(base))
    seconds = processor_time() - begin
    assert result.identified is not None, result.notes
    export_mjcf(result.identified, base, out)
    return result, open_mjcf(out), seconds


def theirs(recording: Recording, base: Path, out: Path, iterations: int) -> tuple[MjcfArm, float]:
    """Identify by `mujoco.sysid`: multiple windows, all parameters at once."""
    from mujoco import sysid

    spec = mujoco.MjSpec.from_file(str(base))
    robot = load_robot(base)
    params = sysid.ParameterDict()

    def add(name: str, value: Any, low: Any, high: Any, modifier: Any) -> None:
        params.add(sysid.Parameter(name, value, low, high, modifier=modifier))

    for joint in robot.joints:
        for name in ("armature", "damping", "frictionloss"):
            value = np.atleast_1d(getattr(spec.joint(joint.name), name))[0]
            add(f"{joint.name}_{name}", value, 0.1 * value, 5.0 * value, _setter(joint.name, name))
        mass = joint.link.mass
        com = joint.link.com
        body = joint.link_name
        add(f"{body}_mass", mass, 0.3 * mass, 3.0 * mass, _body(body, "mass"))
        add(f"{body}_com", com, com - 0.1, com + 0.1, _body(body, "ipos"))
    residual = sysid.build_residual_fn(models_sequences=[_sequences(sysid, spec, recording, robot)])
    begin = processor_time()
    best, _ = sysid.optimize(
        initial_params=params,
        residual_fn=residual,
        optimizer="mujoco",
        max_iters=iterations,
        verbose=False,
    )
    seconds = processor_time() - begin
    found = sysid.apply_param_modifiers_spec(best, spec) or spec
    found.compile()
    out.write_text(found.to_xml())
    return open_mjcf(out), seconds


def _setter(joint: str, name: str) -> Any:
    def change(spec: Any, parameter: Any) -> None:
        value = getattr(spec.joint(joint), name)
        setattr(
            spec.joint(joint),
            name,
            [parameter.value[0], 0.0, 0.0] if np.ndim(value) else parameter.value[0],
        )

    return change


def _body(body: str, name: str) -> Any:
    def change(spec: Any, parameter: Any) -> None:
        setattr(spec.body(body), name, parameter.value[0] if name == "mass" else parameter.value)

    return change


def _sequences(
    sysid: Any, spec: Any, recording: Recording, robot: Robot, window: float = 0.5
) -> Any:
    """Return the recording cut into windows, each from its own recorded start."""
    model = spec.compile()
    data = mujoco.MjData(model)
    side = recording.motor
    assert (
        side is not None
        and side.position is not None
        and side.velocity is not None
        and side.effort is not None
    )
    t = (side.stamp_ns - side.stamp_ns[0]) * 1e-9
    steps = int(window * RATE)
    starts = range(0, len(t) - int(window * RATE), int(window * RATE))
    states = []
    controls = []
    sensors = []
    for k in starts:
        data.qpos[:] = side.position[k]
        data.qvel[:] = side.velocity[k]
        states.append(sysid.create_initial_state(model, data.qpos, data.qvel, data.act))
        part = slice(k, k + steps)
        measured = np.hstack([side.position[part], side.velocity[part]])
        controls.append(sysid.TimeSeries(t[part] - t[k], side.effort[part]))
        sensors.append(sysid.TimeSeries.from_names(t[part] - t[k], measured, model))
    names = [f"window_{k}" for k in starts]
    return sysid.ModelSequences("arm", spec, names, states, controls, sensors)


def figures(arm: MjcfArm, held_out: Recording, true: Robot) -> list[float]:
    """Return torque rms (Nm), open-loop position rms (mrad), and rms relative errors of armatures
    and frictions."""
    errors = replay(held_out, arm, window=0.1).open_loop
    found = []
    for kind in ("armature", "viscous_friction", "coulomb_friction"):
        apart = [
            (value(arm.robot, kind, i) - value(true, kind, i)) / value(true, kind, i)
            for i in range(true.n)
        ]
        found.append(100.0 * float(np.sqrt(np.mean(np.square(apart)))))
    torque = float(np.sqrt(np.mean(errors.torque**2)))
    position = float(np.sqrt(np.mean(errors.position**2)))
    return [torque, 1e3 * position, *found]


def base_errors(result: Identification, found: Robot, true: Robot) -> list[float]:
    """Return the rms and the largest error, %, of the base parameters that the recording determines
    well."""
    well = [e.verdict == "well" for e in result.estimates]
    scale = np.array([e.std / e.relative_std for e in result.estimates])
    apart = result.T @ (
        parameters(found, result.parameter_names) - parameters(true, result.parameter_names)
    )
    errors = 100.0 * np.abs(apart / scale)[well]
    return [float(np.sqrt(np.mean(errors**2))), float(errors.max())]


def parameters(robot: Robot, names: Sequence[str]) -> NDArray[np.float64]:
    """Return the parameters of these names, those of its laws included."""
    model = build_model(robot)
    named = {p.name: p.nominal for p in model.bodies.parameters}
    for law in robot.effects:
        named |= {
            f"{law['effect']}:{law['joint']}.{name}": v for name, v in law["parameters"].items()
        }
    return np.array([named.get(name, 0.0) for name in names])


def value(robot: Robot, kind: str, i: int) -> float:
    """Return a joint's armature, damping or friction loss."""
    joint = robot.joints[i]
    if kind == "armature":
        return float(joint.armature or 0.0)
    own = [
        e["parameters"] for e in robot.effects if e["effect"] == kind and e["joint"] == joint.name
    ]
    return float(next(iter(own[0].values()))) if own else 0.0


def main() -> None:
    """Run one size and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--joints", type=int, default=3, choices=range(2, 8))
    parser.add_argument("--iterations", type=int, default=30, help="of mujoco.sysid")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the recording")
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plain.xml").write_text(model_text(options.joints))
        (folder / "true.xml").write_text(model_text(options.joints, np.random.default_rng(7)))
        robot = load_robot(folder / "plain.xml")
        true = load_robot(folder / "true.xml")
        limits = MotionLimits.of(robot, velocity=2.0, acceleration=8.0)
        motions = liveliest(random_trajectories(build_model(robot), limits, 40, rng=rng), 2)
        fit, judge = (
            record(open_mjcf(folder / "true.xml"), m, nominal=robot, rate=RATE, rng=rng, **NOISE)
            for m in motions
        )
        fit = replace(fit.between(0.0, options.seconds), source="fit")
        print(f"{options.joints} joints, {options.seconds:g} s of {RATE:g} Hz")
        print(
            f"{'':14s} time s  torque Nm  motion mrad  armature %  damping %  friction loss %  base"
            " %  worst %"
        )
        result, arm, first = ours(fit, folder / "plain.xml", folder / "ours.xml")
        rows = {
            "plain file": (open_mjcf(folder / "plain.xml"), 0.0),
            "true file": (open_mjcf(folder / "true.xml"), 0.0),
            "identify": (arm, ours(fit, folder / "plain.xml", folder / "ours.xml")[2]),
        }
        try:
            rows["mujoco.sysid"] = theirs(
                fit, folder / "plain.xml", folder / "theirs.xml", options.iterations
            )
        except (ImportError, AttributeError) as error:
            print(f"mujoco.sysid is not there ({error}): pip install 'mujoco[sysid]'")
        for label, (arm, seconds) in rows.items():
            torque, position, *shares = [
                *figures(arm, judge, true),
                *base_errors(result, arm.robot, true),
            ]
            words = "".join(
                f"{share:{width}.2f}"
                for share, width in zip(shares, (12, 11, 17, 8, 9), strict=True)
            )
            print(f"{label:14s} {seconds:6.2f}  {torque:9.4f}  {position:11.4f}{words}")
        well = sum(e.verdict == "well" for e in result.estimates)
        print(
            f"{well} of {len(result.estimates)} base parameters are determined well; first call"
            f" {first:.2f} s"
        )


if __name__ == "__main__":
    main()
