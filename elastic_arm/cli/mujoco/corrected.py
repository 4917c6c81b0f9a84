"""The user's own file with the numbers that a diagnosis or an identification found, beside
robot.yaml."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.markup import escape

from elastic_arm.cli.console import out
from elastic_arm.cli.mujoco.export import print_export
from elastic_arm.diagnosis.words import listed
from elastic_arm.effects import Catalogue
from elastic_arm.errors import MissingExtraError, RobotError
from elastic_arm.mujoco import Exported, export_mjcf, export_urdf
from elastic_arm.mujoco.changed_numbers import Deviations
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.judgement import Choice, Judging, chosen
from elastic_arm.mujoco.left_out import Motion
from elastic_arm.mujoco.new_model import playable
from elastic_arm.mujoco.refinement import DELAY, Refinable, by_words, refine, robot_at
from elastic_arm.results import ClosedLoopError
from elastic_arm.robot import Robot
from elastic_arm.robot.loading import is_mjcf, parse_chain
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

SUFFIX = "_corrected"
NAMED = 6  # numbers that a note names


# What is taken back -> the corrected arm without it.
Corrected = Callable[[frozenset[str]], Robot]


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
    refined: tuple[
        tuple[Refinable, float], ...
    ] = ()  # numbers of it that were refined in closed loop, and by how much

    def note(self) -> str:
        """Return in a sentence which numbers differ from those found; empty if none does."""
        far = [(abs(by) / number.std, number, by) for number, by in self.refined]
        told = [
            by_words(number, by)
            for share, number, by in sorted(far, key=lambda one: -one[0])
            if share > 1.0
        ]
        if not told:
            return ""
        more = len(told) - NAMED
        return (
            "The numbers of the corrected arm are refined by simulations of the fitted"
            " recordings, starting from the posterior. These change by more than their standard"
            f" deviation: {listed(told[:NAMED], more)}."
        )


class Correction:
    """Where an arm came from, and so where its corrected numbers go.

    base: file that the arm was read from; nothing is written for the package's own arm and for arm
    files.
    """

    def __init__(
        self, base: Path | None, chain: str | None, at: str | None, catalogue: Catalogue
    ) -> None:
        self.base = base
        self.motion: Motion | None = (
            None  # over which friction stands for laws that the file has no number for
        )
        self._ends = None if chain is None else parse_chain(chain)
        self._at = at
        self._catalogue = catalogue
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
    ) -> Written:
        """Write the part of a commanded arm's correction that makes it no worse.

        It moves the arm nearer to the recordings that judge, or as near.

        robot: as described; units: what can be taken back; caused: whether what is as near as
        described is written; numbers: those that are refined first, on the recordings that were
        fitted.
        """
        choice = None
        by = np.zeros(len(numbers))

        def arm_without(back: frozenset[str]) -> Robot:
            kept = [
                (one, float(x)) for one, x in zip(numbers, by, strict=True) if _stays(one, back)
            ]
            return robot_at(
                corrected(back), [one for one, _ in kept], np.array([x for _, x in kept])
            )

        with TemporaryDirectory() as temporary:

            def build(back: frozenset[str]) -> MjcfArm:
                return self._played(arm_without(back), Path(temporary) / "arm.xml")

            try:
                if fitted:
                    found = corrected(frozenset())
                    by = refine(build(frozenset()), found, numbers, fitted)
            except (RobotError, MissingExtraError):
                pass  # numbers that no simulator takes: they are taken back below
            try:
                described = (
                    with_controllers(self.open(self.base), robot)
                    if self.base and self.mjcf
                    else None
                )
                described = described or playable(robot, Path(temporary) / "described.xml")
                choice = chosen(described, build, units, judging)
            except (RobotError, MissingExtraError):
                pass  # a controller that MuJoCo has not: nothing is played
        if choice is None:
            arm = arm_without(frozenset()) if caused else None
            return Written(self.write(arm, folder, deviations), arm)
        back = frozenset(choice.taken_back)
        if back >= set(units) or not (caused or choice.better):
            self.write(None, folder)
            errors = {name: as_described(one) for name, one in choice.errors.items()}
            return Written(choice.reason or None, None, choice.with_errors(errors))
        arm = arm_without(back)
        moved = tuple(
            (one, float(x)) for one, x in zip(numbers, by, strict=True) if x and _stays(one, back)
        )
        return Written(self.write(arm, folder, None if moved else deviations), arm, choice, moved)

    def _exported(self, robot: Robot, file: Path, deviations: Deviations | None = None) -> Exported:
        assert self.base is not None
        common = {
            "chain": self._ends,
            "deviations": deviations,
            "catalogue": self._catalogue,
            "motion": self.motion,
        }
        if self.mjcf:
            return export_mjcf(robot, self.base, file, at=self._at, **common)  # type: ignore[arg-type]
        return export_urdf(robot, self.base, file, **common)  # type: ignore[arg-type]

    def _played(self, robot: Robot, file: Path) -> MjcfArm:
        """Return a corrected arm as MuJoCo plays it: by the file that is written, or by a new
        one."""
        if not self.mjcf:
            return playable(robot, file, self._catalogue)
        self._exported(robot, file)
        return with_controllers(self.open(file), robot)


def _stays(number: Refinable, back: frozenset[str]) -> bool:
    """Whether a number is of what is not taken back."""
    return number.joint not in back and not (number.joint is None and DELAY in back)


def as_described(error: ClosedLoopError) -> ClosedLoopError:
    """Return the error of a joint whose correction is not written."""
    return replace(error, corrected=error.described)


def print_correction(done: Exported | str | None) -> None:
    """Print the table of changes, or why there is no file."""
    if isinstance(done, str):
        out.print(f"[yellow]no corrected file:[/] {escape(done)}", soft_wrap=True)
    elif done is not None:
        print_export(done)
