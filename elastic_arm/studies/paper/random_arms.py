"""Random arms of the paper's kind, and how its claims on torques fare over them.

What the paper states stays: Table I, the mounting of the transmissions, the ratios, joint 1's arrangement with a
circular spline. What it does not state is drawn: from a catalogue of harmonic drives where there is one, else from
ranges around the arm file's numbers. No drawn arm was chosen by how a claim comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from elastic_arm.errors import OutputError
from elastic_arm.robot.description import Joint, Robot
from elastic_arm.robot.parts import Bearing, Component, Inertia, Transmission
from elastic_arm.studies.paper.claims import FAILS, HOLDS, IN_PART, judge_torques
from elastic_arm.studies.paper.coupling import SymbolicCoupling, symbolic_coupling
from elastic_arm.studies.paper.export import write_csv
from elastic_arm.studies.paper.study import StageStart
from elastic_arm.studies.paper.torques import locked_link, ramp_tasks, studied_ratios, torque_result
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing
from elastic_arm.studies.parallel import ProcessPool

STEP = 2e-4


@dataclass(frozen=True)
class HarmonicDrive:
    """A size of component sets in the makers' catalogues (CSF, CSG, HFUC)."""

    wave_generator: float  # its moment of inertia, kg m^2
    stiffness: float  # K_1 at ratios of 80 and more, Nm/rad


CATALOGUE = {
    25: HarmonicDrive(0.413e-4, 3.1e4),
    32: HarmonicDrive(1.69e-4, 6.7e4),
    40: HarmonicDrive(4.50e-4, 13e4),
    45: HarmonicDrive(8.68e-4, 18e4),
    50: HarmonicDrive(12.5e-4, 25e4),
    58: HarmonicDrive(27.3e-4, 40e4),
}
SIZES = ((45, 50, 58), (32, 40, 45), (25, 32, 40))
"""From which the drives are drawn, joint by joint from the base; the arm file has sizes 50, 40 and 32."""

# Ranges (lowest, highest), drawn evenly in the logarithm.
LINK_MASS = (0.7, 1.4)  # of the arm file's
LINK_SHAPE = (0.75, 1.3)  # its centre of mass and radii of gyration, of the arm file's
ROTOR = (0.4, 2.0)  # of the arm file's inertia: servo motors from half to twice the power
DRIVE_STIFFNESS = (0.4, 0.9)  # of the catalogue's K_1, as the belt winds too
DAMPING = (3e-4, 1e-3)  # s, of the stiffness, drive and bearing
FLEX_SPLINE = (1.8e-3, 4.5e-3)  # kg m^2 at size 40; others by the fifth power of their size
CIRCULAR_SPLINE = (5.0, 15.0)  # of the next joint's flex spline; the paper has 10
BEARING = (10.0, 40.0)  # of the drive's stiffness
TRANSLATION = (5e7, 1e9)  # N/m, of the bushing, which the paper calls high


def draw_arm(robot: Robot, rng: np.random.Generator, name: str) -> Robot:
    """Draw an arm of the kind of another."""
    sizes = [int(rng.choice(SIZES[min(k, len(SIZES) - 1)])) for k in range(robot.n)]
    joints = [_joint(joint, size, rng) for joint, size in zip(robot.joints, sizes, strict=True)]
    flex = [j.transmission.spline for j in joints if j.transmission and j.transmission.spline.kind != "circular"]
    if flex:
        joints = [_with_circular(joint, flex[0], rng) for joint in joints]
    return robot.with_(name=name, joints=tuple(joints))


