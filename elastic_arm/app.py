"""The `elastic-arm` application: gathers the subcommands."""

from __future__ import annotations

import typer

from elastic_arm import __version__
from elastic_arm.cli.bag import bag_app
from elastic_arm.cli.demo import demo
from elastic_arm.cli.describe import describe
from elastic_arm.cli.diagnose import diagnose_command
from elastic_arm.cli.excite import excite
from elastic_arm.cli.identify import identify
from elastic_arm.cli.several_values import SeveralValues
from elastic_arm.cli.simulate import simulate
from elastic_arm.cli.usage import Application
from elastic_arm.studies.blind_challenge.command import challenge_app
from elastic_arm.studies.paper.command import paper

app = typer.Typer(
    name="elastic-arm",
    cls=Application,
    help="Emulate an elastic-joint arm, identify it, and say where and why a model and a real arm differ.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
app.command()(describe)
app.command()(excite)
app.command()(simulate)
app.add_typer(bag_app)
app.command()(identify)
app.command("diagnose", cls=SeveralValues)(diagnose_command)
app.add_typer(challenge_app)
app.command()(paper)
app.command()(demo)


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
    app()
