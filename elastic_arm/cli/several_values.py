"""Options that take several values in a row: `--validate A B` besides `--validate A --validate B`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from typer.core import TyperCommand, TyperOption


class SeveralValues(TyperCommand):
    """A command whose repeatable options take every value up to the next option.

    They do so once an argument has come before them: in `--validate A B` alone, B is the argument.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Write every further value with its option before it, as the parser expects."""
        return super().parse_args(ctx, spelled_out(args, self.params))


def spelled_out(args: Sequence[str], params: Sequence[object]) -> list[str]:
    """Return the arguments with the option repeated before each of its values."""
    options = {name: p for p in params if isinstance(p, TyperOption) for name in p.opts}
    found: list[str] = []
    current, wanted, argued = "", 0, False
    for position, token in enumerate(args):
        if token == "--":
            return [*found, *args[position:]]
        if token.startswith("-"):
            option = options.get(token)
            current = token if option is not None and option.multiple else ""
            wanted = 1 if option is not None and not option.is_flag else 0
        elif wanted:
            wanted = 0
        elif current and argued:
            found.append(current)
        else:
            current, argued = "", True
        found.append(token)
    return found
