"""Creation and diagnosis of many hidden arms in parallel; existing results are not repeated."""

import base64
import hashlib
import json
import shutil
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import elastic_arm
from elastic_arm.diagnosis import Priors, Question, diagnose
from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import DiagnosisError, ElasticArmError, SimulationError
from elastic_arm.input_files import read_text
from elastic_arm.memory import keep_memory
from elastic_arm.output_files import write_result
from elastic_arm.processes import ProcessPool
from elastic_arm.recording import load_channels, read_recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.answers import changes_told
from elastic_arm.studies.blind_challenge.draw import (
    HIGHEST,
    LOWEST,
    Request,
    bags_of,
    channels_path,
    description_path,
    record,
)
from elastic_arm.studies.blind_challenge.effect_sampling import combines, model_of
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.levels import LABORATORY, Level, level_of
from elastic_arm.studies.blind_challenge.servo_arms import record_servos

MANIFEST = "challenge.json"
SEALED = "truth.sealed"
PIECES = "truth"
MAKE_ONE = (
    "Give the folder of a challenge, or create one in a new folder: elastic-arm"
    " challenge create DIR"
)
ANSWERS = "answers"  # folder of answers with the whole catalogue
WITHHELD = "withheld"  # folder of answers without the arm's effect
FILES = "effects"  # folder of a challenge that holds copies of the files with effects of the user
SET_DRAWS = 1000  # of a set of effects, until one kind of sensors shows all of them
DRAWS = 4  # of an arm that the simulation leaves the finite numbers with
UNANSWERED = ("studies", "nodes", "report", "cli")  # packages that have no part in an answer
REFUSED: dict[str, Any] = {"verdict": "refused", "causes": [], "unexplained": [], "shrink": None}
Report = Callable[[int, int], None]


@dataclass(frozen=True)
class ChallengeSettings:
    """What a challenge consists of."""

    seed: int = 0
    per_effect: int = (
        1  # recordings of each effect alone; of the plain arm, of two and of three effects:
    )
    clean: int = 4
    pairs: int = 4
    triples: int = 0
    seconds: tuple[float, ...] | None = (
        None  # of the recordings of each arm; the level's own where None
    )
    # range of sizes over the smallest that theory lets detect
    ratio: tuple[float, float] = (LOWEST, HIGHEST)
    effects: tuple[str, ...] = ()  # ids; all where none is given
    effects_files: tuple[str, ...] = ()  # Python files with effects of the user
    level: str = LABORATORY.name
    foreign: int = 0  # recordings of each effect that no catalogue has

    def requests(self, catalogue: Catalogue = EFFECTS) -> list[Request]:
        """Return what is to be drawn of a catalogue, in a random order."""
        level = level_of(self.level)
        rng = np.random.default_rng(self.seed)
        alone = self.effects or level.drawn([e for e in catalogue if catalogue[e].searched])
        together = [e for e in alone if combines(catalogue[e])]
        kinds: list[tuple[str, ...]] = [()] * self.clean + [
            (e,) for e in alone for _ in range(self.per_effect)
        ]
        for count, times in ((2, self.pairs), (3, self.triples)):
            if times and len(together) < count:
                raise DiagnosisError(
                    f"{len(together)} effects are not enough for a set of {count}",
                    "Give more with --effect",
                )
            kinds += [effects_together(together, count, level, rng) for _ in range(times)]
        kinds += [(e,) for e in level.foreign for _ in range(self.foreign)]
        seconds = self.seconds or level.seconds
        return [
            Request(f"arm_{k:04d}", kinds[i], (self.seed, int(i)), seconds, self.ratio)
            for k, i in enumerate(rng.permutation(len(kinds)))
        ]


def effects_together(
    together: Sequence[str], count: int, level: Level, rng: np.random.Generator
) -> tuple[str, ...]:
    """Draw effects that the sensors of one arm can show together."""
    for _ in range(SET_DRAWS):
        drawn = tuple(str(e) for e in rng.choice(together, count, replace=False))
        if level.sides_of(drawn):
            return drawn
    raise DiagnosisError(
        f"no {count} of these effects are visible with the same sensors",
        "Give others with --effect, or choose another --level.",
    )


