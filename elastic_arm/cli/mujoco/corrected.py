"""The user's own file with numbers from a diagnosis or an identification, next to robot.yaml."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

import numpy as np
from rich.markup import escape

from elastic_arm.cli.console import out
from elastic_arm.cli.mujoco.export import print_export
from elastic_arm.diagnosis.estimates import ParameterEstimate
from elastic_arm.diagnosis.result import ComparedScale, Diagnosis
from elastic_arm.diagnosis.words import listed
from elastic_arm.effects import Catalogue
from elastic_arm.equations.numbers import SCALE
from elastic_arm.errors import MissingExtraError, RobotError
from elastic_arm.evidence.priors import Priors
from elastic_arm.evidence.watch import Watch
from elastic_arm.mujoco import Exported, export_mjcf, export_urdf
from elastic_arm.mujoco.changed_numbers import Deviations
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.file_alone import file_numbers, refined_words, unstated
from elastic_arm.mujoco.judgement import Choice, Judging, chosen
from elastic_arm.mujoco.left_out import Motion
from elastic_arm.mujoco.new_model import playable
from elastic_arm.mujoco.refinable import (
    DELAY,
    RATIOS,
    Moved,
    Refinable,
    by_words,
    robot_at,
)
from elastic_arm.mujoco.refinement import refine
from elastic_arm.mujoco.servo_numbers import servo_numbers
from elastic_arm.results import ClosedLoopError
from elastic_arm.robot import Robot, with_joints_of
from elastic_arm.robot.loading import is_mjcf, parse_chain
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

SUFFIX = "_corrected"
NAMED = 6  # numbers that a note names

# What is taken back -> the corrected arm without it.
Corrected = Callable[[frozenset[str]], Robot]


def no_file(lacking: Mapping[str, Sequence[str]]) -> str:
    """Return why there is no file for a corrected arm, and how to use the arm itself.

    lacking: what no file states of each joint, in words.
    """
    laws = listed(list(dict.fromkeys(word for words in lacking.values() for word in words)))
    return (
        f"without {laws}, which an MJCF does not state, every joint would move worse than as"
        " described. robot.yaml has them, and its errors are those of the closed loop below; for"
        " friction in your own simulation, write a file with `elastic-arm export` and load"
        " robot.yaml with elastic_arm.mujoco.attach (docs/mujoco.md)"
    )


@dataclass(frozen=True)
class Written:
    """What was written of a correction."""

    file: Exported | str | None = (
        None  # the user's own file, or why there is none; None where none was to be written
    )
    robot: Robot | None = None  # the corrected arm; None where the description stays
    choice: Choice | None = (
        None  # of a commanded arm, what of the correction it holds, and how the arm moves with it
    )
    refined: tuple[Moved, ...] = ()  # numbers of it that were refined in closed loop
    fitted: tuple[Moved, ...] = ()  # numbers of a servo that it holds in the place of all causes
    # joints whose described numbers the file keeps, and how they would move without these
    kept_in_file: tuple[str, ...] = ()

    def notes(self) -> tuple[str, ...]:
        """Return in sentences what of the written numbers is not as it was found."""
        found = self._refined_note(), self._file_note()
        return tuple(words for words in found if words)

    def _file_note(self) -> str:
        if not self.kept_in_file:
            return ""
        return (
            "An MJCF does not state all laws of robot.yaml. Without them, the corrected file would"
            f" move {listed(self.kept_in_file)} worse than the description: there it keeps the"
            " described numbers."
        )

    def _refined_note(self) -> str:
        if self.fitted:
            numbers = listed([by_words(one) for one in self.fitted])
            return (
                "No cause improves the simulated motion, so no cause is written. The corrected file"
                " contains the numbers of every servo, fitted by simulations of the fitted"
                f" recordings. These change: {numbers}."
            )
        far = [(abs(one.by) / one.number.std, one) for one in self.refined]
        far.sort(key=lambda pair: -pair[0])
        told = [by_words(one) for share, one in far if share > 1.0]
        if not told:
            return ""
        more = len(told) - NAMED
        return (
            "The numbers of the corrected arm are refined by simulations of the fitted"
            " recordings, starting from the posterior. These change by more than their standard"
            f" deviation: {listed(told[:NAMED], more)}."
        )

    def compared_scales(self, found: Diagnosis) -> dict[str, ComparedScale]:
        """Return, by joint, the scale of its torques as diagnosed and as refined in closed loop."""
        # Numbers of every servo are fitted from the description, others from the diagnosis.
        moved = self.fitted or self.refined
        of_scale = {one.number.joint: one for one in moved if one.number.what == RATIOS[SCALE]}
        compared = {}
        for joint, torques in found.torque_scale.items():
            if joint in of_scale:
                before = 1.0 if self.fitted else torques.value
                value, std = of_scale[joint].of(before)
                compared[joint] = ComparedScale(torques, ParameterEstimate(value, std, "1"))
        return compared

    def with_alone(self, errors: Mapping[str, ClosedLoopError]) -> Self:
        """Return it with the errors of the file alone, by joint."""
        assert self.choice is not None
        both = {
            name: replace(one, alone=errors[name].corrected)
            for name, one in self.choice.errors.items()
        }
        return replace(self, choice=self.choice.with_errors(both))


class Correction:
    """Where an arm came from, and so where its corrected numbers go.

    base: file that the arm was read from; nothing is written for the package's own arm and for arm
    files; priors: of the numbers that every servo has.
    """

    def __init__(
        self,
        base: Path | None,
        chain: str | None,
        at: str | None,
        catalogue: Catalogue,
        priors: Priors | None = None,
    ) -> None:
        self.base = base
        self.motion: Motion | None = (
            None  # over which friction stands for laws that the file has no number for
        )
        self._ends = None if chain is None else parse_chain(chain)
        self._at = at
        self._catalogue = catalogue
        self._priors = priors or Priors()
        self.mjcf = base is not None and is_mjcf(base)
        self._written = self.mjcf or (base is not None and base.suffix.lower() in (".urdf", ".xml"))

    def path(self, folder: Path) -> Path | None:
        """Return the file that is written into a folder; None where none is."""
        return (
            folder / f"{self.base.stem}{SUFFIX}{self.base.suffix}"
            if self.base and self._written
            else None
        )

    def require_mjcf(self, option: str | None) -> None:
        """Refuse an option, where one is given, if the arm came from no MJCF."""
        if option is not None and not self.mjcf:
            raise RobotError(f"{option} requires an MJCF", "Give one with --robot model.xml")

    def open(self, path: Path) -> MjcfArm:
        """Open the arm in the MJCF that it came from, or in a copy."""
        return open_mjcf(path, self._ends, self._at)

    def write(
        self, robot: Robot | None, folder: Path, deviations: Deviations | None = None
    ) -> Exported | str | None:
        """Write the file."""
        file = self.path(folder)
        if file is None or self.base is None:
            return None
        file.unlink(missing_ok=True)
        if robot is None:
            return None
        try:
            return self._exported(robot, file, deviations)
        except (RobotError, MissingExtraError) as error:
            return str(error)

    def judged(
        self,
        robot: Robot,
        corrected: Corrected,
        units: Sequence[str],
        judging: Sequence[Judging],
        folder: Path,
        deviations: Deviations | None = None,
        *,
        caused: bool,
        numbers: Sequence[Refinable] = (),
        fitted: Sequence[Judging] = (),
        watch: Watch | None = None,
    ) -> Written:
        """Write the part of a commanded arm's correction that makes it no worse.

        It moves the arm nearer to the validation recordings, or as near.

        robot: as described; units: what can be taken back; caused: whether what is as near as
        described is written; numbers: those that are refined first, on the recordings that were
        fitted; watch: is told of the stages, and may end them with what is known.
        """
        watch = watch or Watch()
        choice = None
        moved: tuple[Moved, ...] = ()

        def arm_without(back: frozenset[str]) -> Robot:
            kept = _kept(moved, back)
            by = np.array([one.by for one in kept])
            return robot_at(corrected(back), [one.number for one in kept], by)

        with TemporaryDirectory() as temporary:

            def build(back: frozenset[str]) -> MjcfArm:
                return self._played(arm_without(back), Path(temporary) / "arm.xml")

            try:
                if fitted:
                    found = corrected(frozenset())
                    moved = refine(build(frozenset()), found, numbers, fitted, watch=watch)
            except (RobotError, MissingExtraError):
                pass  # numbers that no simulator takes: they are taken back below
            try:
                described = (
                    with_controllers(self.open(self.base), robot)
                    if self.base and self.mjcf
                    else None
                )
                described = described or playable(robot, Path(temporary) / "described.xml")
                choice = chosen(described, build, units, judging, watch)
            except (RobotError, MissingExtraError):
                pass  # a controller that MuJoCo has not: nothing is played
        if choice is None:
            arm = arm_without(frozenset()) if caused else None
            return Written(self.write(arm, folder, deviations), arm)
        back = frozenset(choice.taken_back)
        if back >= set(units) or not (caused or choice.better):
            fallback = self._fitted_numbers(robot, choice, judging, fitted, folder, watch)
            if fallback is not None:
                return fallback
            self.write(None, folder)
            errors = {name: as_described(one) for name, one in choice.errors.items()}
            return Written(choice.reason or None, None, choice.with_errors(errors))
        kept = _kept(moved, back)
        written = Written(None, arm_without(back), choice, kept)
        told = None if kept else deviations
        return self._as_file(written, judging, fitted, folder, watch, told)

    def _fitted_numbers(
        self,
        robot: Robot,
        found: Choice,
        judging: Sequence[Judging],
        fitted: Sequence[Judging],
        folder: Path,
        watch: Watch,
    ) -> Written | None:
        """Write a servo arm with the numbers that every servo has, fitted in closed loop.

        found: how it moves with the causes, none of which is written. None where no joint moves
        nearer.
        """
        arm, numbers = servo_numbers(robot, self._priors)
        if not fitted or not numbers or watch.is_over():
            return None
        with TemporaryDirectory() as temporary:
            try:
                described = self._played(robot, Path(temporary) / "described.xml")
                played = self._played(arm, Path(temporary) / "arm.xml")
                moved = refine(played, arm, numbers, fitted, alone=True, watch=watch)
                by = np.array([one.by for one in moved])
                whole = robot_at(arm, [one.number for one in moved], by)

                def build(back: frozenset[str]) -> MjcfArm:
                    kept = with_joints_of(whole, robot, back)
                    return self._played(kept, Path(temporary) / "kept.xml")

                choice = None
                if moved:
                    choice = chosen(described, build, robot.joint_names, judging, watch)
            except (RobotError, MissingExtraError):
                return None
        if choice is None or not choice.better:
            return None
        back = frozenset(choice.taken_back)
        kept = tuple(one for one in moved if one.number.joint not in back)
        written = with_joints_of(whole, robot, back)
        errors = {
            name: replace(one, refused=found.errors[name].refused)
            for name, one in choice.errors.items()
        }
        both = replace(choice.with_errors(errors), worse=found.worse, taken_back=found.taken_back)
        done = Written(None, written, both, fitted=kept)
        return self._as_file(done, judging, fitted, folder, watch)

    def _as_file(
        self,
        found: Written,
        judging: Sequence[Judging],
        fitted: Sequence[Judging],
        folder: Path,
        watch: Watch,
        deviations: Deviations | None = None,
    ) -> Written:
        """Write the file of a corrected arm, judged as its users load it: without the laws that an
        MJCF does not state.

        At joints with such laws the numbers of the file are refined without them; a joint that
        would move worse than described keeps the described numbers.
        """
        file = self.write(found.robot, folder, deviations)
        path = self.path(folder)
        found = replace(found, file=file)
        if not self.mjcf or not isinstance(file, Exported) or self.base is None or path is None:
            return found
        assert found.robot is not None and found.choice is not None
        opened = self.open(path)
        base = self.open(self.base)
        lacking = unstated(opened, found.robot)
        if not lacking:
            return found.with_alone(found.choice.errors)
        numbers = file_numbers(opened.robot, lacking, self._priors)
        moved = refine(opened, opened.robot, numbers, fitted, watch=watch)
        by = np.array([one.by for one in moved])
        refined = robot_at(opened.robot, [one.number for one in moved], by)
        arms = [opened.robot, *([refined] if moved else [])]
        choices = [(self._alone(base, opened, arm, judging, watch), arm) for arm in arms]
        alone, arm = min(choices, key=lambda pair: pair[0].size)
        back = frozenset(alone.taken_back)
        if back >= set(base.robot.joint_names):
            path.unlink()
            return replace(found, file=no_file(lacking))
        found = replace(found.with_alone(alone.errors), kept_in_file=alone.taken_back)
        if arm is not opened.robot or back:
            last = self._exported(with_joints_of(arm, base.robot, back), path, alone=True)
            file = replace(file, changes=last.changes)
            if arm is not opened.robot:
                stay = [one for one in moved if one.number.joint not in back]
                file = replace(file, stand_ins=refined_words(lacking, stay))
        return replace(found, file=file)

    def _alone(
        self,
        base: MjcfArm,
        opened: MjcfArm,
        robot: Robot,
        judging: Sequence[Judging],
        watch: Watch,
    ) -> Choice:
        """Choose which joints of a file have the numbers of an arm, played without its laws.

        opened: the file as it was first written, which has its own arm's numbers.
        """
        with TemporaryDirectory() as temporary:

            def build(back: frozenset[str]) -> MjcfArm:
                if robot is opened.robot and not back:
                    return opened
                kept = Path(temporary) / "kept.xml"
                self._exported(with_joints_of(robot, base.robot, back), kept)
                return self.open(kept)

            found = chosen(base, build, base.robot.joint_names, judging, watch)
        assert found is not None  # as the arm with its laws was played
        return found

    def _exported(
        self,
        robot: Robot,
        file: Path,
        deviations: Deviations | None = None,
        *,
        alone: bool = False,
    ) -> Exported:
        assert self.base is not None
        common = {
            "chain": self._ends,
            "deviations": deviations,
            "catalogue": self._catalogue,
            "motion": self.motion,
        }
        if self.mjcf:
            return export_mjcf(robot, self.base, file, at=self._at, alone=alone, **common)  # type: ignore[arg-type]
        return export_urdf(robot, self.base, file, **common)  # type: ignore[arg-type]

    def _played(self, robot: Robot, file: Path) -> MjcfArm:
        """Return a corrected arm as MuJoCo plays it: by the file that is written, or by a new
        one."""
        if not self.mjcf:
            return playable(robot, file, self._catalogue)
        self._exported(robot, file)
        return with_controllers(self.open(file), robot)


def _kept(moved: Sequence[Moved], back: frozenset[str]) -> tuple[Moved, ...]:
    """Return the numbers that are of what is not taken back."""
    places = [one.number.joint or DELAY for one in moved]  # a delay alone may be of all joints
    return tuple(one for one, place in zip(moved, places, strict=True) if place not in back)


def as_described(error: ClosedLoopError) -> ClosedLoopError:
    """Return the error of a joint whose correction is not written."""
    return replace(error, corrected=error.described)


def print_correction(done: Exported | str | None) -> None:
    """Print the table of changes, or why there is no file."""
    if isinstance(done, str):
        out.print(f"[yellow]no corrected file:[/] {escape(done)}", soft_wrap=True)
    elif done is not None:
        print_export(done)
