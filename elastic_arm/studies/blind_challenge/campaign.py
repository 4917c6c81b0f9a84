"""Making and diagnosing many hidden arms, in parallel; what is there already is not done again."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import elastic_arm
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.priors import Priors
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import DiagnosisError, RecordingError, SimulationError
from elastic_arm.input_files import read_text
from elastic_arm.memory import keep_memory
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.arm_sampling import HIGHEST, LOWEST, SamplingRequest, sample_arm
from elastic_arm.studies.blind_challenge.baseline import baseline_answer
from elastic_arm.studies.blind_challenge.effect_sampling import combines, model_of
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.levels.level import (
    KNOWN_FRICTION,
    LABORATORY,
    ChallengeLevel,
    drawn_effects,
    foreign_effects,
    level_of,
    stated_priors,
)
from elastic_arm.studies.blind_challenge.levels.recording import channels_path, description_path, record_realistic_arm
from elastic_arm.studies.blind_challenge.parallel_jobs import Failure, mapped
from elastic_arm.studies.blind_challenge.sealed_truth import NAME, drop_pieces, open_sealed, pieces, seal, seal_piece
from elastic_arm.studies.blind_challenge.simulated_arm import arm_maker

MANIFEST = "challenge.json"
MAKE_ONE = "Name the folder of a challenge, or make one in a new folder: elastic-arm challenge create DIR"
# Folders of answers: of the diagnosis, of the diagnosis without the arm's effect, and of plain least squares with BIC.
ANSWERS, WITHHELD, BASELINE = "answers", "withheld", "baseline"
FILES = "effects"  # folder of a challenge that holds copies of the files with effects of the user
SET_DRAWS = 1000  # of a set of effects, until one kind of sensors shows all of them
DRAWS = 4  # of an arm that the simulation leaves the finite numbers with
STATE_OF = ("codegen", "dynamics", "effects", "estimation", "diagnosis")  # packages whose code gives the answers
REFUSED: dict[str, Any] = {
    "verdict": "refused", "causes": [], "unexplained": [], "shrink": None, "measured_by": "excess",
    "log_likelihood": 0.0,
}  # fmt: skip
Report = Callable[[int, int], None]


@dataclass(frozen=True)
class ChallengeSettings:
    """What a challenge consists of."""

    seed: int = 0  # the same seed draws the same arms
    # per_effect, clean, pairs, triples: Recordings of each effect alone, of the plain arm, and of two and three effects
    per_effect: int = 1
    clean: int = 4
    pairs: int = 4
    triples: int = 0
    # seconds, validate_seconds: Durations of the two recordings of each arm
    seconds: float = 12.0
    validate_seconds: float = 8.0
    ratio: tuple[float, float] = (LOWEST, HIGHEST)  # range of sizes over the smallest that theory allows to be detected
    effects: tuple[str, ...] = ()  # ids; all where none is given
    effects_files: tuple[str, ...] = ()  # python files with effects of the user
    level: str = LABORATORY  # laboratory, workshop or field
    foreign: int = 0  # recordings of each effect that no catalogue has; the laboratory has none

    def requests(self, catalogue: Catalogue = EFFECTS) -> list[SamplingRequest]:
        """Return what is to be drawn of a catalogue, in a random order."""
        searched = tuple(effect for effect in catalogue if catalogue[effect].searched)
        alone = self.effects or drawn_effects(searched, self.level)
        together = [e for e in alone if combines(catalogue[e])]
        rng = np.random.default_rng(self.seed)
        kinds: list[tuple[str, ...]] = [()] * self.clean + [(e,) for e in alone for _ in range(self.per_effect)]
        for count, times in ((2, self.pairs), (3, self.triples)):
            if times and len(together) < count:
                raise DiagnosisError(f"{len(together)} effects make no set of {count}", "Name more with --effect")
            kinds += [self._drawn_set(together, count, rng) for _ in range(times)]
        kinds += [(e,) for e in foreign_effects(self.level) for _ in range(self.foreign)]
        durations = (self.seconds, self.validate_seconds)
        return [
            SamplingRequest(f"arm_{k:04d}", kinds[i], (self.seed, int(i)), durations, self.ratio)
            for k, i in enumerate(rng.permutation(len(kinds)))
        ]

    def _drawn_set(self, together: Sequence[str], count: int, rng: np.random.Generator) -> tuple[str, ...]:
        """Draw effects that the sensors of one arm can show together."""
        level = level_of(self.level)
        for _ in range(SET_DRAWS):
            drawn = tuple(str(e) for e in rng.choice(together, count, replace=False))
            if level is None or level.common_sides(drawn):
                return drawn
        raise DiagnosisError(
            f"no {count} of these effects show with the same sensors",
            "Name others with --effect, or take another --level.",
        )


def create(
    folder: Path,
    settings: ChallengeSettings,
    *,
    workers: int = 0,
    scheduler: str | None = None,
    report: Report | None = None,
) -> str:
    """Draw hidden arms and record them; return the SHA-256 of the sealed truth."""
    plain = json.loads(json.dumps(asdict(settings)))
    manifest_path = folder / MANIFEST
    if manifest_path.exists():
        known = _read_manifest(manifest_path)
        if json.loads(json.dumps(asdict(ChallengeSettings()))) | known["settings"] != plain:
            raise DiagnosisError(f"{folder} holds another challenge", "Choose another folder")
        if "truth_sha256" in known:
            return str(known["truth_sha256"])
    catalogue = Catalogue.default().with_files(settings.effects_files)
    requests = settings.requests(catalogue)
    if not requests:
        raise DiagnosisError("a challenge of no arms", "Ask for some: --per-effect, --clean, --pairs or --triples")
    folder.mkdir(parents=True, exist_ok=True)
    _copy_files(folder, settings.effects_files)
    items = [{"name": o.name, "model": model_of(o.of_catalogue, catalogue)} for o in requests]
    own = sorted({e for o in requests for e in o.effects} - KNOWN - set(FOREIGN))
    manifest = {"settings": plain, "items": items, "simulated": own}
    if settings.level != LABORATORY:
        manifest["question"] = {"refit": True, "with": list(KNOWN_FRICTION), "priors": stated_priors(settings.level)}
    _write(manifest_path, manifest)
    made = pieces(folder)
    jobs = [(str(folder), request, settings.level) for request in requests if request.name not in made]
    for done, outcome in enumerate(mapped(_record, jobs, workers, scheduler), 1):
        if isinstance(outcome, Failure):
            raise DiagnosisError(f"{outcome.job[1].name} was not recorded: {outcome.problem}", "Report this")
        if report:
            report(done, len(jobs))
    digest = seal(folder, [o.name for o in requests])
    _write(manifest_path, manifest | {"truth_sha256": digest})
    drop_pieces(folder)
    return digest


def solve(
    folder: Path,
    *,
    kind: str = ANSWERS,
    stale: bool = False,
    workers: int = 0,
    scheduler: str | None = None,
    report: Report | None = None,
) -> dict[str, str]:
    """Diagnose every recording that has no answer yet; return what went wrong, by name."""
    manifest = load_manifest(folder)
    without = _own_effects(folder, manifest) if kind == WITHHELD else {}
    jobs = []
    for item in manifest["items"]:
        path = answer_path(folder, item["name"], kind)
        if kind == WITHHELD and item["name"] not in without:
            continue
        if not path.is_file() or (stale and json.loads(path.read_text()).get("code") != code_state()):
            jobs.append((str(folder), item["name"], item["model"], without.get(item["name"], ""), kind))
    wrong = {}
    for done, outcome in enumerate(mapped(_diagnose, jobs, workers, scheduler), 1):
        if isinstance(outcome, Failure):
            wrong[outcome.job[1]] = outcome.problem
        elif outcome[1]:
            wrong[outcome[0]] = outcome[1]
        if report:
            report(done, len(jobs))
    return wrong


def load_manifest(folder: Path) -> dict[str, Any]:
    """Return a challenge's manifest."""
    manifest = _read_manifest(folder / MANIFEST)
    if "truth_sha256" not in manifest or not (folder / NAME).is_file():
        raise DiagnosisError(f"{folder} holds a challenge that is not complete", "Go on with challenge create")
    return manifest


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(read_text(path, DiagnosisError, MAKE_ONE))
    except (ValueError, RecursionError):
        manifest = None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("settings"), dict):
        raise DiagnosisError(f"{path} is no manifest of a challenge", MAKE_ONE)
    return manifest


