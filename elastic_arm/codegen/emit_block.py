"""A program printed as a C library that runs over arrays of samples, eight samples side by side."""

import functools
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elastic_arm.codegen.emit_c import INFIX, literal, operand_names, scalar_expression
from elastic_arm.codegen.program import NAMES, OPERATIONS, Output, Program

LANES = 8
# Operations in one C function: compilers stay linear, and passing values on costs next to nothing.
_PART = 1500


def emit_block(program: Program, shared: Sequence[str]) -> str:
    """C source of a library that runs `program` over arrays of samples.

    See ``c/block.c`` for its functions.

    Values that no sample changes are computed once a call, by ``prepare``.
    """
    uniform = program.uniform(shared)
    parts = [_source("lanes"), *_lane_functions(program, uniform), *_tables(program, shared)]
    parts += [
        *_prepare(program, uniform),
        *_compute(program, uniform),
        *_spread(program),
        _source("block"),
    ]
    return "\n".join(parts)


def block_identity(program: Program, shared: Sequence[str]) -> str:
    """Return in a few letters what :func:`emit_block` would print.

    They depend on the program and the printer's own source.
    """
    return f"{program.digest()}:{','.join(sorted(shared))}:{_printer_digest()}"


@functools.cache
def _printer_digest() -> str:
    folder = Path(__file__).parent
    files = [folder / "emit_block.py", folder / "emit_c.py", *sorted((folder / "c").glob("*.c"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _source(name: str) -> str:
    return (Path(__file__).parent / "c" / f"{name}.c").read_text(encoding="utf-8")


def _lane_functions(program: Program, uniform: np.ndarray) -> list[str]:
    """Lane by lane versions of what C has no operator for."""
    lines = []
    for name in sorted(
        {NAMES[code] for code in program.op[~uniform]} - set(INFIX) - {"input", "const", "neg"}
    ):
        arity = OPERATIONS[name]
        expression = scalar_expression(name, ["x[l]", "y[l]"][:arity])
        lines.append(f"LANEWISE{'2' if arity == 2 else ''}({name}, ({expression}))")
    return lines


def _prepare(program: Program, uniform: np.ndarray) -> list[str]:
    """Scalars shared by all samples; those that samples use are handed over in `shared`."""
    lines = ["static void prepare(const double *const *in, double *shared) {"]
    for k, operands in enumerate(operand_names(program)):
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
    for k in np.flatnonzero(~uniform).tolist():
        used.update(_operands(program, k))
    for out in program.outputs:
        used.update(out.values.tolist())
    return sorted(k for k in used if uniform[k] and NAMES[program.op[k]] != "const")


def _compute(program: Program, uniform: np.ndarray) -> list[str]:
    """The operations on eight samples, as ``compute``; value k of the outputs goes to ``out[k]``.

    Cut into parts, because a compiler's time grows faster than a function's length; what a later
    part needs passes through ``work``.
    """
    shared = {k: f"shared[{slot}]" for slot, k in enumerate(_handed_over(program, uniform))}
    shared |= {
        k: literal(program.constant[k])
        for k in range(len(program))
        if NAMES[program.op[k]] == "const"
    }
    order = [k for k in range(len(program)) if not uniform[k] and NAMES[program.op[k]] != "input"]
    part_of = {k: position // _PART for position, k in enumerate(order)}
    passed: dict[int, int] = {}
    for k in order:
        for v in _operands(program, k):
            if v in part_of and part_of[v] < part_of[k]:
                passed.setdefault(v, len(passed))
    targets: dict[int, list[int]] = {}
    for position, value in enumerate(
        np.concatenate([out.values for out in program.outputs]).tolist()
    ):
        targets.setdefault(value, []).append(position)
    signature = "(const double *const *in, const double *shared, v8 *out, v8 *work)"
    lines = []
    calls = []
    for number in range(max(part_of.values(), default=-1) + 1):
        lines.append(f"static __attribute__((noinline)) void part_{number}{signature} {{")
        calls.append(f"  part_{number}(in, shared, out, work);")
        names = dict(shared)
        for k in order[number * _PART : (number + 1) * _PART]:
            lines += _named(program, k, names, passed)
            lines.append(f"  const v8 t{k} = {_lane_expression(program, k, uniform, names)};")
            names[k] = f"t{k}"
            lines += [f"  out[{position}] = t{k};" for position in targets.get(k, ())]
            lines += [f"  work[{passed[k]}] = t{k};"] if k in passed else []
        lines.append("}")
    lines.append("static void compute(const double *const *in, const double *shared, v8 *out) {")
    lines += [f"  v8 work[{len(passed) + 1}];", *calls]
    for k, positions in targets.items():
        if k not in part_of:
            value = f"splat({shared[k]})" if uniform[k] else _load(program, k)
            lines += [f"  out[{position}] = {value};" for position in positions]
    return [*lines, "}"]


def _operands(program: Program, k: int) -> list[int]:
    return [int(v) for v in (program.a[k], program.b[k])[: OPERATIONS[NAMES[program.op[k]]]]]


def _named(program: Program, k: int, names: dict[int, str], passed: dict[int, int]) -> list[str]:
    """Declare what operation k needs and this part has not seen: inputs, and values that earlier
    parts passed on."""
    lines = []
    for v in _operands(program, k):
        if v not in names:
            names[v] = f"t{v}"
            lines.append(
                f"  const v8 t{v} ="
                f" {_load(program, v) if v not in passed else f'work[{passed[v]}]'};"
            )
    return lines


def _load(program: Program, k: int) -> str:
    """Element of an input at eight samples."""
    size = program.inputs[program.a[k]][1]
    base = f"in[{program.a[k]}]"
    return (
        "(v8){" + ", ".join(f"{base}[{program.b[k] + lane * size}]" for lane in range(LANES)) + "}"
    )


def _lane_expression(program: Program, k: int, uniform: np.ndarray, names: dict[int, str]) -> str:
    operation = NAMES[program.op[k]]
    operands = _operands(program, k)
    if operation in INFIX or operation == "neg":
        return scalar_expression(operation, [names[v] for v in operands])
    lanes = [f"splat({names[v]})" if uniform[v] else names[v] for v in operands]
    return f"lane_{operation}({', '.join(lanes)})"


def _tables(program: Program, shared: Sequence[str]) -> list[str]:
    """Sizes of inputs and outputs."""
    sizes = [size for _, size in program.inputs]
    constants = {
        "N_INPUTS": len(sizes),
        "N_OUTPUTS": len(program.outputs),
        "N_VALUES": sum(len(out.values) for out in program.outputs),
        "N_SHARED": len(_handed_over(program, program.uniform(shared))),
        "MAX_SIZE": max(sizes, default=1),
    }
    tables = {
        "input_size": sizes,
        "input_shared": [int(name in set(shared)) for name, _ in program.inputs],
        "output_size": [out.size for out in program.outputs],
    }
    lines = [f"enum {{ {', '.join(f'{name} = {value}' for name, value in constants.items())} }};"]
    for name, values in tables.items():
        lines.append(f"static const int {name}[] = {{{', '.join(map(str, values or [0]))}}};")
    return lines


def _spread(program: Program) -> list[str]:
    """Functions that put each output's values, eight lanes each, to their places in eight dense
    samples."""
    lines = []
    offset = 0
    for number, out in enumerate(program.outputs):
        lines.append(f"static void spread_{number}(const double *v, double *to) {{")
        lines.append("  const v4 nil = {0.0, 0.0, 0.0, 0.0};")
        fours, singles = _runs(out, offset)
        for place, run in fours:
            for half in (0, 4):
                four = ", ".join(
                    "nil" if k is None else f"*(const v4 *)(v + {k * LANES + half})" for k in run
                )
                lines.append(f"  store_lanes({four}, to + {place + half * out.size}, {out.size});")
        for place, k in singles:
            lines += [
                f"  to[{place + lane * out.size}] = v[{k * LANES + lane}];" for lane in range(LANES)
            ]
        lines.append("}")
        offset += len(out.values)
    names = ", ".join(f"spread_{number}" for number in range(len(program.outputs)))
    return [*lines, f"static void (*const spread[])(const double *, double *) = {{{names}}};"]


def _runs(
    out: Output, offset: int
) -> tuple[list[tuple[int, list[int | None]]], list[tuple[int, int]]]:
    """Cover an output's places by runs of four, None where null, and by single ones where a run
    would not pay."""
    value_at = {place: offset + k for k, place in enumerate(out.places.tolist())}
    fours: list[tuple[int, list[int | None]]] = []
    singles: list[tuple[int, int]] = []
    covered = -1
    for place in sorted(value_at):
        if place <= covered:
            continue
        four = [value_at.get(p) for p in range(place, place + 4)]
        if place + 4 <= out.size and sum(k is not None for k in four) > 1:
            fours.append((place, four))
            covered = place + 3
        else:
            singles.append((place, value_at[place]))
    return fours, singles
