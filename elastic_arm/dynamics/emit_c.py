"""A program printed as C: one sample a call, for a loop written in C, or eight samples side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elastic_arm.dynamics.program import NAMES, OPERATIONS, Output, Program

LANES = 8
_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_SCALAR = {
    "neg": "-{0}",
    "lt": "({0} < {1} ? 1.0 : 0.0)",
    "le": "({0} <= {1} ? 1.0 : 0.0)",
    "eq": "({0} == {1} ? 1.0 : 0.0)",
    "ne": "({0} != {1} ? 1.0 : 0.0)",
    "and": "({0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0)",
    "or": "({0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0)",
    "not": "({0} == 0.0 ? 1.0 : 0.0)",
    "sign": "(({0} > 0.0) - ({0} < 0.0))",
    "if_else_zero": "({0} != 0.0 ? {1} : 0.0)",
}


def scalar_expression(name: str, operands: list[str]) -> str:
    """C expression of one operation."""
    if name in _INFIX:
        return f"{operands[0]} {_INFIX[name]} {operands[1]}"
    if name in _SCALAR:
        return _SCALAR[name].format(*operands)
    return f"{name}({', '.join(operands)})"


def literal(value: float) -> str:
    """C literal that is exactly `value`."""
    if np.isfinite(value):
        return float(value).hex() if value != int(value) or abs(value) > 1e6 else f"{value:.1f}"
    return "NAN" if np.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"


def emit_scalar(program: Program, name: str) -> str:
    """C source of ``static inline void name(const double* in, double* out)`` for one sample.

    `in` holds all inputs one after another, `out` all outputs, dense, matrices row by row.
    """
    offsets = np.cumsum([0, *(size for _, size in program.inputs)])
    lines = []
    for k, names in enumerate(_operands(program)):
        operation = NAMES[program.op[k]]
        if operation == "input":
            expression = f"in[{offsets[program.a[k]] + program.b[k]}]"
        elif operation == "const":
            expression = literal(program.constant[k])
        else:
            expression = scalar_expression(operation, names)
        lines.append(f"  const double t{k} = {expression};")
    start = 0
    for out in program.outputs:
        entries = ["0.0"] * out.size
        for value, place in zip(out.values.tolist(), out.places.tolist(), strict=True):
            entries[place] = f"t{value}"
        lines += [f"  out[{start + place}] = {entry};" for place, entry in enumerate(entries)]
        start += out.size
    head = f"#include <math.h>\nstatic inline void {name}(const double* in, double* out) {{\n"
    return head + "\n".join(lines) + "\n}\n"


def _operands(program: Program) -> list[list[str]]:
    """Names of each operation's operands; leaves have none."""
    arities = [OPERATIONS[NAMES[code]] for code in program.op]
    return [
        [f"t{operand}" for operand in (a, b)[:arity]]
        for a, b, arity in zip(program.a.tolist(), program.b.tolist(), arities, strict=True)
    ]


def emit_block(program: Program, shared: Sequence[str]) -> str:
    """C source of a library that runs `program` over arrays of samples; see ``c/block.c`` for its functions.

    Values that no sample changes are computed once a call, by ``prepare``.
    """
    uniform = program.uniform(shared)
    parts = [_source("lanes"), *_lane_functions(program, uniform), *_tables(program, shared)]
    parts += [*_prepare(program, uniform), *_compute(program, uniform), _source("block")]
    return "\n".join(parts)


def gram_source() -> str:
    """C source of the accumulation of information matrices in twice the working precision."""
    return _source("lanes") + "\n" + _source("gram")


def _source(name: str) -> str:
    return (Path(__file__).parent / "c" / f"{name}.c").read_text(encoding="utf-8")


def _lane_functions(program: Program, uniform: np.ndarray) -> list[str]:
    """Lane by lane versions of what C has no operator for."""
    lines = []
    for name in sorted({NAMES[code] for code in program.op[~uniform]} - set(_INFIX) - {"input", "const", "neg"}):
        arity = OPERATIONS[name]
        expression = scalar_expression(name, ["x[l]", "y[l]"][:arity])
        lines.append(f"LANEWISE{'2' if arity == 2 else ''}({name}, ({expression}))")
    return lines


def _prepare(program: Program, uniform: np.ndarray) -> list[str]:
    """Scalars shared by all samples; those that samples use are handed over in `shared`."""
    lines = ["static void prepare(const double *const *in, double *shared) {"]
    for k, operands in enumerate(_operands(program)):
        operation = NAMES[program.op[k]]
        if not uniform[k] or operation == "const":
            continue
        source = f"in[{program.a[k]}][{program.b[k]}]"
        names = [
            literal(program.constant[v]) if NAMES[program.op[v]] == "const" else name
            for v, name in zip((program.a[k], program.b[k]), operands, strict=False)
        ]
        expression = source if operation == "input" else scalar_expression(operation, names)
        lines.append(f"  const double t{k} = {expression};")
    lines += [f"  shared[{slot}] = t{k};" for slot, k in enumerate(_handed_over(program, uniform))]
    return [*lines, "}"]


