"""The judge: 180 fixed arms, answered by the code as it is, one row of a CSV an arm, and a summary.

    python -m benchmarks.judge --out FILE.csv [--only REGEX] [--jobs 2] [--arms runs/judge_arms]
    [--data ../shared/data]

Sixty arms of the challenge's laboratory, fifty of its workshop and twenty-five of its field, servo
arms in MuJoCo that give commands and positions alone, recordings of real robots and public reports.
What is not in the folder of arms is drawn and recorded there first; the same bytes are then
answered by every state of the code, which needs nothing but `diagnose`, `Question` and the command
`bag import` for it. Every arm is answered by a process of its own with one numeric thread: one that
fails is a row with its error. Whole answers are kept in FILE.answers; arms that are there are not
answered again, and scored again where the CSV is deleted.

A cause is right where the arm has it, at its joint; a truth is found where a cause or an
alternative of 5 % or more names it. A mass on a link and the numbers of that link are one truth;
an error of a sensor within three deviations that its file states is ordinary, and need not be
named. Brier and log score are means over all causes that were said,
and over truths that were not, whose confidence is 0; the log score takes 0.001 for less. A size is
one value of a cause that the arm has, and z its distance from the true one in standard deviations.
"""

import argparse
import csv
import itertools
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
SECONDS = 900  # of the wall clock, after which an arm counts as failed
DECLARED = 0.05
SURE = 0.9
INSIDE = 1.96
LEAST = 1e-3
# A mass fixed to a link and the numbers of that link are the same thing.
SYNONYMS = {"payload": "link_inertia_mismatch", "load": "link_inertia_mismatch"}
RATE = 1000.0  # samples/s of the drawn arms, for priors that depend on it
ANY = "any"  # joint of a truth that may be named anywhere
UNKNOWN = "unknown"
NONE = "none"
REFUSED = "refused"
FAILED = "failed"
COLUMNS = (
    "level", "arm", "kind", "truth", "verdict", "causes", "right", "false_causes", "z", "off",
    "told", "shrink", "cpu_seconds", "error",
)  # fmt: skip


@dataclass(frozen=True)
class Arm:
    """One arm and what is asked of it: paths are relative to the folder of arms, or to that of the
    data.

    `truth` holds what the arm has beyond its description, `allowed` what else may be said of it,
    `verdicts` what is right where no truth is to be found. What is said beside an incomplete truth
    is not judged.
    """

    name: str
    level: str
    kind: str
    fit: list[str]
    judge: list[str]
    truth: list[dict[str, Any]] = field(default_factory=list)
    allowed: list[list[str | None]] = field(default_factory=list)
    verdicts: list[str] = field(default_factory=list)
    complete: bool = True
    robot: str | None = None
    channels: str | None = None
    imported: str | None = None
    model: str = "mod3"
    refit: bool = False
    known: list[str] = field(default_factory=list)
    gains: dict[str, float] = field(default_factory=dict)
    without: str | None = None


# --- What is drawn
# --------------------------------------------------------------------------------------------------

SEEDS = {"laboratory": 720101, "workshop": 720102, "field": 720103}
CLEAN = {"laboratory": 8, "workshop": 4, "field": 3}
# arms of several effects
SETS = {"laboratory": (2,) * 6, "workshop": (2, 2, 2, 3), "field": (2, 3)}
FOREIGN = {"field": ("cogging_cable", "worn_zone")}  # all that the level has where none are named
# Effects whose arms are asked once more without them: no other law of the catalogue does what they
# do.
WITHHELD = {
    "laboratory": (
        "backlash", "base_tilt", "coulomb_friction", "encoder_eccentricity", "hysteresis",
        "joint_torque_gain", "load_dependent_friction", "motor_torque_gain", "nonlinear_stiffness",
        "stribeck_friction", "torque_ripple", "transmission_error", "viscous_friction",
    ),
    "workshop": ("hysteresis", "torque_ripple", "transmission_error"),
    "field": ("torque_ripple",),
}  # fmt: skip


