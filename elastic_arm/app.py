"""The `elastic-arm` application: gathers the subcommands, and imports one when it runs."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand

from elastic_arm import __version__
from elastic_arm.blas import one_blas_thread
from elastic_arm.cli.several_values import SeveralValues
from elastic_arm.cli.usage import Application


class Subcommand(NamedTuple):
    """Where a subcommand is defined, and its line in the help of the application.

    Parameters
    ----------
    module, attribute
        A function, or a `typer.Typer` with subcommands of its own.
    summary
        The first sentence of its docstring, known before its module is imported.
    kind
        Class of the command.
    """

    module: str
    attribute: str
    summary: str
    kind: type[TyperCommand] = TyperCommand


SUBCOMMANDS = {
    "describe": Subcommand(
        "cli.describe",
        "describe",
        "Show an arm: joints, limits, masses, transmissions, and what a model of it has to identify.",
    ),
    "excite": Subcommand(
        "cli.excite",
        "excite",
        "Find a Fourier trajectory whose motion separates the arm's parameters best, within all limits.",
    ),
    "simulate": Subcommand(
        "cli.simulate", "simulate", "Let a simulated arm follow a trajectory, and record it as a bag."
    ),
    "bag": Subcommand("cli.bag", "bag_app", "Look into, check, mend and make recordings."),
    "identify": Subcommand("cli.identify", "identify", "Identify an arm's parameters from recordings."),
    "diagnose": Subcommand(
        "cli.diagnose",
        "diagnose_command",
        "Find where a recording and a model differ, which effect the model lacks, and how far the gap shrinks with it.",
        SeveralValues,
    ),
    "export": Subcommand(
        "cli.mujoco.export",
        "export",
        "Write an arm, such as the robot.yaml of a diagnosis, as MJCF or URDF, and list what changes and what is left.",
    ),
    "replay": Subcommand(
        "cli.mujoco.replay",
        "replay_command",
        "Replay a recording in MuJoCo, and measure how far each model is from it.",
    ),
    "challenge": Subcommand(
        "studies.blind_challenge.command",
        "challenge_app",
        "Check the diagnosis on arms whose effect is withheld from it.",
    ),
    "paper": Subcommand(
        "studies.paper.command",
        "paper",
        "Reproduce the paper: mod1, mod2, mod3 against a virtual prototype, over the ratios, down to the parameters.",
    ),
    "demo": Subcommand(
        "cli.demo",
        "demo",
        "Move an arm in a live ROS 2 graph, record it, and identify it: live, and again from the bag.",
    ),
}


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


class LazyApplication(Application):
    """The application, which knows of its subcommands no more than name and summary until one is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Put the subcommand that is called in its placeholder's place."""
        if args and args[0] in SUBCOMMANDS:
            self.commands[args[0]] = load(args[0])
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="elastic-arm",
    cls=LazyApplication,
    help="Emulate an elastic-joint arm, identify it, and find where and why a model and a real arm differ.",
    no_args_is_help=True,
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
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Options of the application itself."""


def main() -> None:
    """Entry point."""
    one_blas_thread(os.environ)
    app()
