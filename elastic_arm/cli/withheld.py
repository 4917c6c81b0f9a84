"""The last part of the demonstration: an arm with an effect that is withheld from the diagnosis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.markup import escape

from elastic_arm.cli.console import err, out
from elastic_arm.cli.diagnose import print_diagnosis, write_diagnosis
from elastic_arm.diagnosis import Question, diagnose, follow_up
from elastic_arm.diagnosis.words import instance_text
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.excitation import FourierTrajectory, MotionLimits, random_trajectories
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import Robot
from elastic_arm.simulation import SimulationSettings, simulate


def diagnose_withheld(folder: Path, nominal: Robot, motion: FourierTrajectory, rng: np.random.Generator) -> None:
    """Record an arm with a drawn effect on two motions, diagnose the bags, and print what was drawn afterwards."""
    drawn = _draw(nominal, rng)
    other = random_trajectories(build_model(nominal), MotionLimits.of(nominal), 1, rng=rng)[0]
    with err.status("recording the arm on two motions"):
        for name, trajectory in (("identify", motion), ("validate", other)):
            write_recording(folder / name, simulate(nominal, trajectory, SimulationSettings(effects=[drawn]), rng=rng))
    with err.status("diagnosing"):
        fitted, judged = (read_recording(folder / name) for name in ("identify", "validate"))
        found = follow_up(diagnose([fitted], Question(nominal), [judged]), rng=rng)
        write_diagnosis(found, nominal, folder)
    print_diagnosis(found, folder)
    words = f"{drawn.effect.id} on {drawn.joint}, {instance_text(drawn, nominal.units)}"
    out.print(f"what had been drawn: {escape(words)}")


def _draw(robot: Robot, rng: np.random.Generator) -> EffectInstance:
    """Draw one of the effects whose file names clear examples, its joint, and its numbers from these."""
    drawn = {e.id: e for e in EFFECTS.values() if e.parameters and e.parameter(e.magnitude[0]).example}
    effect = drawn[str(rng.choice(sorted(drawn)))]
    sizes = {p.name: float(rng.uniform(*p.example)) for p in effect.parameters if p.example}
    return EffectInstance(effect, str(rng.choice(robot.joint_names)), sizes)