def requests(level: str) -> list[Any]:
    """Return what is drawn of a level, in the order of its arms."""
    import numpy as np

    from elastic_arm.effects import EFFECTS
    from elastic_arm.studies.blind_challenge.campaign import Request, combines, effects_together
    from elastic_arm.studies.blind_challenge.levels import level_of

    found = level_of(level)
    rng = np.random.default_rng(SEEDS[level])
    alone = found.drawn(tuple(EFFECTS))
    together = [effect for effect in alone if combines(EFFECTS[effect])]
    sets = [effects_together(together, count, found, rng) for count in SETS[level]]
    kinds = (
        [()] * CLEAN[level]
        + [(effect,) for effect in (*alone, *FOREIGN.get(level, found.foreign))]
        + sets
    )
    names = [f"{level}_{k:03d}_{'_and_'.join(kind) or 'clean'}" for k, kind in enumerate(kinds)]
    return [
        Request(name, kind, (SEEDS[level], k), found.seconds)
        for k, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]


def record(arms: Path, level: str, request: Any) -> list[Arm]:
    """Draw and record one arm of a level; return what is asked of it."""
    from elastic_arm.effects import EFFECTS, Scope
    from elastic_arm.effects.effect import MODELS
    from elastic_arm.studies.blind_challenge.campaign import recorded
    from elastic_arm.studies.blind_challenge.effect_sampling import Fault, true_parameters
    from elastic_arm.studies.blind_challenge.levels import level_of

    name = request.name
    found = level_of(level)
    truth = json.loads(json.dumps(recorded(arms, request, found, EFFECTS)))
    joints = truth["joints"]
    effects = []
    foreign = bool(truth["foreign"])
    for fault in (Fault(**one) for one in truth["faults"]):
        effect = EFFECTS[fault.effect]
        joint = (
            len(joints) - 1 if effect.scope is Scope.LAST and fault.joint is None else fault.joint
        )
        sized = {} if fault.parameters.get("coupled") else true_parameters(fault, effect)
        effects.append(
            {
                "effect": fault.effect,
                "joint": None if joint is None else joints[joint],
                "parameters": {k: v for k, v in sized.items() if not effect.parameter(k).integer},
                "phases": [p.name for p in effect.parameters if p.role == "phase"],
            }
        )
    # A poorer model lacks more than the one effect that was asked for.
    allowed = [
        [e.id, None]
        for e in EFFECTS.values()
        if e.lacked_by != MODELS and truth["model"] in e.lacked_by
    ]
    allowed += [[c["effect"], joints[c["joint"]]] for c in truth["conditions"]]
    files = {folder: f"{folder}/{name}.yaml" for folder in ("robots", "channels")}
    kind = "foreign" if foreign else ("clean", "single", "pair", "triple")[len(request.effects)]
    verdicts = [UNKNOWN] if foreign else [NONE, "explained"]
    arm = Arm(
        name=name,
        level=level,
        kind=kind,
        fit=[f"bags/{name}_identify"],
        judge=[f"bags/{name}_validate"],
        truth=effects,
        allowed=allowed,
        verdicts=[*verdicts, NONE] if foreign and not truth["visible"] else verdicts,
        robot=files["robots"] if (arms / files["robots"]).is_file() else None,
        channels=files["channels"] if (arms / files["channels"]).is_file() else None,
        model=truth["model"],
        refit=found.asked.get("refit", False),
        known=found.asked.get("with", []),
        gains=found.asked.get("priors", {}).get("sensors", {}),
    )
    if kind != "single" or effects[0]["effect"] not in WITHHELD[level]:
        return [arm]
    effect = effects[0]["effect"]
    without = replace(
        arm, name=f"{name}_withheld", kind="withheld", truth=[], without=effect, verdicts=[UNKNOWN]
    )
    return [arm, without]


def _is(effect: str, joint: str | None, **parameters: Any) -> dict[str, Any]:
    return {"effect": effect, "joint": joint, "parameters": parameters, "phases": []}


@dataclass(frozen=True)
class RealRobot:
    """Recordings of a real robot: the folder of the data and its files, of which the first are
    fitted, and the arm."""

    folder: str
    mapping: str  # of `examples`, where the folder has none of its own
    files: tuple[str, ...]
    fitted: int
    robot: str

    def bags(self, arms: Path, data: Path) -> list[str]:
        """Import the recordings where they are not there yet; return the bags below the folder of
        arms."""
        mapping = ROOT / "examples" / self.folder / self.mapping
        found = []
        for file in self.files:
            bag = f"bags/{self.folder}_{Path(self.mapping).stem}_{Path(file).stem}"
            if not (arms / bag / "metadata.yaml").is_file():
                own = data / self.folder / self.mapping
                _import(
                    data / self.folder / file, mapping if mapping.is_file() else own, arms / bag
                )
            found.append(bag)
        return found


