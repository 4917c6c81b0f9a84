"""`elastic-arm diagnose`: where model and recording part, which effect causes it, how far the gap
shrinks."""

from collections.abc import Sequence
from dataclasses import replace
from json import dumps as json_text
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors, shares_of
from elastic_arm.cli.gate import FailOn, check_gate, pass_gate
from elastic_arm.cli.mujoco.corrected import Correction, Written, print_correction
from elastic_arm.cli.mujoco.export import print_closed_loop
from elastic_arm.cli.mujoco.replay import print_replays, replay_both
from elastic_arm.cli.outputs import Csv, Force, claim_bag, claim_folder
from elastic_arm.cli.watching import ended_early
from elastic_arm.diagnosis import Priors, Question, diagnose, follow_up
from elastic_arm.diagnosis.comparison import SimulationComparison, compare
from elastic_arm.diagnosis.corrected_robot import deviations, repaired_robot, units_of
from elastic_arm.diagnosis.result import SEPARATING, Cause, Diagnosis, Proposal
from elastic_arm.diagnosis.search_words import search_words
from elastic_arm.diagnosis.words import (
    alone_text,
    cause_name,
    cause_size,
    change_text,
    effect_at,
    gap_at,
    listed,
    listed_alternatives,
    log_likelihood_text,
    merged_notes,
    prediction_sentence,
    probability_text,
    regime_text,
    scale_sentence,
    sides_text,
    summary,
    trust_text,
    unknown_sentences,
)
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.estimation.equation_sets import SIDES
from elastic_arm.estimation.segments import DIAGNOSED
from elastic_arm.evidence.priors import read_priors
from elastic_arm.evidence.watch import Watch
from elastic_arm.identification.batch.ignored_commands import without
from elastic_arm.memory import keep_memory
from elastic_arm.mujoco import Replay
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.mujoco.left_out import SAMPLES
from elastic_arm.mujoco.refinable import refinable, with_refined
from elastic_arm.output_files import write_result
from elastic_arm.recording import Recording, write_recording
from elastic_arm.recording.inspection.check import misread
from elastic_arm.recording.inspection.differences import differences
from elastic_arm.robot import Robot, save_robot

ROBOT = "robot.yaml"
COMPARISON = "comparison.json"
TABLES = ("causes.csv", "gap.csv", "parameters.csv", "residuals.csv")
RESULTS = ("diagnosis.json", "report.html", ROBOT, SEPARATING, COMPARISON)
CUT_SHORT = (
    "The closed loop ended early: numbers may not be refined to the end, and corrections that were"
    " not found to move as well as the description are not written."
)
COLOURS = {"none": "green", "explained": "cyan", "unknown": "yellow"}

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
    against: Annotated[
        Path | None, typer.Option(metavar="BAG", help="Simulated recording of the same commands.")
    ] = None,
    out_dir: options.OutFolder = Path("diagnosis"),
    replayed: Annotated[
        bool,
        typer.Option(
            "--replay",
            help="Replay the recording in MuJoCo before and after the correction (MJCF).",
        ),
    ] = False,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar="BAG",
            help="Write the validation recordings as a bag with their residuals before and after.",
        ),
    ] = None,
    csv: Csv = False,
    force: Force = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            metavar="N",
            help="Stop the search after N seconds with the best answer so far.",
        ),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            help="Also print the search: the sets that were scored, what the best one lacks, moves."
        ),
    ] = False,
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
    claim_folder(out_dir, [*RESULTS, *(TABLES if csv else ())], force=force)
    residual_bags = _numbered(mcap, len(validate or bags))
    for bag in residual_bags:
        claim_bag(bag, "--mcap")
    catalogue = Catalogue.default().with_files(effects_files or ())
    robot = options.load_arm(robot_file, chain, at, catalogue)
    correction = Correction(robot_file, chain, at, catalogue)
    correction.require_mjcf("--replay" if replayed else None)
    mapping = options.channel_map(channels)
    sensors = [effect.id for effect in catalogue.values() if effect.prior is not None]
    priors = Priors() if priors_file is None else read_priors(priors_file, sensors)
    working = Console(quiet=True).status if quiet else err.status
    with working("reading") as status:

        def read(path: Path) -> Recording:
            if against:  # sample by sample
                return options.read_by_clock(path, mapping, robot, clock, namespace)
            says = shares_of(status)
            return options.read_motion(
                path, mapping, robot, clock, namespace, says, DIAGNOSED, most
            )

        recordings = [read(path) for path in bags]
        judges = [read(path) for path in validate or []]
        simulated = read(against) if against else None
        difference = None
        if simulated is not None:
            difference = differences(recordings[0].select(robot.joint_names), simulated)
    given = known_effects(with_ or (), robot, catalogue)
    # Misread channels have no causes: laws would fit them by chance alone.
    wrong = misread(recordings, robot, explained=True)
    sought = None if wrong is None else ()
    question = Question(
        robot, model, refit=refit, given=given, effects=sought, catalogue=catalogue, priors=priors
    )
    keep_memory()  # what was read and left out would leave holes
    with working("diagnosing") as status, ended_early(seconds, status, quiet=quiet) as watch:
        found = diagnose(recordings, question, judges, watch=watch)
        watch.say("predicting, comparing and proposing a motion")
        found = follow_up(found, rng=np.random.default_rng(0) if propose else None)
        corrected = Written(wrong)
        if wrong is None:
            corrected = correct(
                found, robot, out_dir, correction, judges or recordings, recordings, watch
            )
        if corrected.choice is not None:
            found = with_refined(found, corrected.refined)
            found = found.with_closed_loop(corrected.choice.errors, corrected.choice.taken_back)
            ended = (CUT_SHORT,) if watch.is_over() else ()
            found = replace(found, notes=(*found.notes, *corrected.notes(), *ended))
        replays = replay_both(correction, out_dir, (judges or recordings)[0]) if replayed else []
        comparison = None
        if simulated is not None and difference is not None:
            comparison = compare(found, simulated, question, difference)
        write_diagnosis(found, corrected.robot, out_dir, replays, comparison)
        if csv:
            found.to_csv(out_dir)
        _write_residuals(residual_bags, judges or recordings, found, robot)
    if json:
        print_json(found.to_dict())
    elif not quiet:
        print_diagnosis(found, out_dir)
        if explain and found.context is not None:
            for line in search_words(found.context.explanation):
                out.print(escape(line))
        print_correction(corrected.file)
        print_closed_loop(found.closed_loop, "robot.yaml")
        print_replays(replays)
        print_comparison(comparison)
        also = [*(TABLES if csv else ()), *map(str, residual_bags)]
        if also:
            out.print(f"also written: {escape(', '.join(also))}")
    pass_gate(found, fail_on or ())