def answer_path(folder: Path, name: str, kind: str = ANSWERS) -> Path:
    """Where the diagnosis of an item stands."""
    return folder / kind / f"{name}.json"


@lru_cache(maxsize=1)
def code_state() -> str:
    """Return a name for the state of the code that gives the answers."""
    root = Path(elastic_arm.__file__).parent
    files = sorted(f for package in STATE_OF for f in (root / package).rglob("*.py"))
    return hashlib.sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest()[:12]


@lru_cache(maxsize=1)
def _robot() -> Robot:
    return load_robot(None)


def catalogue_of(folder: Path) -> Catalogue:
    """Return the effects of a challenge: the default catalogue and those of its own files."""
    return _catalogue(tuple(sorted((folder / FILES).glob("*.py"))))


@lru_cache(maxsize=4)
def _catalogue(files: tuple[Path, ...]) -> Catalogue:
    return Catalogue.default().with_files(files)


def _copy_files(folder: Path, files: tuple[str, ...]) -> None:
    """Keep the files with effects of the user, so that every worker finds them and the challenge can be run again."""
    for k, file in enumerate(files):
        kept = folder / FILES / f"{k}_{Path(file).name}"
        kept.parent.mkdir(exist_ok=True)
        shutil.copyfile(file, kept)


def _own_effects(folder: Path, manifest: dict[str, Any]) -> dict[str, str]:
    truth = open_sealed(folder, manifest["truth_sha256"])
    return {item["name"]: item["faults"][0]["effect"] for item in truth if len(item["faults"]) == 1}