_KR300 = "kuka_kr300"
_LWR = "kuka_lwr4"
_GEN3 = "kinova_gen3"
_RUNS = tuple(f"run_{k}.mat" for k in "ACB")
ROBOTS = {
    "kr300_3": RealRobot(_KR300, "import_3.yaml", _RUNS, 2, "kr300_3_elastic.yaml"),
    "kr300_6": RealRobot(_KR300, "import_6.yaml", _RUNS, 2, "kr300_6_rigid.yaml"),
    "lwr4": RealRobot(
        _LWR, "import.yaml", tuple(f"measurements_{k}.npz" for k in (1, 2, 3)), 2, f"{_LWR}.urdf"
    ),
    "gen3": RealRobot(
        _GEN3,
        "import.yaml",
        tuple(f"opti_traj_testing{k}.csv" for k in (1, 2)),
        1,
        "gen3_2f85.urdf",
    ),
    "ur5e": RealRobot("ur5e_with_tool", "import.yaml", ("run_1.csv", "run_2.csv"), 1, "ur5e.urdf"),
}


def real_arms(arms: Path, data: Path) -> list[Arm]:
    """Import the recordings of real robots, and return what is asked of them and what is known to
    be true of each."""
    axes = [_is("time_delay", ANY), _is("encoder_offset", "a3"), _is("joint_spring", "a2")]
    dry = (9.0, 11.0, 6.0, 1.6, 1.5, 1.2)
    viscous = (10.0, 12.0, 7.0, 1.8, 1.6, 1.3)
    names = [
        f"{j}_joint"
        for j in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    ]
    of_ur5e = [
        *(_is("coulomb_friction", j, torque=size) for j, size in zip(names, dry, strict=True)),
        *(
            _is("viscous_friction", j, coefficient=size)
            for j, size in zip(names, viscous, strict=True)
        ),
        _is("payload", names[-1], mass=1.8, position=[0.01, 0.0, 0.06]),
        _is("time_delay", ANY, delay=0.012),
    ]
    friction = ["coulomb_friction", "viscous_friction"]
    refit = {"refit": True}
    known = {"refit": True, "known": friction}
    plan: list[tuple[str, str, list[Any], dict[str, Any]]] = [
        ("kuka_kr300_3", "kr300_3", axes, {}),
        ("kuka_kr300_3_refit", "kr300_3", axes, known),
        ("kuka_kr300_6_refit", "kr300_6", axes[2:], known),
        (
            "kuka_lwr4_refit",
            "lwr4",
            [_is("coulomb_friction", f"lwr_{k}_joint") for k in (0, 4)],
            refit,
        ),
        ("kinova_gen3_refit", "gen3", [], refit),
        ("ur5e_with_tool", "ur5e", of_ur5e, {"complete": True}),
        ("ur5e_with_tool_refit", "ur5e", of_ur5e, {"complete": True, **refit}),
    ]
    found = []
    for name, key, truth, asked in plan:
        one = ROBOTS[key]
        if not (data / one.folder).is_dir():
            print(f"{name}: left out, as {data / one.folder} is no folder", flush=True)
            continue
        bags = one.bags(arms, data)
        robot = str((data / one.folder / one.robot).resolve())
        asked = {"complete": False, "verdicts": [UNKNOWN], **asked}
        found.append(
            Arm(
                name,
                "real",
                "real",
                bags[: one.fitted],
                bags[one.fitted :],
                truth,
                robot=robot,
                **asked,
            )
        )
    return found


