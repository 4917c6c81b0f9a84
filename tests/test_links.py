"""The pages of the documentation link to files and sections that exist."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LISTED = subprocess.run(
    ["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False
).stdout.split()
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)]+))?\)")


def sections(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub and MkDocs form them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        found.add(re.sub(r"[^\w\- ]", "", words).replace(" ", "-"))
    return found


@pytest.mark.parametrize("name", LISTED)
def test_links_lead_to_files_and_sections_that_exist(name: str) -> None:
    """Links to other sites are not followed."""
    page = ROOT / name
    for file, section in LINK.findall(page.read_text()):
        if file.startswith(("http:", "https:", "mailto:")):
            continue
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), file
        if section and target.suffix == ".md":
            assert section in sections(target), f"{file}#{section}"