def _bags(folder: Path, name: str) -> tuple[Path, Path]:
    return folder / "bags" / f"{name}_identify", folder / "bags" / f"{name}_validate"


def _record(job: tuple[str, SamplingRequest, str]) -> str:
    folder, request, level = Path(job[0]), job[1], level_of(job[2])
    rng, catalogue = np.random.default_rng(request.seed), catalogue_of(folder)
    if level is not None:
        seal_piece(folder, request.name, _recorded(folder, request, level, catalogue))
        return request.name
    item, motions = sample_arm(request, _robot(), rng, catalogue)
    arm = arm_maker(_robot(), request.effects, catalogue)(item.faults)
    for bag, motion in zip(_bags(folder, item.name), motions, strict=True):
        recording = arm.record(motion, item.instruments, rng)
        if not (bag / "metadata.yaml").is_file():
            shutil.rmtree(bag, ignore_errors=True)  # what a run that was broken off has left
            bag.parent.mkdir(parents=True, exist_ok=True)
            write_recording(bag, recording)
    seal_piece(folder, item.name, item.truth())
    return item.name


def _recorded(folder: Path, request: SamplingRequest, level: ChallengeLevel, catalogue: Catalogue) -> dict[str, Any]:
    """Record an arm of a level and return its truth; one that no simulation gets through is drawn again."""
    bags = _bags(folder, request.name)
    for draw in range(DRAWS - 1):
        seed = (*request.seed, draw) if draw else request.seed
        try:
            return record_realistic_arm(folder, bags, replace(request, seed=seed), level, catalogue)
        except SimulationError:
            for bag in bags:
                shutil.rmtree(bag, ignore_errors=True)
    return record_realistic_arm(folder, bags, replace(request, seed=(*request.seed, DRAWS)), level, catalogue)


def _diagnose(job: tuple[str, str, str, str, str]) -> tuple[str, str]:
    keep_memory()
    folder, name, model, without, kind = Path(job[0]), *job[1:]
    catalogue = catalogue_of(folder).withholding(without) if without else catalogue_of(folder)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        channels = channels_path(folder, name)
        identify, validate = (read_recording(bag, channels) for bag in _bags(folder, name))
        question = _question(folder, name, model, catalogue)
        if kind == BASELINE:
            answer, problem = baseline_answer(identify, validate, question), ""
        else:
            answer, problem = diagnose([identify], question, [validate]).to_dict(), ""
    except (DiagnosisError, RecordingError) as error:  # to refuse is an answer too, and counts as one
        answer, problem = REFUSED | {"notes": [str(error)]}, str(error)
    spent = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    path = answer_path(folder, name, kind)
    path.parent.mkdir(parents=True, exist_ok=True)
    _write(path, answer | spent | {"code": code_state()})
    return name, problem


def _question(folder: Path, name: str, model: str, catalogue: Catalogue) -> Question:
    """Return what is asked of an arm's recordings: its description, and what its challenge counts as ordinary."""
    path = description_path(folder, name)
    robot = _robot() if path is None else load_robot(path)
    asked = _asked(folder)
    given = known_effects(asked.get("with", ()), robot, catalogue)
    settings = replace(DiagnosisSettings(), priors=Priors.model_validate(asked.get("priors", {})))
    refit = bool(asked.get("refit", False))
    return Question(robot, model, refit=refit, given=given, catalogue=catalogue, settings=settings)


def _asked(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    return dict(json.loads(path.read_text()).get("question", {})) if path.is_file() else {}


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write JSON so that a run that is broken off leaves no half of a file."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(path)