def create(
    folder: Path, settings: ChallengeSettings, *, workers: int = 1, report: Report | None = None
) -> str:
    """Draw hidden arms and record them; return the SHA-256 of the sealed truth.

    Raises a DiagnosisError if the folder holds another challenge, or there is nothing to draw.
    """
    plain = json.loads(json.dumps(asdict(settings)))
    path = folder / MANIFEST
    if path.exists():
        known = _read_manifest(path)
        if known["settings"] != plain:
            raise DiagnosisError(f"{folder} contains another challenge", "Choose another folder")
        if "truth_sha256" in known:
            return str(known["truth_sha256"])
    catalogue = Catalogue.default().with_files(settings.effects_files)
    requests = settings.requests(catalogue)
    if not requests:
        raise DiagnosisError(
            "the challenge has no arms", "Request some: --per-effect, --clean, --pairs or --triples"
        )
    for k, file in enumerate(settings.effects_files):  # so that the challenge can be run again
        kept = folder / FILES / f"{k}_{Path(file).name}"
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, kept)
    pieces = {request.name: folder / PIECES / f"{request.name}.sealed" for request in requests}
    manifest = {
        "settings": plain,
        "items": [{"name": o.name, "model": model_of(o.effects, catalogue)} for o in requests],
        "simulated": sorted(
            {e for o in requests for e in o.effects if e not in EFFECTS} - KNOWN - set(FOREIGN)
        ),
        "question": level_of(settings.level).asked,
    }
    _write(path, manifest)
    waiting = [request for request in requests if not pieces[request.name].is_file()]
    _each(
        [partial(_record, folder, request, settings.level) for request in waiting], workers, report
    )
    data = _closed([_opened(piece.read_bytes()) for piece in pieces.values()])
    (folder / SEALED).write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    _write(path, manifest | {"truth_sha256": digest})
    shutil.rmtree(folder / PIECES, ignore_errors=True)
    return digest


def solve(
    folder: Path,
    *,
    kind: str = ANSWERS,
    stale: bool = False,
    workers: int = 1,
    report: Report | None = None,
) -> dict[str, str]:
    """Diagnose every recording that has no answer yet; return what was refused, by name.

    `kind` is ANSWERS, or WITHHELD for the arms with one effect again, that effect taken out of the
    catalogue (the truth is opened to know which; the diagnosis learns nothing of it). With `stale`
    what another state of the code has answered is answered again.
    """
    manifest = load_manifest(folder)
    truth = open_sealed(folder, manifest["truth_sha256"]) if kind == WITHHELD else []
    without = {
        item["name"]: item["faults"][0]["effect"] for item in truth if len(item["faults"]) == 1
    }
    tasks = []
    for item in manifest["items"]:
        name = item["name"]
        path = answer_path(folder, item["name"], kind)
        known = path.is_file() and not (
            stale and json.loads(path.read_text()).get("code") != code_state()
        )
        if not known and (kind != WITHHELD or name in without):
            tasks.append(
                partial(_diagnose, folder, name, item["model"], without.get(name, ""), kind)
            )
    return {name: problem for name, problem in _each(tasks, workers, report) if problem}


def load_manifest(folder: Path) -> dict[str, Any]:
    """Return a challenge's manifest; DiagnosisError if there is none, or it is not complete."""
    manifest = _read_manifest(folder / MANIFEST)
    if "truth_sha256" not in manifest or not (folder / SEALED).is_file():
        raise DiagnosisError(
            f"{folder} contains a challenge that is not complete", "Continue with challenge create"
        )
    return manifest


def open_sealed(folder: Path, digest: str) -> list[dict[str, Any]]:
    """Return the truth; DiagnosisError if it is not what was sealed."""
    data = (folder / SEALED).read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise DiagnosisError(
            f"{folder / SEALED} differs from the file sealed at creation",
            "Create the challenge again",
        )
    return _opened(data)


def answer_path(folder: Path, name: str, kind: str = ANSWERS) -> Path:
    """Where the diagnosis of an item stands."""
    return folder / kind / f"{name}.json"


