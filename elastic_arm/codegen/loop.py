"""Loops written in C around a printed step: recursions over samples and integrators use them."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import TYPE_CHECKING

from elastic_arm.codegen.compiler import build
from elastic_arm.codegen.emit_c import emit_scalar
from elastic_arm.codegen.program import Program, from_casadi

if TYPE_CHECKING:
    import casadi


def build_loop(
    step: casadi.Function | Program, name: str, loop: str, sizes: Mapping[str, int] | None = None
) -> ctypes.CDLL:
    """Compile a loop and its step to one library, in which the compiler inlines the step.

    step: what is evaluated once a pass, for one sample; name: under which `loop` calls it:
    ``name(const double* in, double* out)``, all inputs of `step` one after another, and all
    outputs, dense, matrices row by row; loop: C source, with functions that are not static for the
    caller; sizes: integer constants of `loop`, defined before it.

    Raises a KernelError if there is no compiler, or it refuses the source.
    """
    program = step if isinstance(step, Program) else from_casadi(step)
    defines = [f"#define {constant} {size}" for constant, size in (sizes or {}).items()]
    return build("\n".join([emit_scalar(program, name), *defines, loop]))
