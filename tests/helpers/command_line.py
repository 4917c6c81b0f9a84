"""Commands of `elastic-arm`, run in this process."""

from typer.testing import CliRunner, Result

from elastic_arm.app import app


def run(*arguments: object) -> Result:
    """Run `elastic-arm …`."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def refusal(*arguments: object) -> str:
    """Return the one line that a refused command writes."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert "Errno" not in line
    return line
