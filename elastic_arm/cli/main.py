"""The `elastic-arm` application: gathers the subcommands."""

from __future__ import annotations

import typer

from elastic_arm import __version__

app = typer.Typer(
    name="elastic-arm",
    help="Emulate an elastic-joint arm, identify it, and say where and why a model and a real arm differ.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


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