def reports(data: Path) -> list[Arm]:
    """Return what is asked of the small inputs after public reports; they are imported when they
    are asked."""
    folder = (data / "public_reports").resolve()
    if not folder.is_dir():
        print(f"public reports: left out, as {folder} is no folder", flush=True)
        return []
    dry = _is("coulomb_friction", "j1")
    viscous = _is("viscous_friction", "j1")
    sized = (
        _is("coulomb_friction", "j1", torque=0.3),
        _is("viscous_friction", "j1", coefficient=0.2),
    )
    clean = [NONE, "explained"]
    refuse = [REFUSED, UNKNOWN]
    plan: list[tuple[str, str, str, list[Any], list[str], str]] = [
        ("good", "good", "pend", [], clean, "clean"),
        ("stated_10x", "good", "pend_friction_10x", [dry, viscous], [], "pair"),
        ("plain", "good", "pend_plain", [*sized], [], "pair"),
        (
            "no_gravity",
            "no_gravity",
            "pend",
            [_is("gravity_compensation", ANY, share=1.0)],
            [],
            "single",
        ),
        ("wrapped", "wrapped", "pend", [], clean, "clean"),
        ("step", "step", "pend", [], refuse, "fault"),
        ("zeros_between", "zeros_between", "pend", [], [*refuse, NONE], "fault"),
        ("effort_held", "effort_held", "pend", [], refuse, "fault"),
        ("spring", "spring", "one", [], [UNKNOWN], "foreign"),
    ]
    return [
        Arm(
            f"report_{name}", "reports", kind, [f"{folder}/{stem}_1.csv"],
            [f"{folder}/{stem}_2.csv"], truth, verdicts=verdicts, robot=f"{folder}/{robot}.urdf",
            imported=f"{folder}/{robot.split('_')[0]}.yaml",
        )
        for name, stem, robot, truth, verdicts, kind in plan
    ]  # fmt: skip


def _import(file: Path | str, mapping: Path | str, bag: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "from elastic_arm.app import main; main()",
        "bag",
        "import",
        str(file),
    ]
    done = subprocess.run(
        [*command, "--map", str(mapping), "--out", str(bag)], text=True, capture_output=True
    )
    if done.returncode:
        said = " ".join(done.stderr.split())[-300:] or f"bag import ended with {done.returncode}"
        raise ImportRefused(said) if done.returncode == 2 else RuntimeError(said)


class ImportRefused(Exception):
    """`bag import` refused a file."""


def prepared(arms: Path, data: Path, jobs: int) -> list[Arm]:
    """Return all arms, after those that are not in the folder have been drawn and recorded."""
    from benchmarks.servo_arms import SEEDS as SERVO_SEEDS
    from benchmarks.servo_arms import drawn

    arms.mkdir(parents=True, exist_ok=True)
    kept = arms / "arms"
    kept.mkdir(exist_ok=True)
    missing = []
    for level in SEEDS:
        file = kept / f"{level}.txt"
        if not file.is_file():
            file.write_text("".join(f"{request.name}\n" for request in requests(level)))
        names = file.read_text().split()
        missing += [
            (level, k) for k, name in enumerate(names) if not (kept / f"{name}.json").is_file()
        ]
    if missing:
        print(f"recording {len(missing)} arms in {arms}", flush=True)
        with ThreadPoolExecutor(jobs) as pool:
            list(
                pool.map(
                    lambda job: _own_process(["--record", str(arms), job[0], str(job[1])]), missing
                )
            )
    found = []
    for level in SEEDS:
        for name in (kept / f"{level}.txt").read_text().split():
            found += [Arm(**one) for one in json.loads((kept / f"{name}.json").read_text())]
    for level in SERVO_SEEDS:
        file = kept / f"{level}_arms.json"
        if not file.is_file():
            file.write_text(
                json.dumps([asdict(Arm(**one)) for one in drawn(arms, level)], indent=1)
            )
        found += [Arm(**one) for one in json.loads(file.read_text())]
    file = kept / "real.json"
    if not file.is_file() and data.is_dir():
        file.write_text(
            json.dumps([asdict(arm) for arm in (*real_arms(arms, data), *reports(data))], indent=1)
        )
    return found + [Arm(**one) for one in (json.loads(file.read_text()) if file.is_file() else ())]


def _own_process(arguments: list[str], seconds: float | None = None) -> None:
    """Run this module in a process of its own, with one numeric thread."""
    command = [sys.executable, "-m", "benchmarks.judge", *arguments]
    environment = {**os.environ, **ONE_THREAD}
    done = subprocess.run(command, env=environment, timeout=seconds, text=True, capture_output=True)
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"signal or status {done.returncode}"]
        raise RuntimeError(said[-1])


