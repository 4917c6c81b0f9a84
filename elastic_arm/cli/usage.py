"""Usage errors as every other error: one line with problem and remedy, and exit status 2."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import Any, cast

import typer
from typer.core import TyperGroup

from elastic_arm.cli.console import print_error
from elastic_arm.errors import ElasticArmError


class Application(TyperGroup):
    """The commands as one application, whose usage errors are one line."""

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command and end with its exit status."""
        try:
            status = super().main(args, *rest, **{**extra, "standalone_mode": False})
            sys.stdout.flush()
        except BrokenPipeError:
            # Whoever reads has gone, as `head` does; what Python writes at its end must not fail for that again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(128 + signal.SIGPIPE) from None
        except typer.TyperException as error:
            words = " ".join(error.format_message().split()).removesuffix(".").replace("Value error, ", "")
            if words:  # none where the help has been shown instead
                command = self._named(sys.argv[1:] if args is None else args)
                print_error(ElasticArmError(f"{words[:1].lower()}{words[1:]}", f"See {command} --help"))
            raise SystemExit(error.exit_code) from None
        raise SystemExit(status)

    def _named(self, args: Sequence[str]) -> str:
        """Return the command that arguments begin with, as its user writes it."""
        path, command = [str(self.name)], cast(Any, self)
        for word in args:
            command = getattr(command, "commands", {}).get(word)
            if command is None:
                break
            path.append(word)
        return " ".join(path)