def _numbered(bag: Path | None, count: int) -> list[Path]:
    """Return the names of bags for `count` recordings; an empty list without --mcap."""
    if bag is None:
        return []
    return [bag, *(bag.with_name(f"{bag.name}_{k}") for k in range(2, count + 1))]


def _write_residuals(
    bags: Sequence[Path], judges: Sequence[Recording], found: Diagnosis, robot: Robot
) -> None:
    """Write each judging recording with its residuals as a bag."""
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
    if not found.made:
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


def write_diagnosis(
    found: Diagnosis,
    robot: Robot | None,
    folder: Path,
    replays: Sequence[Replay] = (),
    comparison: SimulationComparison | None = None,
) -> None:
    """Write diagnosis.json, report.html and, where there are any, the corrected arm and the motion
    proposed.

    robot: the corrected arm; None where none is written. What an earlier diagnosis left in the
    folder is replaced.
    """
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.diagnosis import write_gap_report

    found.save(folder / "diagnosis.json")
    write_gap_report(folder / "report.html", found, replays, comparison)
    for name in (ROBOT, SEPARATING, COMPARISON):
        (folder / name).unlink(missing_ok=True)
    if comparison is not None:
        write_result(
            folder / COMPARISON, json_text(comparison.to_dict(), indent=2, allow_nan=False) + "\n"
        )
    if robot is not None:
        save_robot(robot, folder / ROBOT)
    if (
        found.proposal is not None
        and found.proposal.trajectory is not None
        and found.proposal.worthwhile
    ):
        found.proposal.trajectory.save(folder / SEPARATING)


def print_diagnosis(found: Diagnosis, folder: Path) -> None:
    """Print what was found in words, then causes, changes, what is left, and notes."""
    if found.made:
        out.print(f"[yellow]scale:[/] {escape(scale_sentence(found))}")
    first, *more = summary(found)
    out.print(
        "[bold"
        f" {COLOURS[found.verdict]}]{found.verdict}[/]{escape(first.removeprefix(found.verdict))}"
    )
    for sentence in more:
        out.print(escape(sentence))
    if found.causes:
        _print_causes(found.causes)
    if found.shrink_by_place:
        _print_places(found)
    for cause in found.causes:
        _print_alternatives(cause)
    for change in found.changes:
        out.print(f"[yellow]changed:[/] {escape(change_text(change))}")
    for place in found.unexplained:
        size = f"{place.rmse:.3g} {found.units.at(place.joint, 'Nm')}"
        out.print(
            f"unexplained: {escape(place.joint)}, {place.side} side, {size}:"
            f" {regime_text(place.regime)}"
        )
    for sentence in unknown_sentences(found):
        out.print(f"what now: {escape(sentence)}")
    if found.prediction is not None and (found.causes or found.prediction.reason):
        out.print(f"prediction: {escape(prediction_sentence(found, found.prediction))}")
    if found.proposal is not None:
        _print_proposal(found.proposal)
    out.print(f"trust in the description: {escape(trust_text(found.trust))}")
    for note in merged_notes(found.notes):
        out.print(f"note: {escape(note)}")
    further = [name for name in (ROBOT, SEPARATING) if (folder / name).exists()]
    out.print(
        f"written: {escape(str(folder))}/{', '.join(['diagnosis.json', 'report.html', *further])}"
    )


