"""Effects of a user's own files and of installed packages, and that nothing but its file knows of
an effect."""

import ast
from pathlib import Path

import pytest

import elastic_arm
from elastic_arm.effects import (
    EFFECTS,
    Catalogue,
    Choice,
    Effect,
    Parameter,
    Role,
    Scale,
    parse,
    robot_effects,
)
from elastic_arm.effects import catalogue as catalogue_module
from elastic_arm.effects.effect import REGIMES
from elastic_arm.errors import EffectError
from elastic_arm.robot import load_robot

PACKAGE = Path(elastic_arm.__file__).parent
OWN = """
from elastic_arm.effects import Effect, Parameter

EFFECT = Effect(
    id="{id}", formula="A q", description="d.", signature="s.", sides=("link",), regime="position",
    law=lambda motion, i, p: motion.at(i, link=p["pull"] * motion.q[i]),
    parameters=(Parameter("pull", "Nm/rad", 0.0, 10.0, neutral=0.0),),
)
"""


def effect(**changes):
    """An effect with one parameter, changed."""
    entries = {
        "id": "pull",
        "formula": "A q",
        "description": "d.",
        "signature": "s.",
        "law": lambda motion, i, p: motion.nothing(),
        "parameters": (Parameter("size", "Nm", 0.0, 1.0, neutral=0.0),),
        "sides": ("link",),
    }
    return Effect(**(entries | changes))


def test_no_module_but_an_effects_own_file_names_it() -> None:
    """Outside the library no module holds an effect's id as a string.

    Left out are the challenge, which draws and makes its arms apart from the library, and the
    readers and writers of URDF and MJCF, whose own terms for friction, damping and springs have to
    be given an id somewhere.
    """
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE).as_posix()
        if place.startswith(
            (
                "effects/library/",
                "studies/blind_challenge/",
                "robot/urdf.py",
                "robot/mjcf/",
                "mujoco/",
            )
        ):
            continue
        held = {
            node.value
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant)
        }
        assert not {value for value in held if isinstance(value, str)} & (
            set(EFFECTS) - set(REGIMES) - {"torque_constant"}  # a key of channel maps, too
        ), place


def test_a_users_file_is_in_the_catalogue_and_an_arm_file_may_name_it(tmp_path: Path) -> None:
    """The effect is read from text and from an arm's description; the default catalogue stays as it
    was."""
    path = tmp_path / "pull.py"
    path.write_text(OWN.format(id="magnet"))
    catalogue = Catalogue.default().with_files([path])
    arm = load_robot(None)
    instance = parse("magnet:joint_2:pull=3", arm, catalogue)
    carrying = arm.with_(effects=(instance.to_dict(),))
    assert robot_effects(carrying, catalogue) == (instance,)
    assert "magnet" not in Catalogue.default()
    with pytest.raises(EffectError, match="unknown effect 'magnet'"):
        robot_effects(carrying)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "contains no EFFECT"),
        ("EFFECT = 3", "not an Effect"),
        ("x = (\n", r"line 1: .*never closed"),
        ("\nimport nowhere_at_all", "line 2: ModuleNotFoundError"),
        (OWN.format(id="payload"), "'payload' belongs to another"),
        (
            OWN.format(id="magnet").replace("0.0, 10.0", "10.0, 0.0"),
            r"line \d+: parameter pull: its range is 10 to 0",
        ),
        (
            OWN.format(id="magnet").replace('p["pull"]', 'p["push"]'),
            r"line \d+: KeyError: 'push'.*p contains pull",
        ),
        (
            OWN.format(id="magnet").replace("link=", "lnk="),
            r"line \d+: a law adds a torque to 'lnk'.*link, drive, motor",
        ),
        (
            OWN.format(id="magnet").replace("motion.at(i, link=", "("),
            "law of magnet does not return a Contribution",
        ),
        (None, "no such file"),
    ],
    ids=[
        "nothing",
        "no effect",
        "syntax",
        "import",
        "taken",
        "range",
        "parameter",
        "side",
        "contribution",
        "missing",
    ],
)
def test_a_wrong_file_gets_one_clear_line(tmp_path: Path, text: str | None, message: str) -> None:
    """The error names the file, the line where there is one, and what to do."""
    path = tmp_path / "own.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(EffectError, match=message) as caught:
        Catalogue.default().with_files([path])
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and caught.value.remedy


def test_an_installed_package_adds_its_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """An entry point of the group is in the default catalogue; one that cannot be loaded is
    named."""
    found = [catalogue_module.EntryPoint("friction", "nowhere:EFFECT", catalogue_module.GROUP)]
    monkeypatch.setattr(catalogue_module, "entry_points", lambda group: found)
    monkeypatch.setattr(catalogue_module.EntryPoint, "load", lambda self: effect())
    catalogue_module._default.cache_clear()
    assert "pull" in Catalogue.default()
    monkeypatch.undo()
    monkeypatch.setattr(catalogue_module, "entry_points", lambda group: found)
    catalogue_module._default.cache_clear()
    with pytest.raises(EffectError, match="friction = nowhere:EFFECT"):
        Catalogue.default()
    monkeypatch.undo()
    catalogue_module._default.cache_clear()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"id": "not a valid id"}, "is not a valid id"),
        ({"formula": ""}, "formula is empty"),
        ({"sides": ("axle",)}, "sides contains 'axle'"),
        ({"sides": ()}, "in no equation"),
        ({"regime": "sometimes"}, "regime contains 'sometimes'"),
        ({"lacked_by": ("mod4",)}, "lacked_by contains 'mod4'"),
        ({"magnitude": ("weight",)}, "magnitude contains 'weight'"),
        ({"states": ("size",)}, "two meanings"),
        ({"choices": (Choice("size", ("a", "b"), "a"),)}, "two meanings"),
        (
            {"parameters": (Parameter("phase", "rad", -3.0, 3.0, role=Role.PHASE),)},
            "needs exactly one amplitude",
        ),
    ],
    ids=lambda value: None if isinstance(value, dict) else value,
)
def test_an_effect_that_contradicts_itself_is_refused(changes: dict, message: str) -> None:
    """What is wrong is named when the effect is made, not when it is used."""
    with pytest.raises(EffectError, match=message):
        effect(**changes)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"low": 1.0, "high": 1.0}, "range is 1 to 1"),
        ({"low": -1.0, "scale": Scale.LOG}, "logarithmic"),
        ({"integer": True}, "can only be searched"),
        ({"neutral": None}, "no value of no effect"),
        ({"above": 2.0}, "must be above 2"),
        ({"name": "a b"}, "is named 'a b'"),
        ({"default": "much"}, "is 'much'"),
        ({"draw": (1.0, 0.5)}, "draw is 1 to 0.5"),
    ],
    ids=lambda value: None if isinstance(value, dict) else value,
)
def test_a_parameter_that_contradicts_itself_is_refused(entries: dict, message: str) -> None:
    """What is wrong is named when the parameter is made."""
    with pytest.raises(EffectError, match=message):
        Parameter(
            **({"name": "size", "unit": "Nm", "low": 0.0, "high": 1.0, "neutral": 0.0} | entries)
        )
