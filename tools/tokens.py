"""Count the size of the code in tokens, and how dense its statements are.

    python tools/tokens.py [REVISION]

A token is a name, an operator or a number: layout, comments and texts cost nothing, and a line that
holds two statements gains nothing. The last three columns are counts over 1,000 lines. Without a
revision the files of the working tree are counted.
"""

import ast
import subprocess
import sys
import tokenize
from collections import defaultdict
from io import StringIO
from pathlib import Path

COUNTED = (tokenize.NAME, tokenize.OP, tokenize.NUMBER)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
COLUMNS = ("tokens", "lines", "tuple assignments", "comprehensions", "conditional expressions")
APART = ("tests", "benchmarks")


def counts(source: str) -> list[int]:
    """Return what COLUMNS name, of one file."""
    tokens = tokenize.generate_tokens(StringIO(source).readline)
    nodes = list(ast.walk(ast.parse(source)))
    targets = [target for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
    return [
        sum(token.type in COUNTED for token in tokens),
        len(source.splitlines()),
        sum(isinstance(target, ast.Tuple) for target in targets),
        sum(isinstance(node, COMPREHENSIONS) for node in nodes),
        sum(isinstance(node, ast.IfExp) for node in nodes),
    ]


def sources(revision: str | None) -> dict[str, str]:
    """Return the Python files that git knows, by path."""
    listing = ["ls-files"] if revision is None else ["ls-tree", "-r", "--name-only", revision]
    paths = [path for path in _git(*listing).splitlines() if path.endswith(".py")]
    if revision is None:
        return {path: Path(path).read_text() for path in paths if Path(path).exists()}
    return {path: _git("show", f"{revision}:{path}") for path in paths}


def package_of(path: str) -> str | None:
    """Return the row that a file belongs to: None for launch files, tools and layouts."""
    first, *rest = path.split("/")
    if first in APART:
        return first
    if first != "elastic_arm":
        return None
    return rest[0] if len(rest) > 1 else "modules of their own"


def main(revision: str | None = None) -> None:
    """Print a row for each package, its sum, and tests and benchmarks apart."""
    rows: dict[str, list[int]] = defaultdict(lambda: [0] * len(COLUMNS))
    for path, source in sources(revision).items():
        package = package_of(path)
        if package is None:
            continue
        one = counts(source)
        for row in (package, *(() if package in APART else ("elastic_arm",))):
            rows[row] = [a + b for a, b in zip(rows[row], one, strict=True)]
    packages = sorted(set(rows) - {"elastic_arm", *APART})
    print("| package | " + " | ".join(COLUMNS) + " |")
    print("|---|" + "---|" * len(COLUMNS))
    for package in (*packages, "elastic_arm", *APART):
        tokens, lines, *constructs = rows[package]
        dense = [f"{1000 * count / lines:.0f}" for count in constructs]
        print(f"| {package} | " + " | ".join([f"{tokens:,}", f"{lines:,}", *dense]) + " |")


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"git {' '.join(arguments)} failed. {done.stderr.strip()}")
    return done.stdout


if __name__ == "__main__":
    main(*sys.argv[1:])
