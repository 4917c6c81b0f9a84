"""The application with all commands; a subcommand is imported only when it runs.

Usage errors have the form of all other errors: one line with problem and remedy, and exit status 2.
"""

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple, cast

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from elastic_arm.cli.console import print_error
from elastic_arm.errors import ElasticArmError, OutputError
from elastic_arm.version import __version__


class SeveralValues(TyperCommand):
    """A command whose repeatable options take every value up to the next option: `--validate A B`.

    They do so once an argument has come before them: in `--validate A B` alone, B is the argument.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Write every further value with its option before it, as the parser expects."""
        return super().parse_args(ctx, spelled_out(args, self.params))


def spelled_out(args: Sequence[str], params: Sequence[object]) -> list[str]:
    """Return the arguments with the option repeated before each of its values."""
    options = {name: p for p in params if isinstance(p, TyperOption) for name in p.opts}
    found: list[str] = []
    current = ""
    wanted = 0
    argued = False
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
            current = ""
            argued = True
        found.append(token)
    return found


class Subcommand(NamedTuple):
    """Where a subcommand is defined, and its line in the help of the application.

    `attribute` is a function or a `typer.Typer`; `summary` its first sentence, known before its
    module is imported.
    """

    module: str
    attribute: str
    summary: str
    kind: type[TyperCommand] = TyperCommand


SUBCOMMANDS = {
    "describe": Subcommand(
        "cli.describe",
        "describe",
        "Show an arm: joints, limits, masses, transmissions and identifiable parameters.",
    ),
    "excite": Subcommand(
        "cli.excite",
        "excite",
        "Find a Fourier trajectory within all limits that determines the arm's parameters best.",
    ),
    "simulate": Subcommand(
        "cli.simulate",
        "simulate",
        "Simulate an arm that follows a trajectory, and record it as a bag.",
    ),
    "bag": Subcommand(
        "cli.bag", "bag_app", "Inspect, check, repair, import and export recordings."
    ),
    "identify": Subcommand(
        "cli.identify", "identify", "Identify an arm's parameters from recordings."
    ),
    "diagnose": Subcommand(
        "cli.diagnose",
        "diagnose_command",
        "Find where a recording and a model differ, which effect the model lacks, and by how"
        " much the gap shrinks with it.",
        SeveralValues,
    ),
    "history": Subcommand(
        "cli.history",
        "history_command",
        "Track the parameters of one arm over several recordings, with time, size and"
        " probability of changes.",
    ),
    "export": Subcommand(
        "cli.mujoco.export",
        "export",
        "Write an arm, such as a diagnosis' robot.yaml, as MJCF, URDF or USD, or its torque as a"
        " function in C, Python or CasADi, and list the changes and the omissions.",
    ),
    "replay": Subcommand(
        "cli.mujoco.replay",
        "replay_command",
        "Replay a recording in MuJoCo, and measure the error of each model.",
    ),
    "challenge": Subcommand(
        "studies.blind_challenge.command",
        "challenge_app",
        "Test the diagnosis on simulated arms with effects unknown to it.",
    ),
    "paper": Subcommand(
        "studies.paper.command",
        "paper",
        "Reproduce the paper: compare mod1, mod2 and mod3 with a virtual prototype over five"
        " gear ratios.",
    ),
}


# What the command says without arguments.
WAYS_IN = """\
Robot arms with elastic joints: find where a model and a real arm differ, and why.

  simulate  an arm with an effect that its model lacks, and record a bag
      elastic-arm simulate --effect coulomb_friction:joint_2:torque=13.9 --out run_1

  identify  the parameters of an arm from recordings, with standard deviations
      elastic-arm identify run_1 --with coulomb_friction --out identified

  diagnose  which effect the model lacks, and by how much the gap shrinks with it
      elastic-arm diagnose run_1 --out diagnosis
      of your own arm, first import its table:
      elastic-arm bag import run.csv --guess --robot arm.urdf --out import.yaml

  live      the same in a running ROS 2 graph (docs/ros.md)
      ros2 launch elastic_arm identify.launch.py
      without ros2:
      simulator & identifier & trajectory_generator --ros-args -p trajectory:=config/excitation.yaml

`--help` lists all commands; behind the name of a command, it lists its options."""


def load(name: str) -> Any:
    """Import a subcommand and return it as a command of typer's."""
    found = SUBCOMMANDS[name]
    defined = getattr(import_module(f"elastic_arm.{found.module}"), found.attribute)
    holder = typer.Typer(rich_markup_mode="rich")
    if isinstance(defined, typer.Typer):
        holder.add_typer(defined, name=name)
    else:
        holder.command(name, cls=found.kind)(defined)
    return typer.main.get_group(holder).commands[name]


class Application(TyperGroup):
    """The application.

    It knows no more than name and summary of its subcommands until one is called.
    """

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command and end with its exit status.

        A command words its own errors.
        """
        try:
            status = super().main(args, *rest, **{**extra, "standalone_mode": False})
            sys.stdout.flush()
        except BrokenPipeError:
            # Whoever reads has gone, as `head` does; what Python writes at its end must not fail
            # for that again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(128 + signal.SIGPIPE) from None
        except OutputError as error:
            print_error(error)
            raise SystemExit(2) from None
        except typer.TyperException as error:
            words = (
                " ".join(error.format_message().split())
                .removesuffix(".")
                .replace("Value error, ", "")
            )
            if words:  # none where the help has been shown instead
                command = self._named(sys.argv[1:] if args is None else args)
                print_error(
                    ElasticArmError(f"{words[:1].lower()}{words[1:]}", f"See {command} --help")
                )
            raise SystemExit(error.exit_code) from None
        raise SystemExit(status)

    def _named(self, args: Sequence[str]) -> str:
        """Return the command that arguments begin with, as its user writes it."""
        path = [str(self.name)]
        command = cast(Any, self)
        for word in args:
            command = getattr(command, "commands", {}).get(word)
            if command is None:
                break
            path.append(word)
        return " ".join(path)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Put the subcommand that is called in its placeholder's place."""
        if args and args[0] in SUBCOMMANDS:
            self.commands[args[0]] = load(args[0])
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="elastic-arm",
    cls=Application,
    help=(
        "Emulate an arm with elastic joints, identify it, and find where and why a model and"
        " a real arm differ."
    ),
    invoke_without_command=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def _placeholder() -> None:
    """Stand for a subcommand that is not imported yet."""


for _name, _subcommand in SUBCOMMANDS.items():
    app.command(_name, help=_subcommand.summary)(_placeholder)


def _version(value: bool) -> None:
    if value:
        typer.echo(f"elastic-arm {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    ctx: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Options of the application itself."""
    if ctx.invoked_subcommand is None:
        typer.echo(WAYS_IN)
        raise typer.Exit(2)
