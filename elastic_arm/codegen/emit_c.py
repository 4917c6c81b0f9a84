"""A program printed as C for one sample per call, for loops written in C."""

import numpy as np

from elastic_arm.codegen.program import NAMES, OPERATIONS, Program

INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
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
    if name in INFIX:
        return f"{operands[0]} {INFIX[name]} {operands[1]}"
    if name in _SCALAR:
        return _SCALAR[name].format(*operands)
    return f"{name}({', '.join(operands)})"


def literal(value: float) -> str:
    """C literal that is exactly `value`."""
    if np.isfinite(value):
        return float(value).hex() if value != int(value) or abs(value) > 1e6 else f"{value:.1f}"
    if np.isnan(value):
        return "NAN"
    return "INFINITY" if value > 0 else "-INFINITY"


def emit_scalar(program: Program, name: str) -> str:
    """C source of ``static inline void name(const double* in, double* out)`` for one sample.

    `in` holds all inputs one after another, `out` all outputs, dense, matrices row by row.
    """
    offsets = np.cumsum([0, *(size for _, size in program.inputs)])
    lines = []
    for k, names in enumerate(operand_names(program)):
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


def operand_names(program: Program) -> list[list[str]]:
    """Names of each operation's operands; leaves have none."""
    arities = [OPERATIONS[NAMES[code]] for code in program.op]
    return [
        [f"t{operand}" for operand in (a, b)[:arity]]
        for a, b, arity in zip(program.a.tolist(), program.b.tolist(), arities, strict=True)
    ]