@lru_cache(maxsize=1)
def code_state() -> str:
    """Return a name for the state of the code that gives the answers."""
    root = Path(elastic_arm.__file__).parent
    files = (
        f for f in sorted(root.rglob("*.py")) if f.relative_to(root).parts[0] not in UNANSWERED
    )
    return hashlib.sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest()[:12]


@lru_cache(maxsize=4)
def catalogue_of(folder: Path) -> Catalogue:
    """Return the effects of a challenge: the default catalogue and those of its own files."""
    return Catalogue.default().with_files(sorted((folder / FILES).glob("*.py")))


def recorded(folder: Path, request: Request, level: Level, catalogue: Catalogue) -> dict[str, Any]:
    """Record an arm and return its truth.

    One that no simulation gets through is drawn again from another seed.
    """
    if level.bits is not None:
        return record_servos(folder, request, level)
    for draw in range(1, DRAWS):
        try:
            return record(folder, request, level, catalogue)
        except SimulationError:
            for bag in bags_of(folder, request.name, len(request.seconds)):
                shutil.rmtree(bag, ignore_errors=True)
            request = replace(request, seed=(*request.seed[:2], draw))
    return record(folder, request, level, catalogue)


def _each(tasks: Sequence[Callable[[], Any]], workers: int, report: Report | None) -> list[Any]:
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if report:
            report(done, len(tasks))

    with ProcessPool(min(workers, len(tasks))) as pool:
        return pool.run(tasks, advance)


def _record(folder: Path, request: Request, level: str) -> None:
    truth = recorded(folder, request, level_of(level), catalogue_of(folder))
    write_result(folder / PIECES / f"{request.name}.sealed", _closed(truth))


def _diagnose(folder: Path, name: str, model: str, without: str, kind: str) -> tuple[str, str]:
    keep_memory()
    catalogue = catalogue_of(folder).withholding(without) if without else catalogue_of(folder)
    wall = time.perf_counter()
    cpu = time.process_time()
    try:
        channels = channels_path(folder, name)
        mapping = None if channels is None else load_channels(channels)
        settings = load_manifest(folder)["settings"]
        level = level_of(settings["level"])
        bags = bags_of(folder, name, len(settings["seconds"] or level.seconds))
        recordings = [read_recording(bag, mapping) for bag in bags]
        question = _question(folder, name, model, catalogue)
        if level.changing:
            found = [replace(diagnose([one], question), context=None) for one in recordings]
            answer = found[0].to_dict() | changes_told(found)
            problem = ""
        else:
            answer = diagnose(recordings[:1], question, recordings[1:]).to_dict()
            problem = ""
    except ElasticArmError as error:  # to refuse is an answer too, and counts as one
        answer = REFUSED | {"notes": [str(error)]}
        problem = str(error)
    spent = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    _write(answer_path(folder, name, kind), answer | spent | {"code": code_state()})
    return name, problem


def _question(folder: Path, name: str, model: str, catalogue: Catalogue) -> Question:
    """Return what is asked of an arm's recordings: its description, and what its challenge counts
    as ordinary."""
    robot = load_robot(description_path(folder, name))
    asked = load_manifest(folder).get("question", {})
    given = known_effects(asked.get("with", ()), robot, catalogue)
    priors = Priors().model_copy(update=asked.get("priors", {}))
    refit = bool(asked.get("refit", False))
    return Question(robot, model, refit=refit, given=given, catalogue=catalogue, priors=priors)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(read_text(path, DiagnosisError, MAKE_ONE))
    except (ValueError, RecursionError):
        manifest = None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("settings"), dict):
        raise DiagnosisError(f"{path} is not a manifest of a challenge", MAKE_ONE)
    return manifest


def _write(path: Path, content: dict[str, Any]) -> None:
    write_result(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _closed(truth: Any) -> bytes:
    """Return a truth so that nobody reads it by accident."""
    return base64.b64encode(zlib.compress(json.dumps(truth, sort_keys=True).encode()))


def _opened(data: bytes) -> Any:
    return json.loads(zlib.decompress(base64.b64decode(data)))