def _within(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _joint(joint: Joint, size: int, rng: np.random.Generator) -> Joint:
    mass, shape, drive = _within(rng, LINK_MASS), _within(rng, LINK_SHAPE), joint.transmission
    link = Inertia(joint.link.mass * mass, joint.link.com * shape, joint.link.inertia * mass * shape**2)
    assert drive is not None  # the study has seen to it
    made = CATALOGUE[size]
    stiffness = made.stiffness * _within(rng, DRIVE_STIFFNESS)
    tilting = stiffness * _within(rng, BEARING)
    changed = replace(
        drive,
        rotor=_sized(drive.rotor, drive.rotor.izz * _within(rng, ROTOR)),
        wave_generator=_sized(drive.wave_generator, made.wave_generator),
        spline=_sized(drive.spline, _within(rng, FLEX_SPLINE) * (size / 40.0) ** 5),
        stiffness=stiffness,
        damping=stiffness * _within(rng, DAMPING),
        bearing=Bearing(tilting, tilting * _within(rng, DAMPING)),
    )
    return replace(joint, link=link, transmission=changed)


def _sized(part: Component, izz: float) -> Component:
    """Return a solid of the same shape with another inertia: mass grows as its power 3/5."""
    scale = izz / part.izz
    return replace(part, izz=izz, ixx=part.ixx * scale, mass=part.mass * scale**0.6)


def _with_circular(joint: Joint, flex: Component, rng: np.random.Generator) -> Joint:
    """Give a circular spline its inertia, a multiple of the flex spline's of the next joint, as the paper states it."""
    drive: Transmission | None = joint.transmission
    if drive is None or drive.spline.kind != "circular":
        return joint
    spline = _sized(drive.spline, flex.izz * _within(rng, CIRCULAR_SPLINE))
    return replace(joint, transmission=replace(drive, spline=spline))


@dataclass(frozen=True)
class JudgedArm:
    """One drawn arm: its numbers, and what the claims come to (by key)."""

    seed: int
    numbers: dict[str, float]
    verdicts: dict[str, str]


def judge_arm(robot: Robot, coupling: tuple[SymbolicCoupling, SymbolicCoupling], seed: int) -> JudgedArm:
    """Draw an arm and judge the claims on torques."""
    rng = np.random.default_rng(seed)
    arm = draw_arm(robot, rng, f"{robot.name}_{seed}")
    bushing = Bushing().with_translation(_within(rng, TRANSLATION))
    arms = {r_tot: arm.with_ratio(r_tot) for r_tot in studied_ratios(arm)}
    known = list(arms.values())
    runs = [task() for task in ramp_tasks(known, bushing, STEP)]
    result = torque_result(
        arm,
        arms,
        runs,
        translations=(),
        assumed=bushing.translation_stiffness,
        locked=locked_link(known[-1]),
        coupling=coupling,
    )
    return JudgedArm(seed, _numbers(arm, bushing), {claim.key: claim.verdict for claim in judge_torques(result)})


def _numbers(arm: Robot, bushing: Bushing) -> dict[str, float]:
    """Return what was drawn, by name."""
    found = {"mass": arm.mass, "translation": bushing.translation_stiffness}
    for k, joint in enumerate(arm.joints, 1):
        drive = joint.transmission
        assert drive is not None
        parts = {name: component.izz for name, (component, _) in drive.components.items()}
        found |= {f"{name}_{k}.Izz": value for name, value in parts.items()}
        found |= {f"link_{k}.mass": joint.link.mass, f"joint_{k}.K": drive.stiffness, f"joint_{k}.D": drive.damping}
    return found


def judge_arms(robot: Robot, count: int, *, workers: int, seed: int, stage: StageStart) -> list[JudgedArm]:
    """Draw arms and judge the claims on torques for each."""
    top = robot.with_ratio(studied_ratios(robot)[-1])
    coupling = symbolic_coupling(top), symbolic_coupling(top, bearings=True)
    tasks: list[Callable[[], JudgedArm]] = [
        partial(judge_arm, robot, coupling, each) for each in range(seed, seed + count)
    ]
    with ProcessPool(workers) as pool:
        return pool.run(tasks, stage("arms", count))


def summary(arms: Sequence[JudgedArm]) -> list[tuple[str, int, int, int]]:
    """Return a row a claim: its key, and for how many arms it holds, holds in part, does not hold."""
    rows = []
    for key in arms[0].verdicts:
        found = [arm.verdicts[key] for arm in arms]
        rows.append((key, found.count(HOLDS), found.count(IN_PART), found.count(FAILS)))
    return rows


def write_arms(arms: Sequence[JudgedArm], path: Path) -> Path:
    """Write a row an arm: its seed, what was drawn, and the verdicts."""
    rows = [{"seed": a["seed"], **a["numbers"], **a["verdicts"]} for a in map(asdict, arms)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_csv(path, rows)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}", "Choose another folder with --out.") from error
