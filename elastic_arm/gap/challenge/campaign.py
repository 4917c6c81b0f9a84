"""Making and diagnosing many hidden arms, in parallel on Dask; what is there already is not done again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError, ElasticArmError, MissingExtraError
from elastic_arm.gap.challenge.draw import Bounds, Item, draw_item
from elastic_arm.gap.challenge.hidden_arm import HiddenArm
from elastic_arm.gap.challenge.motion import random_motion
from elastic_arm.gap.challenge.seal import NAME, seal
from elastic_arm.gap.diagnosis import Question, diagnose
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import load_robot

MANIFEST = "challenge.json"
IN_PAIRS = tuple(e for e in EFFECTS if e not in ("spline_inertia", "inertia_coupling", "bearing_compliance"))
Report = Callable[[int, int], None]


def create(
    folder: Path,
    *,
    seed: int,
    per_effect: int = 1,
    clean: int = 4,
    pairs: int = 4,
    withheld: int = 0,
    seconds: float = 12.0,
    validate_seconds: float = 8.0,
    effects: Sequence[str] | None = None,
    workers: int = 0,
    scheduler: str | None = None,
    report: Report | None = None,
) -> str:
    """Draw hidden arms and record them; return the SHA-256 of the sealed truth.

    Parameters
    ----------
    per_effect, clean, pairs, withheld
        Recordings of each effect alone, of the plain arm, of two effects, and of effects to be diagnosed without.
    seconds, validate_seconds
        Duration of the two recordings of each arm.
    workers, scheduler
        See :func:`mapped`.

    Raises
    ------
    DiagnosisError
        If the folder holds another challenge.
    """
    settings = {
        "seed": seed, "per_effect": per_effect, "clean": clean, "pairs": pairs, "withheld": withheld,
        "seconds": seconds, "validate_seconds": validate_seconds, "effects": list(effects or EFFECTS),
    }  # fmt: skip
    manifest_path = folder / MANIFEST
    if manifest_path.is_file():
        known = json.loads(manifest_path.read_text())
        if known["settings"] != settings:
            raise DiagnosisError(f"{folder} holds another challenge", "Choose another folder")
    items = _draw(settings)
    folder.mkdir(parents=True, exist_ok=True)
    digest = seal(folder, [item.truth() for item in items])
    manifest = {
        "settings": settings,
        "truth_sha256": digest,
        "items": [{"name": i.name, "model": i.model, "withheld": list(i.withheld)} for i in items],
    }
    manifest_path.write_text(json.dumps(manifest, indent=1) + "\n")
    jobs = [(str(folder), item, seconds, validate_seconds) for item in items if not _made(folder, item.name)]
    for done, _ in enumerate(mapped(_record, jobs, workers, scheduler), 1):
        if report:
            report(done, len(jobs))
    return digest


def solve(
    folder: Path, *, workers: int = 0, scheduler: str | None = None, report: Report | None = None
) -> dict[str, str]:
    """Diagnose every recording that has no answer yet; return what went wrong, by name."""
    manifest = load_manifest(folder)
    open_items = [item for item in manifest["items"] if not answer_path(folder, item["name"]).is_file()]
    jobs = [(str(folder), item["name"], item["model"], tuple(item["withheld"])) for item in open_items]
    wrong = {}
    for done, (name, problem) in enumerate(mapped(_diagnose, jobs, workers, scheduler), 1):
        if problem:
            wrong[name] = problem
        if report:
            report(done, len(jobs))
    return wrong


def load_manifest(folder: Path) -> dict[str, Any]:
    """Return a challenge's manifest.

    Raises
    ------
    DiagnosisError
        If there is none.
    """
    path = folder / MANIFEST
    if not path.is_file() or not (folder / NAME).is_file():
        raise DiagnosisError(f"{folder} holds no challenge", "Make one: elastic-arm challenge create DIR")
    manifest: dict[str, Any] = json.loads(path.read_text())
    return manifest


def answer_path(folder: Path, name: str) -> Path:
    """Where the diagnosis of an item stands."""
    return folder / "answers" / f"{name}.json"


def mapped(
    function: Callable[[Any], Any], jobs: Sequence[Any], workers: int = 0, scheduler: str | None = None
) -> Iterator[Any]:
    """Apply a function to jobs, in any order.

    Parameters
    ----------
    workers
        Processes on this machine; 0 does the work here, one after another.
    scheduler
        Address of a Dask cluster, instead.
    """
    if not workers and scheduler is None:
        yield from map(function, jobs)
        return
    with _client(workers, scheduler) as (client, as_completed):
        for future in as_completed(client.map(function, jobs, pure=False)):
            yield future.result()


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise MissingExtraError(
            "campaigns run in parallel on Dask, which is not installed",
            "Install it: pip install 'elastic-arm[challenge]', or run with --workers 0",
        ) from error
    if scheduler is not None:
        with Client(scheduler) as client:
            yield client, as_completed
        return
    cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    with cluster, Client(cluster) as client:
        yield client, as_completed


def _draw(settings: dict[str, Any]) -> list[Item]:
    rng = np.random.default_rng(settings["seed"])
    robot = load_robot(None)
    bounds = Bounds(robot, rng, settings["seconds"])
    kinds: list[tuple[tuple[str, ...], bool]] = [((), False)] * settings["clean"]
    kinds += [((e,), False) for e in settings["effects"] for _ in range(settings["per_effect"])]
    known = [e for e in IN_PAIRS if e in settings["effects"]]
    for _ in range(settings["pairs"]):
        two = rng.choice(known, 2, replace=False)
        kinds.append((tuple(str(e) for e in two), False))
    kinds += [((e,), True) for e in settings["effects"] for _ in range(settings["withheld"])]
    order = rng.permutation(len(kinds))
    return [
        draw_item(f"arm_{k:04d}", kinds[i][0], robot, bounds, rng, withheld=kinds[i][1]) for k, i in enumerate(order)
    ]


def _bags(folder: Path, name: str) -> tuple[Path, Path]:
    return folder / "bags" / f"{name}_identify", folder / "bags" / f"{name}_validate"


def _made(folder: Path, name: str) -> bool:
    return all((bag / "metadata.yaml").is_file() for bag in _bags(folder, name))


def _record(job: tuple[str, Item, float, float]) -> str:
    folder, item, *durations = job
    rng = np.random.default_rng(item.seed)
    arm = HiddenArm(load_robot(None), item.faults)
    for bag, seconds in zip(_bags(Path(folder), item.name), durations, strict=True):
        recording = arm.record(random_motion(rng, arm.n, seconds), item.instruments, rng)
        if not (bag / "metadata.yaml").is_file():
            bag.parent.mkdir(parents=True, exist_ok=True)
            write_recording(bag, recording)
    return item.name


def _diagnose(job: tuple[str, str, str, tuple[str, ...]]) -> tuple[str, str]:
    folder, name, model, withheld = job
    identify, validate = (read_recording(bag) for bag in _bags(Path(folder), name))
    effects = tuple(e for e in EFFECTS.values() if e.id not in withheld)
    try:
        found = diagnose([identify], Question(load_robot(None), model, effects=effects), [validate])
    except ElasticArmError as error:
        return name, str(error)
    found.save(answer_path(Path(folder), name))
    return name, ""