# --- How it is answered
# --------------------------------------------------------------------------------------------


def answer(arm: Arm, arms: Path) -> dict[str, Any]:
    """Ask the code of one arm, through nothing but what it exports."""
    from elastic_arm.diagnosis import Priors, Question, diagnose
    from elastic_arm.effects import Catalogue
    from elastic_arm.effects.text import known_effects
    from elastic_arm.errors import ElasticArmError
    from elastic_arm.recording import load_channels, read_recording
    from elastic_arm.robot import load_robot

    began = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            paths = [[arms / one for one in files] for files in (arm.fit, arm.judge)]
            if arm.imported:
                for k, files in enumerate(paths):
                    for i, file in enumerate(files):
                        bag = Path(folder, f"{k}_{i}")
                        _import(file, arm.imported, bag)
                        paths[k][i] = bag
            channels = None if arm.channels is None else load_channels(arms / arm.channels)
            fit, judge = ([read_recording(path, channels) for path in files] for files in paths)
        robot = load_robot(None if arm.robot is None else arms / arm.robot)
        catalogue = Catalogue.default()
        if arm.without:
            catalogue = catalogue.withholding(arm.without)
        asked: dict[str, Any] = {
            "refit": arm.refit,
            "given": known_effects(arm.known, robot, catalogue),
        }
        if arm.gains:
            asked["priors"] = Priors(sensors=arm.gains)
        began = time.process_time()
        found = diagnose(
            fit, Question(robot, arm.model, catalogue=catalogue, **asked), judge
        ).to_dict()
    except (ElasticArmError, ImportRefused) as error:  # to refuse is an answer
        found = {"verdict": REFUSED, "causes": [], "shrink": None, "error": str(error)}
    return found | {"cpu_seconds": time.process_time() - began}


# --- What an answer is worth
# ---------------------------------------------------------------------------------------


def _meets(truth: Mapping[str, Any], effect: str, joint: str | None) -> bool:
    names = (truth["effect"], SYNONYMS.get(truth["effect"]))
    return effect in names and truth["joint"] in (ANY, joint)


def _is_ordinary(truth: Mapping[str, Any]) -> bool:
    """Whether a true error of a sensor is within three deviations that its file states.

    The contract calls it ordinary: it need not be named.
    """
    from elastic_arm.effects import EFFECTS
    from elastic_arm.evidence.priors import ORDINARY

    effect = EFFECTS[truth["effect"]]
    prior = getattr(effect, "prior", None)
    if prior is None:
        return False
    sizes = [p for p in effect.parameters if p.name in truth["parameters"]]
    off = [abs(truth["parameters"][p.name] - (p.neutral or 0.0)) for p in sizes]
    return bool(off) and max(off) <= ORDINARY * prior(RATE)