def _print_causes(causes: Sequence[Cause]) -> None:
    # On a screen a line for a parameter, the sides below the joint; in a pipe a line for a cause.
    where, between = (("joint, side",), "\n") if out.is_terminal else (("joint", "side"), ", ")
    numbers = ("gap", "probability")
    table = new_table(
        "cause", *where, "size", *numbers, right=numbers, whole=("cause", *where, *numbers)
    )
    for cause in causes:
        place = [escape(cause.joint or "whole arm"), sides_text(cause)]
        at = ["\n".join(place)] if out.is_terminal else place
        size = escape(cause_size(cause, between))
        shares = (alone_text(cause), probability_text(cause.confidence))
        table.add_row(escape(cause_name(cause)), *at, size, *shares)
    out.print(table)
    if any(cause.rejected for cause in causes):
        out.print("[dim]rejected: the arm moves worse with it in closed loop; it is not written[/]")
    out.print(
        "[dim]gap: share that this cause alone removes; probability: that the cause is present[/]"
    )


def _print_alternatives(cause: Cause) -> None:
    instead = f"alternative to {escape(effect_at(cause.effect, cause.joint))}:"
    likely, faint = listed_alternatives(cause)
    for other in likely:
        name = escape(effect_at(other.effect, other.joint))
        odds = probability_text(other.confidence)
        separator = escape(other.file or other.separated_by)
        out.print(f"{instead} {name} ({odds}); separated by: {separator}")
    if faint:
        out.print(f"{instead} {escape(faint)}")


def _print_places(found: Diagnosis) -> None:
    """Print how far the gap of each joint with a gap shrinks."""
    compared = {side for _, side in found.before.rmse}
    sides = [side for side in SIDES if side in compared]
    with_gap = {joint for (joint, _), share in found.shrink_by_place.items() if share is not None}
    apart = [joint for joint in found.joints if joint in with_gap]
    numbers = "as described → with ordinary deviations"
    sizes = "without → with causes" if found.causes else numbers
    if apart:
        shown = [f"{side} side" for side in sides]
        table = new_table("joint", *shown, right=shown, whole=("joint", *shown))
        for joint in apart:
            cells = [gap_at(found, joint, side) for side in sides]
            # On a screen the share stands below the sizes: three sides and a long name would not
            # fit otherwise.
            table.add_row(
                escape(joint),
                *(cell.replace(" (", "\n(") if out.is_terminal else cell for cell in cells),
            )
        out.print(
            f"residuals in {found.units.over('Nm')} below {found.band:.3g} Hz, {sizes} (removed"
            " share of the residual's own gap):"
        )
        out.print(table)
    if agreeing := [joint for joint in found.joints if joint not in apart]:
        out.print(f"no significant gap at {escape(listed(agreeing))}")


def print_comparison(comparison: SimulationComparison | None) -> None:
    """Print where a real and a simulated recording differ, and which effect is in which."""
    if comparison is None:
        return
    found = comparison.difference
    table = new_table("real − simulated, RMS", *found.joints, right=found.joints)
    for one in found.channels:
        pairs = zip(one.rms, one.share, strict=True)
        table.add_row(one.channel, *(f"{rms:.3g} ({100 * share:.2g} %)" for rms, share in pairs))
    out.print(table)
    for effect, place, where, real, simulated in comparison.rows():
        out.print(
            f"{escape(effect)}, {escape(place)}: in {where} ({escape(real)} / {escape(simulated)})"
        )


def _print_proposal(proposal: Proposal) -> None:
    for pair in proposal.pairs:
        names = " and ".join(effect_at(*place) for place in (pair.cause, pair.alternative))
        here = log_likelihood_text(pair.here)
        expected = log_likelihood_text(pair.expected)
        advice = f"no motion was found that separates {names}"
        if pair.decides:
            advice = f"record {SEPARATING} ({proposal.seconds:g} s) to separate {names}"
        out.print(
            f"next: {escape(advice)} (expected log-likelihood ratio {expected}; this recording:"
            f" {here})"
        )
