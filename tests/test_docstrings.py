"""Docstrings and documents: words of the field, lines that fit."""

import ast
import re
from pathlib import Path

import pytest

from tests.test_architecture import MODULES, PACKAGE, ROOT, tree_of

FORBIDDEN = re.compile(r"\b(houses?|rooms?(?!\s+for)|doors?|currency)\b", re.IGNORECASE)
# Quantities, laws and recordings give, show or state; only people talk.
TALKING = re.compile(r"\b(says|tells|asks)\b", re.IGNORECASE)
CODE = re.compile(r"`[^`]*`")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*/*.md")])
WIDEST = 100


def test_docstrings_use_the_words_of_the_field() -> None:
    """No docstring speaks of houses, rooms, doors or a currency, or lets things talk."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            text = ast.get_docstring(node) or "" if isinstance(node, documented) else ""
            assert not (found := FORBIDDEN.search(CODE.sub("", text)) or TALKING.search(text)), (
                f"{path}: {found}"
            )


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_documents_use_the_words_of_the_field(path: Path) -> None:
    """No document speaks of houses, rooms, doors or a currency, or points to what is not in the
    tree."""
    text = path.read_text()
    assert not [found.group() for found in FORBIDDEN.finditer(CODE.sub("", text))]
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    assert not [
        link for link in links if not (path.parent / link).resolve().is_relative_to(ROOT.resolve())
    ]
    assert not [link for link in links if not (path.parent / link).exists()]


def test_the_website_leads_to_all_pages() -> None:
    """The navigation of the website names each page in docs, and none that is not there."""
    pages = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert not [page for page in pages if not (ROOT / page).exists()]
    assert {str(path.relative_to(ROOT)) for path in ROOT.glob("docs/*.md")} <= set(pages)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_lines_of_documents_fit(path: Path) -> None:
    """Lines have at most 100 columns; rows of tables cannot be broken."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("|")]
    assert not [line for line in lines if len(line) > WIDEST]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_command_begins_its_line(path: Path) -> None:
    """The shell commands of the documents can be copied: none stands behind another one or in its
    comment."""
    blocks = re.findall(r"^```sh\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)
    lines = [line.replace("elastic_arm elastic-arm", "") for line in "\n".join(blocks).splitlines()]
    assert not [line for line in lines if re.search(r"\S +elastic-arm [a-z-]", line)]


def test_the_map_of_the_package_names_modules_that_exist() -> None:
    """Every module that docs/architecture.md names is in the tree."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.py)`", text))
    assert len(named) > 20 and not [
        path for path in named if not ((PACKAGE / path).exists() or (ROOT / path).exists())
    ]
