"""Docstrings and documents: parameters described, words of the field, lines that fit."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_architecture import MODULES, PACKAGE, ROOT

FEW = 3  # arguments from which a Parameters section is asked for
FORBIDDEN = re.compile(r"\b(houses?|rooms?(?! for)|doors?|currency)\b", re.IGNORECASE)
# Quantities, laws and recordings give, show or state; only people talk.
TALKING = re.compile(r"\b(says|tells|asks)\b", re.IGNORECASE)
CODE = re.compile(r"`[^`]*`")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*/*.md")])
WIDEST = 120


def public_functions(path: Path) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield the public functions of a module and methods of its public classes, by qualified name."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, node
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            members = (m for m in node.body if isinstance(m, ast.FunctionDef | ast.AsyncFunctionDef))
            yield from ((f"{node.name}.{member.name}", member) for member in members)


def arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    """Return the names of a function's arguments, without self and cls."""
    given = function.args
    names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return [name for name in names if name not in ("self", "cls")]


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is a subcommand, whose options carry their own help."""
    return any("reports_errors" in ast.unparse(decorator) for decorator in function.decorator_list)


def lacking_parameters(path: Path) -> list[str]:
    """Return the public functions of a module with several arguments and no Parameters section."""
    place = path.relative_to(PACKAGE).as_posix()
    return [
        f"{place}:{name}"
        for name, function in public_functions(path)
        if not name.rpartition(".")[2].startswith("_")
        and len(arguments(function)) >= FEW
        and not is_command(function)
        and "Parameters\n" not in (ast.get_docstring(function) or "")
    ]


def test_functions_of_several_arguments_describe_them() -> None:
    """A public function of three and more arguments has a Parameters section; options of a command carry their help."""
    assert not [name for path in MODULES for name in lacking_parameters(path)]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_docstrings_use_the_words_of_the_field(path: Path) -> None:
    """No docstring speaks of houses, rooms, doors or a currency, or lets things talk."""
    tree = ast.parse(path.read_text())
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = [ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, documented)]
    assert not [found.group() for text in texts for found in FORBIDDEN.finditer(CODE.sub("", text))]
    assert not [found.group() for text in texts for found in TALKING.finditer(text)]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_documents_use_the_words_of_the_field(path: Path) -> None:
    """No document speaks of houses, rooms, doors or a currency, or points to what is not in the tree."""
    text = path.read_text()
    assert not [found.group() for found in FORBIDDEN.finditer(CODE.sub("", text))]
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    assert not [link for link in links if not (path.parent / link).resolve().is_relative_to(ROOT.resolve())]
    assert not [link for link in links if not (path.parent / link).exists()]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_lines_of_documents_fit(path: Path) -> None:
    """Lines have at most 120 columns; rows of tables cannot be broken."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("|")]
    assert not [line for line in lines if len(line) > WIDEST]


def test_the_map_of_the_package_names_modules_that_exist() -> None:
    """Every module that docs/architecture.md names is in the tree."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.py)`", text))
    assert len(named) > 20 and not [path for path in named if not ((PACKAGE / path).exists() or (ROOT / path).exists())]
