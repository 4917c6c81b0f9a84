"""Common parts of results: tables as rows, CSV files and data frames, and display in notebooks."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Literal

from elastic_arm.errors import OutputError, require_libraries
from elastic_arm.output_files import csv_text, write_result

Row = Mapping[str, Any]


@dataclass(frozen=True)
class ClosedLoopError:
    """Errors of a commanded joint in MuJoCo under recorded commands, rms."""

    described: float  # by the description, in `unit`
    corrected: float  # by what was written
    unit: str  # "rad", or "m" of a joint that slides
    # with all that was found, where not all was written: this joint then moved worse than
    # described; None elsewhere
    refused: float | None = None
    # by the written MJCF as it is loaded, without laws that only robot.yaml states; None where no
    # MJCF is written
    alone: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`; null where a model leaves the finite numbers."""
        numbers = {"described": self.described, "corrected": self.corrected}
        for name in ("refused", "alone"):
            value = getattr(self, name)
            if value is not None:
                numbers[name] = value
        rounded = {
            name: float(f"{v:.4g}") if v < float("inf") else None for name, v in numbers.items()
        }
        return {**rounded, "unit": self.unit}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "ClosedLoopError":
        """Return what :meth:`to_dict` wrote."""
        numbers = {
            name: float("inf") if v is None else v for name, v in data.items() if name != "unit"
        }
        return ClosedLoopError(**numbers, unit=data["unit"])


class Result(ABC):
    """A result with tables, a summary and a figure.

    The plot functions belong to a later package and are found by name on first use.
    """

    # module with `overview(result)`, a figure, `head(result)`, HTML, and `summary`
    _report: ClassVar[str]

    @abstractmethod
    def tables(self) -> dict[str, Sequence[Row]]:
        """Return the tables by name, as rows; the first one is the most important."""

    def summary(self) -> list[str]:
        """Return the result as sentences, the most important first."""
        return list(import_module(self._report).summary(self))

    def __repr__(self) -> str:
        return "\n".join(self.summary())

    def to_dataframe(self, table: str = "", library: Literal["pandas", "polars"] = "pandas") -> Any:
        """Return a table, the first one by default, as a data frame.

        An OutputError where it is not there.
        """
        require_libraries("a data frame needs", library)
        tables = self.tables()
        if table and table not in tables:
            raise OutputError(f"unknown table {table!r}", f"Choose one of {', '.join(tables)}.")
        rows = tables[table or next(iter(tables))]
        # a column holds whole numbers and others
        mixed = {"strict": False} if library == "polars" else {}
        names = list(rows[0]) if rows else []
        columns = {name: [row[name] for row in rows] for name in names}
        return import_module(library).DataFrame(columns, **mixed)

    def to_csv(self, folder: str | Path) -> list[Path]:
        """Write every table that has rows as a CSV file into a folder.

        An OutputError where that cannot be.
        """
        written = []
        for name, rows in self.tables().items():
            if rows:
                text = csv_text(list(rows[0]), list(map(_short, rows)))
                written.append(write_result(Path(folder) / f"{name}.csv", text))
        return written

    def plot(self) -> Any:
        """Return a figure (matplotlib's) of the whole."""
        return import_module(self._report).overview(self)

    def _repr_html_(self) -> str:
        return str(import_module(self._report).head(self))


def _short(row: Row) -> dict[str, Any]:
    """Return a row with nine digits of each number that is not whole."""
    return {k: f"{v:.9g}" if isinstance(v, float) else v for k, v in row.items()}