def _handed_over(program: Program, uniform: np.ndarray) -> list[int]:
    used: set[int] = set()
    for k in np.flatnonzero(~uniform):
        used.update((int(program.a[k]), int(program.b[k]))[: OPERATIONS[NAMES[program.op[k]]]])
    for out in program.outputs:
        used.update(out.values.tolist())
    return sorted(k for k in used if uniform[k] and NAMES[program.op[k]] != "const")


def _compute(program: Program, uniform: np.ndarray) -> list[str]:
    """The operations on eight samples; value k of the outputs goes to ``out[k * step]``."""
    lines = ["static void compute(const double *const *in, const double *shared, v8 *out, long step) {"]
    slots = {k: slot for slot, k in enumerate(_handed_over(program, uniform))}
    names: dict[int, str] = {k: f"shared[{slot}]" for k, slot in slots.items()}
    names |= {k: literal(program.constant[k]) for k in range(len(program)) if NAMES[program.op[k]] == "const"}
    targets: dict[int, list[int]] = {}
    for position, value in enumerate(np.concatenate([out.values for out in program.outputs]).tolist()):
        targets.setdefault(value, []).append(position)
    for k in range(len(program)):
        if not uniform[k]:
            lines.append(f"  const v8 t{k} = {_lane_expression(program, k, uniform, names)};")
            names[k] = f"t{k}"
        value = names[k] if not uniform[k] else f"splat({names[k]})" if k in names else ""
        lines += [f"  out[{position} * step] = {value};" for position in targets.get(k, ())]
    return [*lines, "}"]


def _lane_expression(program: Program, k: int, uniform: np.ndarray, names: dict[int, str]) -> str:
    operation = NAMES[program.op[k]]
    if operation == "input":
        size = program.inputs[program.a[k]][1]
        base = f"in[{program.a[k]}]"
        return "{" + ", ".join(f"{base}[{program.b[k] + lane * size}]" for lane in range(LANES)) + "}"
    operands = [int(v) for v in (program.a[k], program.b[k])[: OPERATIONS[operation]]]
    if operation in _INFIX or operation == "neg":
        return scalar_expression(operation, [names[v] for v in operands])
    return f"lane_{operation}({', '.join(f'splat({names[v]})' if uniform[v] else names[v] for v in operands)})"


def _tables(program: Program, shared: Sequence[str]) -> list[str]:
    """Sizes, and where the values go in the dense outputs."""
    total = sum(len(out.values) for out in program.outputs)
    sizes = [size for _, size in program.inputs]
    first, starts, runs = [0], [], []
    offset = 0
    for out in program.outputs:
        for start, run in _runs(out, offset, total):
            starts.append(start)
            runs.append(run)
        first.append(len(runs))
        offset += len(out.values)
    head = program.outputs[0]
    row_of = head.places // head.shape[1]
    row_first = np.searchsorted(row_of, np.arange(head.shape[0] + 1))
    uniform = program.uniform(shared)
    constants = {
        "N_INPUTS": len(sizes),
        "N_OUTPUTS": len(program.outputs),
        "N_VALUES": total,
        "N_SHARED": len(_handed_over(program, uniform)),
        "MAX_SIZE": max(sizes, default=1),
        "ROWS": head.shape[0],
    }
    lines = [f"enum {{ {', '.join(f'{name} = {value}' for name, value in constants.items())} }};"]
    tables = {
        "input_size": sizes,
        "input_shared": [int(name in set(shared)) for name, _ in program.inputs],
        "output_size": [out.size for out in program.outputs],
        "run_first": first,
        "run_start": starts,
        "row_first": row_first.tolist(),
        "row_value": list(range(len(head.values))),
    }
    lines += [
        f"static const int {name}[] = {{{', '.join(map(str, values or [0]))}}};" for name, values in tables.items()
    ]
    rows = ", ".join("{" + ", ".join(map(str, run)) + "}" for run in runs or [[total] * 8])
    return [*lines, f"static const int run_value[][8] = {{{rows}}};"]


def _runs(out: Output, offset: int, nothing: int) -> list[tuple[int, list[int]]]:
    """Cover an output's places by runs of eight, last first.

    A run may reach past the sample's end into the next one's start: those places belong to runs that are stored later,
    or to the next lane of the same run.
    """
    value_at = {place: offset + k for k, place in enumerate(out.places.tolist())}
    runs: list[tuple[int, list[int]]] = []
    covered = -1
    for place in sorted(value_at):
        if place > covered:
            runs.append((place, [value_at.get(p, nothing) for p in range(place, place + 8)]))
            covered = place + 7
    return runs[::-1]
