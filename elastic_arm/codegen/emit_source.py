"""Programs printed as one file that needs only C's `math.h` or Python's `math`.

Unlike the code of :mod:`.emit_block`, which this package runs itself, it is for controllers: one
sample per call, readable names, and no memory of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from elastic_arm.codegen.emit_c import INFIX, scalar_expression
from elastic_arm.codegen.program import NAMES, OPERATIONS, Program

_PYTHON = {
    "neg": "-{0}",
    "lt": "float({0} < {1})",
    "le": "float({0} <= {1})",
    "eq": "float({0} == {1})",
    "ne": "float({0} != {1})",
    "and": "float({0} != 0.0 and {1} != 0.0)",
    "or": "float({0} != 0.0 or {1} != 0.0)",
    "not": "float({0} == 0.0)",
    "sign": "(math.copysign(1.0, {0}) if {0} != 0.0 else 0.0)",
    "if_else_zero": "({1} if {0} != 0.0 else 0.0)",
    "fmin": "min({0}, {1})",
    "fmax": "max({0}, {1})",
    "floor": "float(math.floor({0}))",
    "ceil": "float(math.ceil({0}))",
}


@dataclass(frozen=True)
class Constant:
    """An input that the file states as a number, which its user may change."""

    name: str  # of the input
    value: float
    meaning: str


def c_source(
    programs: Mapping[str, Program], constant: Constant, prefix: str, about: Sequence[str]
) -> str:
    """Return programs of one output each as C99: ``void prefix_name(const double q[n], …, double
    out[n])``.

    about: lines of the comment that the file begins with.
    """
    told = "\n".join(f" * {line}".rstrip() for line in about)
    macro = f"{prefix}_{constant.name}".upper()
    parts = [
        f"/*\n{told}\n */",
        "#include <math.h>\n",
        f"/* {constant.meaning} */\n#define {macro} {constant.value!r}\n",
    ]
    for name, program in programs.items():
        given = _inputs(program, constant)
        arguments = [f"const double {one}[{size}]" for one, size in given.items()]
        (output,) = program.outputs
        arguments.append(f"double {output.name}[{output.size}]")
        unused = [f"  (void){one};" for one in given]
        lines = _statements(
            program, constant, macro, "const double t{k} = {value};", scalar_expression
        )
        lines += [f"{output.name}[{i}] = {value};" for i, value in enumerate(_results(program))]
        body = "\n".join([*unused, *(f"  {line}" for line in lines)])
        parts.append(f"void {prefix}_{name}({', '.join(arguments)})\n{{\n{body}\n}}\n")
    return "\n".join(parts)


def python_source(programs: Mapping[str, Program], constant: Constant, about: Sequence[str]) -> str:
    """Return programs of one output each as Python functions of sequences that return lists.

    about: lines of the docstring that the file begins with; the first one is its summary.
    """
    name_of_constant = constant.name.upper()
    told = "\n".join(about).replace("\\", "\\\\").replace('"', "'")
    parts = [
        f'"""{told}\n"""\n\nimport math\n\n# {constant.meaning}',
        f"{name_of_constant} = {constant.value!r}\n",
    ]
    for name, program in programs.items():
        lines = _statements(
            program, constant, name_of_constant, "t{k} = {value}", _python_expression
        )
        lines.append(f"return [{', '.join(_results(program))}]")
        body = "\n".join(f"    {line}" for line in lines)
        parts.append(f"\ndef {name}({', '.join(_inputs(program, constant))}):\n{body}\n")
    return "\n".join(parts)


def identifier(text: str) -> str:
    """Return a name for C made of a text."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return f"_{name}" if not name or name[0].isdigit() else name


def _inputs(program: Program, constant: Constant) -> dict[str, int]:
    return {name: size for name, size in program.inputs if name != constant.name}


def _results(program: Program) -> list[str]:
    """Return the entries of the one output of a program, those that are always zero included."""
    (output,) = program.outputs
    entries = ["0.0"] * output.size
    for value, place in zip(output.values.tolist(), output.places.tolist(), strict=True):
        entries[place] = _name(program, value)
    return entries


def _statements(
    program: Program,
    constant: Constant,
    name_of_constant: str,
    form: str,
    expression: Callable[[str, list[str]], str],
) -> list[str]:
    """Return a statement an operation, in order; constants stand where they are used."""
    lines = []
    for k in range(len(program)):
        operation = NAMES[program.op[k]]
        if operation == "const":
            continue
        if operation == "input":
            name = program.inputs[program.a[k]][0]
            own = name == constant.name
            value = name_of_constant if own else f"{name}[{program.b[k]}]"
        else:
            operands = (program.a[k], program.b[k])[: OPERATIONS[operation]]
            value = expression(operation, [_name(program, int(v)) for v in operands])
        lines.append(form.format(k=k, value=value))
    return lines


def _name(program: Program, k: int) -> str:
    if NAMES[program.op[k]] != "const":
        return f"t{k}"
    value = float(program.constant[k])
    return f"({value!r})" if value < 0.0 else repr(value)


def _python_expression(operation: str, operands: list[str]) -> str:
    if operation in INFIX:
        return scalar_expression(operation, operands)
    if operation in _PYTHON:
        return _PYTHON[operation].format(*operands)
    name = {"fabs": "abs"}.get(operation, f"math.{operation}")
    return f"{name}({', '.join(operands)})"