def distances(truth: Mapping[str, Any], cause: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return by how many standard deviations the sizes of a cause are off, and by which share of
    the true ones.

    Where the arm had the effect before a `change` of it, that is the share.
    """
    found = []
    for name, true in truth["parameters"].items():
        said = cause["parameters"].get(name)
        if said is None or said["std"] is None:
            continue
        change = truth.get("change", truth["parameters"])[name]
        columns = (
            v if isinstance(v, list) else [v] for v in (said["value"], said["std"], true, change)
        )
        for value, std, right, part in zip(*columns, strict=True):
            off = value - right
            if name in truth["phases"]:
                off = (off + math.pi) % (2 * math.pi) - math.pi
            if std:
                found.append((off / std, off / part if part else math.inf))
    return found


def _grown(truth: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]) -> bool:
    """Whether an effect that was there before a change is said with half of the change, or more."""
    own = (
        c
        for c in causes
        if "change" in truth and truth["before"] and _meets(truth, c["effect"], c["joint"])
    )
    return all(abs(part) <= 0.5 for c in own for _, part in distances(truth, c))


def row(arm: Arm, found: Mapping[str, Any]) -> dict[str, str]:
    """Return an answer as a row of the CSV."""
    causes = found["causes"]
    said = [any(_meets(t, c["effect"], c["joint"]) for t in arm.truth) for c in causes]
    allowed = [[c["effect"], c["joint"]] in arm.allowed for c in causes]
    named = [
        [(c["effect"], c["joint"])]
        + [(a["effect"], a["joint"]) for a in c["alternatives"] if a["confidence"] >= DECLARED]
        for c in causes
    ]
    held = [
        _is_ordinary(t)
        or (any(_meets(t, *one) for every in named for one in every) and _grown(t, causes))
        for t in arm.truth
    ]
    if arm.truth:
        right = all(held)
    else:
        no_cause = arm.kind != "clean" or all(allowed)
        right = found["verdict"] in arm.verdicts and no_cause
    judged = [
        (c, s or a) for c, s, a in zip(causes, said, allowed, strict=True) if s or a or arm.complete
    ]
    told = [(c["confidence"], r) for c, r in judged]
    told += [
        (0.0, True)
        for t in arm.truth
        if not any(_meets(t, c["effect"], c["joint"]) for c in causes)
    ]
    sizes = [
        d
        for t in arm.truth
        for c in causes
        if _meets(t, c["effect"], c["joint"])
        for d in distances(t, c)
    ]
    return {
        "level": arm.level,
        "arm": arm.name,
        "kind": arm.kind,
        "truth": "; ".join(_text(t) for t in arm.truth),
        "verdict": found["verdict"],
        "causes": "; ".join(f"{_text(c)} {c['confidence']:.3f}" for c in causes),
        "right": str(int(right)),
        "false_causes": "; ".join(_text(c) for c, r in judged if c["confidence"] >= SURE and not r),
        "z": "; ".join(f"{v:.2f}" for v, _ in sizes),
        "off": "; ".join(f"{v:.3f}" for _, v in sizes),
        "told": "; ".join(f"{p:.4f}:{int(r)}" for p, r in told),
        "shrink": "" if found.get("shrink") is None else f"{found['shrink']:.3f}",
        "cpu_seconds": f"{found['cpu_seconds']:.1f}",
        "error": found.get("error", ""),
    }


def _text(one: Mapping[str, Any]) -> str:
    return f"{one['effect']}:{one['joint']}" if one["joint"] else one["effect"]


# --- The summary
# --------------------------------------------------------------------------------------------------

HEADINGS = (
    "level", "kind", "right", "false cause at 0.9", "sizes cover", "within 10 % or 2 deviations",
    "Brier", "log score", "cpu s, longest",
)  # fmt: skip


def summary(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the table by level and kind, Clopper-Pearson intervals at 95 %."""
    lines = [HEADINGS]
    for level in (*dict.fromkeys(r["level"] for r in rows), None):
        of_level = [r for r in rows if level in (None, r["level"])]
        kinds = sorted({r["kind"] for r in of_level}) if level else []
        for kind in (*kinds, None):
            some = [r for r in of_level if kind in (None, r["kind"])]
            if some and not (kind is None and len(kinds) == 1):
                lines.append((level or "all", kind or "all", *_figures(some)))
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    text = "\n".join(
        "  ".join(v.ljust(w) for v, w in zip(line, widths, strict=True)).rstrip() for line in lines
    )
    bins = [(low, high, *_bin(rows, low, high)) for low, high in itertools.pairwise(BINS)]
    told = "\n".join(
        f"said {lo:g} to {hi:g}: mean {mean:.3f}, true {text}"
        for lo, hi, mean, text in bins
        if text
    )
    return f"{text}\n\n{told}"


BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0001)


def _bin(rows: Sequence[Mapping[str, str]], low: float, high: float) -> tuple[float, str]:
    inside = [(p, r) for p, r in _told(rows) if low <= p < high and p > 0.0]
    if not inside:
        return 0.0, ""
    return sum(p for p, _ in inside) / len(inside), share(r for _, r in inside)


def _told(rows: Iterable[Mapping[str, str]]) -> list[tuple[float, bool]]:
    pairs = [one.split(":") for r in rows for one in r["told"].split("; ") if one]
    return [(float(p), held == "1") for p, held in pairs]


