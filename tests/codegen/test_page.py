"""The page on codegen, and that the package stands by itself."""

import re
from typing import Any

import numpy as np
import pytest

from tests.test_architecture import PACKAGE, ROOT, imports_of

PAGE = ROOT / "docs" / "codegen.md"
FOLDER = PACKAGE / "codegen"


def test_the_example_of_the_page_runs() -> None:
    """What docs/codegen.md shows runs as it stands, and gives the torque and the derivatives of a
    pendulum."""
    (example,) = re.findall(
        r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    made: dict[str, Any] = {}
    exec(compile(example, str(PAGE), "exec"), made)
    q, ddq = made["samples"].T
    np.testing.assert_allclose(
        made["tau"][:, 0], 0.5 * ddq + 9.81 * np.sin(q), rtol=1e-12, atol=1e-12
    )
    by_mass = 0.25 * ddq + 0.5 * 9.81 * np.sin(q)
    np.testing.assert_allclose(made["J"][:, 0, 0], by_mass, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_codegen_imports_nothing_of_the_package_but_errors_and_the_array(path: Any) -> None:
    """The package can be taken out and used by itself, with two small modules."""
    own = [name for _, name in imports_of(path) if name.startswith("elastic_arm.")]
    allowed = ("elastic_arm.codegen", "elastic_arm.errors", "elastic_arm.arrays")
    assert all(f"{name}.".startswith(tuple(f"{one}." for one in allowed)) for name in own), own


def test_the_page_names_what_is_there() -> None:
    """Modules and functions that the page names exist."""
    text = PAGE.read_text(encoding="utf-8")
    for module, name in re.findall(r"`(\w+)\.(\w+)[`(]", text):
        if (FOLDER / f"{module}.py").exists():
            assert re.search(
                rf"\b(def|class) {name}\b", (FOLDER / f"{module}.py").read_text(encoding="utf-8")
            ), name
