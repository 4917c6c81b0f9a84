"""A function as a straight-line list of operations: value-numbered, pruned, saved and loaded
without CasADi."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import casadi

# Name -> number of operands. The first two are leaves: an element of an input, a constant.
OPERATIONS: dict[str, int] = {
    "input": 0,
    "const": 0,
    **dict.fromkeys(
        ("add", "sub", "mul", "div", "pow", "fmod", "copysign", "fmin", "fmax", "atan2", "hypot"), 2
    ),
    **dict.fromkeys(("lt", "le", "eq", "ne", "and", "or", "if_else_zero"), 2),
    **dict.fromkeys(
        ("neg", "exp", "log", "log1p", "expm1", "sqrt", "fabs", "sign", "floor", "ceil", "not"), 1
    ),
    **dict.fromkeys(
        ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "erf"), 1
    ),
    **dict.fromkeys(("asinh", "acosh", "atanh"), 1),
}
NAMES = tuple(OPERATIONS)
CODES = {name: code for code, name in enumerate(NAMES)}
_COMMUTATIVE = {"add", "mul", "fmin", "fmax", "hypot", "eq", "ne", "and", "or"}


@dataclass(frozen=True, eq=False)
class Output:
    """One output: its dense shape, and which values are at which places (row by row).

    The rest is zero.
    """

    name: str
    shape: tuple[int, int]
    values: np.ndarray
    places: np.ndarray

    @property
    def size(self) -> int:
        """Entries of the dense output."""
        return self.shape[0] * self.shape[1]


@dataclass(frozen=True, eq=False)
class Program:
    """Operations in order; value k is what operation k makes."""

    inputs: tuple[tuple[str, int], ...]  # names and sizes
    outputs: tuple[Output, ...]  # see :class:`Output`
    # op, a, b: (K,) int, Code (:data:`CODES`) and operands: values, or for a leaf ``input`` its
    # input's index and element
    op: np.ndarray
    a: np.ndarray
    b: np.ndarray
    constant: np.ndarray  # (K,) float, of the leaves ``const``

    def __len__(self) -> int:
        return len(self.op)

    def uniform(self, shared: Iterable[str]) -> np.ndarray:
        """(K,) bool: values that no sample changes.

        They come from constants and `shared` inputs alone.
        """
        is_shared = np.array([name in set(shared) for name, _ in self.inputs])
        result = np.zeros(len(self), dtype=bool)
        for k, (code, a, b) in enumerate(
            zip(self.op.tolist(), self.a.tolist(), self.b.tolist(), strict=True)
        ):
            arity = OPERATIONS[NAMES[code]]
            if NAMES[code] == "input":
                result[k] = is_shared[a]
            else:
                result[k] = arity == 0 or (result[a] and (arity == 1 or result[b]))
        return result

    def columns(self, output: str, columns: Sequence[int]) -> Program:
        """Return the program with only these columns of matrix `output`.

        Operations that they do not need are left out.
        """
        position = {int(c): k for k, c in enumerate(columns)}
        changed = []
        for out in self.outputs:
            if out.name == output:
                row, column = np.divmod(out.places, out.shape[1])
                kept = np.isin(column, list(position))
                places = [
                    r * len(position) + position[c]
                    for r, c in zip(row[kept], column[kept], strict=True)
                ]
                order = np.argsort(places)
                out = Output(
                    out.name,
                    (out.shape[0], len(position)),
                    out.values[kept][order],
                    np.array(places, dtype=np.int64)[order],
                )
            changed.append(out)
        return replace(self, outputs=tuple(changed)).pruned()

    def pruned(self) -> Program:
        """Return the program without operations that no output needs."""
        needed = np.zeros(len(self), dtype=bool)
        for out in self.outputs:
            needed[out.values] = True
        for k in range(len(self) - 1, -1, -1):
            if needed[k]:
                arity = OPERATIONS[NAMES[self.op[k]]]
                if arity >= 1:
                    needed[self.a[k]] = True
                if arity == 2:
                    needed[self.b[k]] = True
        new = np.cumsum(needed) - 1
        leaf = np.isin(self.op, (CODES["input"], CODES["const"]))
        # A leaf's operands index inputs, not values.
        a = np.where(leaf, self.a, new[np.where(leaf, 0, self.a)])[needed]
        b = np.where(leaf, self.b, new[np.where(leaf, 0, self.b)])[needed]
        outputs = tuple(replace(out, values=new[out.values]) for out in self.outputs)
        return replace(
            self, outputs=outputs, op=self.op[needed], a=a, b=b, constant=self.constant[needed]
        )

    def digest(self) -> str:
        """Hash of inputs, outputs and operations."""
        names = [self.inputs, [(out.name, out.shape) for out in self.outputs]]
        arrays = [
            self.op,
            self.a,
            self.b,
            self.constant,
            *(v for o in self.outputs for v in (o.values, o.places)),
        ]
        content = json.dumps(names).encode() + b"".join(
            np.ascontiguousarray(array).tobytes() for array in arrays
        )
        return hashlib.sha256(content).hexdigest()

    def save(self, path: Path) -> None:
        """Write to `path` (npz)."""
        meta = {"inputs": self.inputs, "outputs": [(o.name, o.shape) for o in self.outputs]}
        arrays: dict[str, Any] = {f"values_{k}": o.values for k, o in enumerate(self.outputs)}
        arrays |= {f"places_{k}": o.places for k, o in enumerate(self.outputs)}
        with path.open("wb") as file:
            np.savez(
                file,
                meta=json.dumps(meta),
                op=self.op,
                a=self.a,
                b=self.b,
                constant=self.constant,
                **arrays,
            )

    @classmethod
    def load(cls, path: Path) -> Program:
        """Read what :meth:`save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            outputs = tuple(
                Output(name, tuple(shape), file[f"values_{k}"], file[f"places_{k}"])
                for k, (name, shape) in enumerate(meta["outputs"])
            )
            inputs = tuple((name, size) for name, size in meta["inputs"])
            return cls(inputs, outputs, file["op"], file["a"], file["b"], file["constant"])


class _Builder:
    """Numbers values: the same operation on the same operands is one value."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, int, float]] = []
        self._known: dict[tuple[str, int, int, float], int] = {}

    def value(self, name: str, a: int = 0, b: int = 0, constant: float = 0.0) -> int:
        if name in _COMMUTATIVE and b < a:
            a, b = b, a
        key = (name, a, b, constant)
        if key not in self._known:
            self._known[key] = len(self.rows)
            self.rows.append((CODES[name], a, b, constant))
        return self._known[key]

    def composed(self, name: str, operands: list[int]) -> int:
        """Value of a CasADi operation, its shorthands written out."""
        match name, operands:
            case "sq", [a, *_]:
                return self.value("mul", a, a)
            case "twice", [a, *_]:
                return self.value("add", a, a)
            case "inv", [a, *_]:
                return self.value("div", self.value("const", constant=1.0), a)
            case "constpow", [a, b]:
                return self.value("pow", a, b)
            case "assign", [a, *_]:
                return a
        if name not in OPERATIONS:
            raise NotImplementedError(
                f"operation {name} has no straight-line form; express it by other operations"
            )
        return self.value(name, *operands[: OPERATIONS[name]])


@cache
def _casadi_names() -> dict[int, str]:
    """Return the name of each of CasADi's operations by its number."""
    import casadi

    return {
        getattr(casadi, name): name[3:].lower() for name in dir(casadi) if name.startswith("OP_")
    }


def from_casadi(function: casadi.Function) -> Program:
    """Read the operations of an SX function with dense inputs.

    Outputs may be sparse, vectors or matrices.
    """
    names = _casadi_names()
    builder = _Builder()
    work: dict[int, int] = {}
    shapes = [function.size_out(k) for k in range(function.n_out())]
    places = [_places(function.sparsity_out(k)) for k in range(function.n_out())]
    values: list[list[tuple[int, int]]] = [[] for _ in shapes]
    for k in range(function.n_instructions()):
        name = names[function.instruction_id(k)]
        taken = function.instruction_input(k)
        if name == "output":
            output, element = function.instruction_output(k)
            values[output].append((int(places[output][element]), work[taken[0]]))
            continue
        target = function.instruction_output(k)[0]
        if name == "const":
            work[target] = builder.value("const", constant=function.instruction_constant(k))
        elif name == "input":
            work[target] = builder.value("input", *taken)
        else:
            work[target] = builder.composed(name, [work[t] for t in taken])
    op, a, b, constant = zip(*builder.rows, strict=True)
    outputs = []
    for k, (shape, pairs) in enumerate(zip(shapes, values, strict=True)):
        pairs.sort()
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        outputs.append(Output(function.name_out(k), shape, table[:, 1], table[:, 0]))
    inputs = tuple((function.name_in(k), function.numel_in(k)) for k in range(function.n_in()))
    codes = np.array(op, dtype=np.int64)
    first = np.array(a, dtype=np.int64)
    second = np.array(b, dtype=np.int64)
    return Program(inputs, tuple(outputs), codes, first, second, np.array(constant)).pruned()


def _places(sparsity: casadi.Sparsity) -> np.ndarray:
    """Where each structural non-zero stands in the dense matrix written row by row."""
    rows, columns = sparsity.get_triplet()
    return np.array(rows, dtype=np.int64) * sparsity.size2() + np.array(columns, dtype=np.int64)
