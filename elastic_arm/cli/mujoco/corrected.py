"""The user's own file with the numbers that a diagnosis or an identification found, beside robot.yaml."""

from pathlib import Path

from rich.markup import escape

from elastic_arm.cli.console import out
from elastic_arm.cli.mujoco.export import print_export
from elastic_arm.effects import Catalogue
from elastic_arm.errors import MissingExtraError, RobotError
from elastic_arm.mujoco import Exported, export_mjcf, export_urdf
from elastic_arm.mujoco.changes import Deviations
from elastic_arm.robot import Robot
from elastic_arm.robot.loading import is_mjcf, parse_chain
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

SUFFIX = "_corrected"


class Correction:
    """Where an arm came from, and so where its corrected numbers go.

    base: file that the arm was read from; nothing is written for the package's own arm and for arm files.
    """

    def __init__(self, base: Path | None, chain: str | None, at: str | None, catalogue: Catalogue) -> None:
        self.base = base
        self._ends = None if chain is None else parse_chain(chain)
        self._at, self._catalogue = at, catalogue
        self.mjcf = base is not None and is_mjcf(base)
        self._written = self.mjcf or (base is not None and base.suffix.lower() in (".urdf", ".xml"))

    def path(self, folder: Path) -> Path | None:
        """Return the file that is written into a folder; None where none is."""
        return folder / f"{self.base.stem}{SUFFIX}{self.base.suffix}" if self.base and self._written else None

    def require_mjcf(self, option: str | None) -> None:
        """Refuse an option, where one is given, if the arm came from no MJCF."""
        if option is not None and not self.mjcf:
            raise RobotError(f"{option} needs an MJCF", "Give one with --robot model.xml")

    def open(self, path: Path) -> MjcfArm:
        """Open the arm in the MJCF that it came from, or in a copy."""
        return open_mjcf(path, self._ends, self._at)

    def write(self, robot: Robot | None, folder: Path, deviations: Deviations | None = None) -> Exported | str | None:
        """Write the file."""
        file = self.path(folder)
        if file is None or self.base is None:
            return None
        file.unlink(missing_ok=True)
        if robot is None:
            return None
        common = {"chain": self._ends, "deviations": deviations, "catalogue": self._catalogue}
        try:
            if self.mjcf:
                return export_mjcf(robot, self.base, file, at=self._at, **common)  # type: ignore[arg-type]
            return export_urdf(robot, self.base, file, **common)  # type: ignore[arg-type]
        except (RobotError, MissingExtraError) as error:
            return str(error)


def print_correction(done: Exported | str | None) -> None:
    """Print the table of changes, or why there is no file."""
    if isinstance(done, str):
        out.print(f"[yellow]no corrected file:[/] {escape(done)}", soft_wrap=True)
    elif done is not None:
        print_export(done)
