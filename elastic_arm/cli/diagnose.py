"""`elastic-arm diagnose`: where model and recordings differ, why, and how far the gap shrinks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from json import dumps as json_text
from pathlib import Path
from typing import Annotated, NamedTuple, Self

import numpy as np
import typer
from rich.console import Console

from elastic_arm.cli import options
from elastic_arm.cli.console import err, out, print_json, reports_errors, shares_of
from elastic_arm.cli.diagnosis_printing import (
    ROBOT,
    print_also_written,
    print_comparison,
    print_diagnosis,
    print_search,
    print_written,
)
from elastic_arm.cli.gate import FailOn, check_gate, pass_gate
from elastic_arm.cli.mujoco.corrected import Correction, Written, print_correction
from elastic_arm.cli.mujoco.export import print_closed_loop
from elastic_arm.cli.mujoco.replay import print_replays, replay_both
from elastic_arm.cli.outputs import Csv, Force, claim_bag, claim_folder
from elastic_arm.cli.watching import Progress, watched
from elastic_arm.diagnosis import Priors, Question, diagnose, follow_up
from elastic_arm.diagnosis.comparison import SimulationComparison, compare
from elastic_arm.diagnosis.corrected_robot import deviations, repaired_robot, units_of
from elastic_arm.diagnosis.result import SEPARATING, Diagnosis
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.estimation.segments import DIAGNOSED
from elastic_arm.evidence.priors import read_priors
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.identification.batch.ignored_commands import without
from elastic_arm.memory import keep_memory
from elastic_arm.mujoco import Replay
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.mujoco.left_out import SAMPLES
from elastic_arm.mujoco.refinable import refinable, with_refined
from elastic_arm.output_files import write_result
from elastic_arm.recording import Recording, write_recording
from elastic_arm.recording.inspection.check import misread
from elastic_arm.recording.inspection.differences import RecordingDifference, differences
from elastic_arm.recording.made_torque import is_commanded
from elastic_arm.robot import Robot, save_robot

COMPARISON = "comparison.json"
TABLES = ("causes.csv", "gap.csv", "parameters.csv", "residuals.csv")
RESULTS = ("diagnosis.json", "report.html", ROBOT, SEPARATING, COMPARISON)
CUT_SHORT = (
    "The closed-loop simulation ended early: the refinement of the parameters may be incomplete,"
    " and corrections that were not yet shown to move the arm as well as the description are not"
    " written."
)

Judges = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="BAG…", help="Recordings for validation; by default the last third of each."
    ),
]
Propose = Annotated[
    bool,
    typer.Option(help="Propose a motion that separates causes from their alternatives."),
]
Against = Annotated[
    Path | None, typer.Option(metavar="BAG", help="Simulated recording of the same commands.")
]
Replayed = Annotated[
    bool,
    typer.Option(
        "--replay", help="Replay the recording in MuJoCo before and after the correction (MJCF)."
    ),
]
Mcap = Annotated[
    Path | None,
    typer.Option(
        metavar="BAG",
        help="Write the validation recordings as a bag with their residuals before and after.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        min=1.0, metavar="N", help="Stop the search after N seconds with the best answer so far."
    ),
]
Explain = Annotated[
    bool,
    typer.Option(
        help="Also print why each residual is unexplained, and the search: the sets that were"
        " scored, what the best one lacks, moves."
    ),
]


@reports_errors
def diagnose_command(
    bags: Annotated[
        list[Path], typer.Argument(metavar="BAG…", help="Recordings on which causes are fitted.")
    ],
    validate: Judges = None,
    model: options.Model = "mod3",
    robot_file: options.RobotFile = None,
    chain: options.Chain = None,
    at: options.At = None,
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    effects_files: options.EffectsFiles = None,
    with_: options.KnownEffects = None,
    clock: options.Clock = options.ClockChoice.auto,
    most: options.Motion = None,
    refit: options.Refit = False,
    priors_file: options.PriorsFile = None,
    propose: Propose = True,
    against: Against = None,
    out_dir: options.OutFolder = Path("diagnosis"),
    replayed: Replayed = False,
    mcap: Mcap = None,
    csv: Csv = False,
    force: Force = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    seconds: Seconds = None,
    explain: Explain = False,
    fail_on: FailOn = None,
) -> None:
    """Find where a recording and a model differ, which effect the model lacks, and by how much the
    gap shrinks with it.

    Writes diagnosis.json and report.html. If causes were found, it also writes
    robot.yaml (the arm with its causes, for `simulate --robot`) and a copy of
    your MJCF or URDF with corrected numbers. If causes cannot be separated, it
    writes separating_trajectory.yaml, the motion to record next, for `simulate
    --trajectory` and the trajectory node. --against compares the first recording
    with a simulated one and lists the effects that only one of them has. The exit
    status is 0 for every verdict, 1 if --fail-on applies, and 2 for unusable input.

    Examples:

        elastic-arm diagnose run_1 run_2 --validate run_3 --out diagnosis

        elastic-arm diagnose real --against simulated --robot arm.urdf

        elastic-arm diagnose bag --refit --with coulomb_friction --with viscous_friction
    """
    check_gate(fail_on or ())
    options.require_bags([*bags, *(validate or [])])
    tables = TABLES if csv else ()
    claim_folder(out_dir, [*RESULTS, *tables], force=force)
    residual_bags = _claimed_bags(mcap, len(validate or bags))
    catalogue = Catalogue.default().with_files(effects_files or ())
    robot = options.load_arm(robot_file, chain, at, catalogue)
    priors = _priors(priors_file, catalogue)
    correction = Correction(robot_file, chain, at, catalogue, priors)
    correction.require_mjcf("--replay" if replayed else None)
    source = options.channel_map(channels), robot, clock, namespace
    working = Console(quiet=True).status if quiet else err.status
    with working("reading") as status:

        def read(path: Path) -> Recording:
            if against:  # Two recordings are compared sample by sample.
                return options.read_by_clock(path, *source)
            return options.read_motion(path, *source, shares_of(status), DIAGNOSED, most)

        recorded = _Recorded.read(read, bags, validate or [], against, robot)
    # Laws would fit misread channels only by chance, so no cause is sought in them.
    misread_channels = misread(recorded.fitted, robot, explained=True)
    question = Question(
        robot,
        model,
        refit=refit,
        given=known_effects(with_ or (), robot, catalogue),
        effects=None if misread_channels is None else (),
        catalogue=catalogue,
        priors=priors,
    )
    keep_memory()  # The parts of the recordings that were not kept would leave holes.
    with (
        working("diagnosing") as status,
        watched(Progress(seconds), status, commanded=recorded.commanded, quiet=quiet) as watch,
    ):
        found = diagnose(recorded.fitted, question, recorded.validation, watch=watch)
        watch.say("prediction, and a motion to record next", Stage.FOLLOWED)
        found = follow_up(found, rng=np.random.default_rng(0) if propose else None)
        answer = recorded.answer(found, question, correction, misread_channels, out_dir, watch)
        if replayed:
            replays = replay_both(correction, out_dir, recorded.judging[0])
            answer = answer._replace(replays=replays)
        save_diagnosis(answer.found, answer.corrected.robot, out_dir, answer.comparison)
    if not json and not quiet:
        answer.print(explain=explain)
    # The answer is printed before the figures, which take seconds.
    with working("drawing the report"):
        draw_report(answer.found, out_dir, answer.replays, answer.comparison)
        if csv:
            answer.found.to_csv(out_dir)
        _write_residuals(residual_bags, recorded.judging, answer.found, robot)
    if json:
        print_json(answer.found.to_dict())
    elif not quiet:
        print_written(out_dir)
        print_also_written([*tables, *map(str, residual_bags)])
    pass_gate(answer.found, fail_on or ())


@dataclass(frozen=True)
class _Recorded:
    """The recordings of a diagnosis."""

    fitted: list[Recording]
    validation: list[Recording]  # empty if the last third of each fitted one validates
    simulated: Recording | None  # of --against
    difference: RecordingDifference | None  # of the first fitted recording from the simulated one

    @classmethod
    def read(
        cls,
        read: Callable[[Path], Recording],
        bags: Sequence[Path],
        validate: Sequence[Path],
        against: Path | None,
        robot: Robot,
    ) -> Self:
        """Read all recordings."""
        fitted = [read(path) for path in bags]
        validation = [read(path) for path in validate]
        if against is None:
            return cls(fitted, validation, None, None)
        simulated = read(against)
        difference = differences(fitted[0].select(robot.joint_names), simulated)
        return cls(fitted, validation, simulated, difference)

    @property
    def judging(self) -> list[Recording]:
        """The validation recordings, whole or the last third of each."""
        return self.validation or self.fitted

    @property
    def commanded(self) -> bool:
        """Whether a fitted recording has commands and no torques."""
        return any(is_commanded(one) for one in self.fitted)

    def answer(
        self,
        found: Diagnosis,
        question: Question,
        correction: Correction,
        misread_channels: str | None,
        folder: Path,
        watch: Watch,
    ) -> "_Answer":
        """Correct the arm unless channels are misread, and compare with a simulated recording."""
        corrected = Written(misread_channels)
        if misread_channels is None:
            arm = question.robot
            corrected = correct(found, arm, folder, correction, self.judging, self.fitted, watch)
        found = _with_correction(found, corrected, cut_short=watch.is_over())
        comparison = None
        if self.simulated is not None and self.difference is not None:
            comparison = compare(found, self.simulated, question, self.difference)
        return _Answer(found, corrected, [], comparison)


class _Answer(NamedTuple):
    """What a diagnosis found, wrote, replayed and compared."""

    found: Diagnosis
    corrected: Written
    replays: list[Replay]
    comparison: SimulationComparison | None

    def print(self, *, explain: bool) -> None:
        """Print the diagnosis, the search if asked, the correction and the comparisons."""
        print_diagnosis(self.found)
        if explain:
            print_search(self.found)
        print_correction(self.corrected.file)
        print_closed_loop(self.found.closed_loop, "robot.yaml")
        print_replays(self.replays)
        print_comparison(self.comparison)
        out.file.flush()


def _priors(file: Path | None, catalogue: Catalogue) -> Priors:
    """Read the priors of --priors; the usual ones without it."""
    if file is None:
        return Priors()
    sensors = [effect.id for effect in catalogue.values() if effect.prior is not None]
    return read_priors(file, sensors)


def _with_correction(found: Diagnosis, corrected: Written, *, cut_short: bool) -> Diagnosis:
    """Add to a diagnosis how the corrected arm moves under the recorded commands."""
    choice = corrected.choice
    if choice is None:
        return found
    compared = corrected.compared_scales(found)
    found = replace(with_refined(found, corrected.refined), compared_scales=compared)
    found = found.with_closed_loop(choice.errors, choice.taken_back)
    ended = (CUT_SHORT,) if cut_short else ()
    return replace(found, notes=(*found.notes, *corrected.notes(), *ended))


def _claimed_bags(bag: Path | None, count: int) -> list[Path]:
    """Return the names of new bags for `count` recordings; an empty list without --mcap."""
    if bag is None:
        return []
    bags = [bag, *(bag.with_name(f"{bag.name}_{k}") for k in range(2, count + 1))]
    for one in bags:
        claim_bag(one, "--mcap")
    return bags


def _write_residuals(
    bags: Sequence[Path], judges: Sequence[Recording], found: Diagnosis, robot: Robot
) -> None:
    """Write each validation recording with its residuals as a bag."""
    for bag, judge in zip(bags, judges, strict=False):
        recording = judge.select(robot.joint_names)
        sides = found.residual_sides(recording.source, recording.start_ns)
        write_recording(bag, recording, further=sides, drawn=robot)


def correct(
    found: Diagnosis,
    robot: Robot,
    folder: Path,
    correction: Correction,
    judges: Sequence[Recording] = (),
    fitted: Sequence[Recording] = (),
    watch: Watch | None = None,
) -> Written:
    """Write the file that the arm came from with what was found.

    Of an arm with recorded torques, where there are causes; of a commanded one, refined on what was
    fitted, what of it does not move the arm worse in `judges`, and without causes only if it moves
    nearer.
    """
    if found.context is not None and not robot.elastic:
        correction.motion = found.context.moved(SAMPLES)
    # The duty alone says nothing of the firmware: without commands there is no closed loop.
    if not any(is_commanded(one) for one in (*judges, *fitted)) or not found.made:
        corrected = repaired_robot(robot, found) if found.causes else None
        return Written(correction.write(corrected, folder, deviations(found)), corrected)
    held_back = found.context is not None and found.context.held_back
    judging: list[Judging] = []
    before: list[Judging] = []
    for one in judges:
        spans = [span for name, span in found.judged.items() if _is_part(name, one.source)]
        if spans or len(judges) == 1:
            begin = min([start for start, _ in spans], default=0.0)
            end = max([stop for _, stop in spans], default=np.inf)
            selected = _followed(one, robot, found)
            judging.append(Judging(selected, (begin, end)))
            before.append(Judging(selected, (0.0, begin)))
    whole = [Judging(_followed(one, robot, found)) for one in fitted]
    return correction.judged(
        robot,
        lambda back: repaired_robot(robot, found, back),
        units_of(found),
        judging,
        folder,
        deviations(found),
        caused=bool(found.causes),
        numbers=refinable(found, robot),
        fitted=before if held_back else whole,
        watch=watch,
    )


def _is_part(name: str, source: str) -> bool:
    """Return whether a name is that of a recording or of a part of it."""
    return name == source or name.startswith(f"{source}, ")


def _followed(recording: Recording, robot: Robot, found: Diagnosis) -> Recording:
    """Return a recording without the stretches in which its drives ignored their commands."""
    selected = recording.select(robot.joint_names)
    spans = {
        (one.begin, one.end)
        for one in found.events
        if one.ignored and _is_part(one.recording, recording.source)
    }
    return without(selected, sorted(spans)) if spans else selected


def draw_report(
    found: Diagnosis,
    folder: Path,
    replays: Sequence[Replay] = (),
    comparison: SimulationComparison | None = None,
) -> None:
    """Write report.html."""
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.diagnosis import write_gap_report

    write_gap_report(folder / "report.html", found, replays, comparison)


def save_diagnosis(
    found: Diagnosis,
    robot: Robot | None,
    folder: Path,
    comparison: SimulationComparison | None = None,
) -> None:
    """Write all files except the report, and replace those of an earlier diagnosis.

    robot: the corrected arm; None if none is written.
    """
    found.save(folder / "diagnosis.json")
    for name in (ROBOT, SEPARATING, COMPARISON):
        (folder / name).unlink(missing_ok=True)
    if comparison is not None:
        write_result(
            folder / COMPARISON, json_text(comparison.to_dict(), indent=2, allow_nan=False) + "\n"
        )
    if robot is not None:
        save_robot(robot, folder / ROBOT)
    proposal = found.proposal
    if proposal is not None and proposal.trajectory is not None and proposal.worthwhile:
        proposal.trajectory.save(folder / SEPARATING)