def _figures(rows: Sequence[Mapping[str, str]]) -> tuple[str, ...]:
    told = _told(rows)
    z = [float(v) for r in rows for v in r["z"].split("; ") if v]
    off = [float(v) for r in rows for v in r["off"].split("; ") if v]
    brier = log = "–"
    if told:
        brier = f"{sum((p - held) ** 2 for p, held in told) / len(told):.3f}"
        given = [max(p if held else 1.0 - p, LEAST) for p, held in told]
        log = f"{-sum(map(math.log, given)) / len(given):.3f}"
    seconds = [float(r["cpu_seconds"]) for r in rows]
    return (
        share(r["right"] == "1" for r in rows),
        share(bool(r["false_causes"]) for r in rows),
        share(abs(v) <= INSIDE for v in z),
        share(abs(v) <= 2.0 or abs(part) <= 0.1 for v, part in zip(z, off, strict=True)),
        brier,
        log,
        f"{sum(seconds):.0f}, {max(seconds):.0f}",
    )


def share(outcomes: Iterable[bool]) -> str:
    """Return a share with its interval as text."""
    from scipy.stats import binomtest

    held = list(outcomes)
    if not held:
        return "–"
    interval = binomtest(sum(held), len(held)).proportion_ci(0.95, "exact")
    return f"{sum(held)}/{len(held)} ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


# --- The command
# --------------------------------------------------------------------------------------------------


def judge(arms: Sequence[Arm], folder: Path, out: Path, jobs: int) -> list[dict[str, str]]:
    """Answer arms that the CSV does not hold; return all its rows."""
    rows = list(csv.DictReader(out.open(encoding="utf-8"))) if out.is_file() else []
    waiting = [arm for arm in arms if arm.name not in {r["arm"] for r in rows}]
    answers = out.with_suffix(".answers")
    answers.mkdir(parents=True, exist_ok=True)

    def answered(arm: Arm) -> dict[str, str]:
        file = answers / f"{arm.name}.json"
        try:
            if not file.is_file():
                _own_process(["--answer", str(folder), arm.name, str(file)], SECONDS)
            return row(arm, json.loads(file.read_text()))
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            failed = {
                "verdict": FAILED,
                "causes": [],
                "cpu_seconds": 0.0,
                "error": f"{type(error).__name__}: {error}",
            }
            return row(arm, failed)

    with out.open("a", encoding="utf-8", newline="") as file, ThreadPoolExecutor(jobs) as pool:
        writer = csv.DictWriter(file, COLUMNS)
        if not rows:
            writer.writeheader()
        futures = [pool.submit(answered, arm) for arm in waiting]
        for done, future in enumerate(as_completed(futures), 1):
            rows.append(found := future.result())
            writer.writerow(found)
            file.flush()
            mark = "right" if found["right"] == "1" else "wrong"
            print(
                f"{done}/{len(waiting)} {found['arm']}: {mark}, {found['cpu_seconds']} s",
                flush=True,
            )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Answer all arms and print the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/judge.csv"))
    parser.add_argument("--only", default="", help="regular expression that the names of arms hold")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--arms", type=Path, default=Path("runs/judge_arms"), help="folder of the recordings"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=ROOT.parent / "shared" / "data",
        help="recordings of real robots",
    )
    parser.add_argument("--record", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--answer", nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.record:
        arms = Path(asked.record[0])
        level = asked.record[1]
        number = int(asked.record[2])
        request = requests(level)[number]
        found = [asdict(arm) for arm in record(arms, level, request)]
        (arms / "arms" / f"{request.name}.json").write_text(json.dumps(found, indent=1))
        return
    if asked.answer:
        folder = Path(asked.answer[0])
        name = asked.answer[1]
        file = Path(asked.answer[2])
        listed = (
            one
            for kept in sorted((folder / "arms").glob("*.json"))
            for one in json.loads(kept.read_text())
        )
        arm = next(Arm(**one) for one in listed if one["name"] == name)
        file.write_text(json.dumps(answer(arm, folder), indent=1))
        return
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    arms = [
        arm
        for arm in prepared(asked.arms, asked.data, asked.jobs)
        if re.search(asked.only, arm.name)
    ]
    print(summary(judge(arms, asked.arms, asked.out, asked.jobs)))


if __name__ == "__main__":
    main()
