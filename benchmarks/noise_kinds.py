"""Verdicts on arms whose sensors are noisy in other ways than white. ``python -m
benchmarks.noise_kinds``.

Arms of the challenge's engine, apart from the diagnosis: one with nothing more than its
description, and others with one effect each. The same true motion gets each kind of noise
(`tests/helpers/noise_kinds.py`). A line states verdict and causes; a clean arm must come out
`none`, an effect by its name, and no other cause at a confidence of 0.9.
"""

import argparse
import time
from functools import cache

import numpy as np

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.recording import Samples
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from tests.helpers.noise_kinds import KINDS, recording

ROBOT = load_robot(None)
FAULTS = {
    "clean": None,
    "coulomb_friction": Fault("coulomb_friction", 1, {"torque": 3.0}),
    "viscous_friction": Fault("viscous_friction", 2, {"coefficient": 3.0}, side="link"),
    "joint_torque_offset": Fault("joint_torque_offset", 0, {"offset": 1.5}),
    "stiffness_mismatch": Fault("stiffness_mismatch", 1, {"stiffness": 0.85}),
    "hysteresis": Fault("hysteresis", 1, {"torque": 5.0, "width": 1e-4}),
    "payload": Fault(
        "payload", None, {"mass": 2.0, "position_x": 0.05, "position_y": 0.0, "position_z": 0.1}
    ),
    "torque_ripple": Fault("torque_ripple", 0, {"amplitude": 1.5, "phase": 0.4, "order": 1.0}),
    "motor_torque_gain": Fault("motor_torque_gain", 1, {"gain": 1.05}),
}
SECONDS = (20.0, 12.0)


@cache
def truth(fault: str, seed: int) -> tuple[Samples, Samples]:
    """Return what exact sensors read of an arm with one effect, to fit and to judge."""
    rng = np.random.default_rng(seed)
    given = FAULTS[fault]
    arm = HiddenArm(ROBOT, [given] if given else [])
    exact = SensorModel(torque_noise=0.0, velocity_noise=0.0)
    first, second = (
        arm.record(random_motion(rng, ROBOT.n, s), exact, rng).samples() for s in SECONDS
    )
    return first, second


def judged(kind: str, fault: str, seed: int, *, refit: bool) -> Diagnosis:
    """Diagnose an arm with a kind of noise.

    Parameters
    ----------
    kind
        Of noise.
    fault
        Of :data:`FAULTS`.
    seed
        Of motion and noise.
    refit
        As of `elastic-arm diagnose`.
    """
    rng = np.random.default_rng([seed, 1])
    names = ("q", "dq", "theta", "dtheta", "tau_J", "tau_m")
    runs = [
        recording(kind, run.t, {name: getattr(run, name) for name in names}, rng, f"run_{k}")
        for k, run in enumerate(truth(fault, seed))
    ]
    return diagnose(runs[:1], Question(ROBOT, refit=refit), runs[1:])


def right(fault: str, found: Diagnosis) -> str:
    """Return "right", "missed" or "false": the effect named or not, another one at a confidence of
    0.9."""
    given = FAULTS[fault]
    named = [given is not None and c.effect == given.effect for c in found.causes]
    if any(c.confidence >= 0.9 and not good for c, good in zip(found.causes, named, strict=True)):
        return "false"
    good = found.verdict == "none" and not found.causes if given is None else any(named)
    return "right" if good else "missed"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--faults", nargs="*", default=["clean"])
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--refit", action="store_true")
    args = parser.parse_args()
    count: dict[str, int] = {}
    for kind in args.kinds:
        for fault in args.faults:
            for seed in args.seeds:
                start = time.process_time()
                found = judged(kind, fault, seed, refit=args.refit)
                outcome = right(fault, found)
                count[outcome] = count.get(outcome, 0) + 1
                causes = (
                    ", ".join(f"{c.effect} {c.joint} {c.confidence:.2f}" for c in found.causes)
                    or "–"
                )
                print(
                    f"{kind:18} {fault:20} {seed} {outcome:7} {found.verdict:9} {causes} "
                    f"({time.process_time() - start:.1f} s)",
                    flush=True,
                )
    print(", ".join(f"{n} {what}" for what, n in sorted(count.items())))


if __name__ == "__main__":
    main()
