"""Catalogues of effects by id: those of the library, of installed packages, and of a user's own
files."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import pkgutil
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca

from elastic_arm.effects import library
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Effect, EffectInstance
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.motion import SymbolicMotion
from elastic_arm.errors import EffectError
from elastic_arm.input_files import read_text
from elastic_arm.robot import Robot, load_robot

GROUP = "elastic_arm.effects"  # entry points of installed packages: NAME = "module:EFFECT"
# What executing a file may raise; EffectError is a ValueError, CasADi raises RuntimeError and
# NotImplementedError.
_RAISED: tuple[type[Exception], ...] = (
    ImportError,
    NameError,
    AttributeError,
    TypeError,
    ValueError,
    LookupError,
)
_RAISED += (ArithmeticError, RuntimeError, AssertionError, OSError)
_SHOWN = 60  # characters of a name that is too long
_EXAMPLE = "docs/adding_an_effect.md shows one."


class Catalogue(Mapping[str, Effect]):
    """Effects by id, in the order in which they are listed; never changed.

    Raises an EffectError if two have one id.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects: dict[str, Effect] = {}
        for effect in effects:
            if effect.id in self._effects:
                raise EffectError(
                    f"the id {effect.id!r} belongs to another effect",
                    "Give each effect a unique id.",
                )
            self._effects[effect.id] = effect

    def __getitem__(self, effect_id: str) -> Effect:
        return self._effects[effect_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)

    @staticmethod
    def default() -> Catalogue:
        """Return the effects of the library and of packages (entry points of :data:`GROUP`)."""
        return _default()

    def with_files(self, paths: Sequence[str | Path]) -> Catalogue:
        """Return the catalogue with the effects of Python files added.

        A file holds one effect as `EFFECT`, or several as a list `EFFECTS`.
        """
        found = self
        for path in paths:
            try:
                found = Catalogue([*found.values(), *_of_file(Path(path))])
            except EffectError as error:
                named = error.problem.startswith(str(path))
                raise EffectError(
                    error.problem if named else f"{path}: {error.problem}", error.remedy
                ) from error.__cause__
        return found

    def withholding(self, effect_id: str) -> Catalogue:
        """Return the catalogue with an effect that no diagnosis names.

        What every arm has of it stays ordinary.
        """
        return Catalogue(
            [replace(e, searched=False) if e.id == effect_id else e for e in self.values()]
        )

    def find(self, effect_id: str) -> Effect:
        """Return an effect by id.

        An EffectError, with the ids that come close, where there is none.
        """
        if effect_id in self:
            return self[effect_id]
        close = difflib.get_close_matches(effect_id, self, n=3, cutoff=0.5)
        hint = f"Did you mean {' or '.join(close)}? " if close else ""
        asked = effect_id if len(effect_id) <= _SHOWN else f"{effect_id[:_SHOWN]}…"
        raise EffectError(
            f"unknown effect {asked!r}",
            f"{hint}The effects are {', '.join(self)}; --effects FILE adds more.",
        )


def discover() -> Catalogue:
    """Return the `EFFECT` or the `EFFECTS` of every module of the library that has one."""
    modules = sorted(m.name for m in pkgutil.iter_modules(library.__path__))
    return Catalogue(
        [e for m in modules for e in _held(importlib.import_module(f"{library.__name__}.{m}"))]
    )


def _held(module: ModuleType) -> list[Any]:
    return [
        *getattr(module, "EFFECTS", ()),
        *([module.EFFECT] if hasattr(module, "EFFECT") else []),
    ]


@lru_cache(maxsize=1)
def _default() -> Catalogue:
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    return Catalogue([*EFFECTS.values(), *(_of_entry_point(point) for point in points)])


def _of_entry_point(point: EntryPoint) -> Effect:
    remedy = (
        f"Uninstall the package {point.dist.name if point.dist else point.value}, or correct it."
    )
    try:
        effect = point.load()
    except (ImportError, AttributeError, SyntaxError, EffectError) as error:
        raise EffectError(f"entry point {point.name} = {point.value}: {error}", remedy) from error
    if not isinstance(effect, Effect):
        raise EffectError(f"entry point {point.name} = {point.value} is not an Effect", remedy)
    return effect


def _of_file(path: Path) -> list[Effect]:
    """Execute a file and return its effects."""
    source = read_text(path, EffectError, "Give a Python file that contains an effect.")
    spec = importlib.util.spec_from_loader(
        f"elastic_arm_user_effects_{path.stem}", loader=None, origin=str(path)
    )
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    try:
        exec(compile(source, str(path), "exec"), vars(module))
    except SyntaxError as error:
        raise EffectError(
            f"{path}: line {error.lineno}: {error.msg}", "Correct the Python of the file."
        ) from error
    except _RAISED as error:
        raise _located(path, error, f"Correct the file; {_EXAMPLE}") from error
    held = _held(module)
    if not held or not all(isinstance(effect, Effect) for effect in held):
        what = "EFFECT is not an Effect" if held else "contains no EFFECT"
        raise EffectError(f"{path}: {what}", f"Write EFFECT = Effect(id=…, …); {_EXAMPLE}")
    for effect in held:
        try:
            _tried(effect)
        except _RAISED as error:
            values = (
                ", ".join((*effect.names, *effect.states)) or "nothing: the effect has no parameter"
            )
            raise _located(
                path, error, f"Correct the law of {effect.id}; p contains {values}."
            ) from error
    return held


def _tried(effect: Effect) -> None:
    """Write a law over the symbols of the nominal arm, with exact signs of velocities, before an
    arm needs it."""
    robot = load_robot(None)
    equations = ArmEquations(robot, effect.lacked_by[-1])
    n = robot.n
    dof = equations.dof
    x = ca.SX.sym("x", dof)
    dx = ca.SX.sym("dx", dof)
    ddx = ca.SX.sym("ddx", dof)
    tau_J = ca.SX.sym("tau_J", n)
    tau_m = ca.SX.sym("tau_m", n)
    dtau_J = ca.SX.sym("dtau_J", n)
    dtau_m = ca.SX.sym("dtau_m", n)
    speeds = {"link": dx[:n], "motor": dx[dof - n :]}
    sign = lambda side, i: ca.sign(speeds[side][i])  # noqa: E731
    motion = SymbolicMotion(equations, x, dx, ddx, tau_J, tau_m, dtau_J, dtau_m, sign)
    EffectSet([next(effect.candidates(robot))], robot, duration=1.0).contribution(motion)


def _located(path: Path, error: Exception, remedy: str) -> EffectError:
    """Return an error with the last line of a file that it passed through, and its own remedy where
    it has one."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    place = f"{path}: line {lines[-1]}" if lines else str(path)
    if isinstance(error, EffectError):
        return EffectError(f"{place}: {error.problem}", error.remedy or remedy)
    return EffectError(f"{place}: {type(error).__name__}: {error}", remedy)


EFFECTS = discover()


def from_dict(
    entry: Mapping[str, Any], robot: Robot | None = None, catalogue: Catalogue | None = None
) -> EffectInstance:
    """Read an effect as an arm file holds it.

    `{"effect": id, "joint": name or None, "parameters": {…}}`

    The joint is checked where there is a robot. Raises an EffectError if it is no such entry, or
    makes no sense.
    """
    extra = set(entry) - {"effect", "joint", "parameters"}
    if "effect" not in entry or extra:
        raise EffectError(
            f"cannot read the effect {dict(entry)!r}", "Give only effect, joint and parameters."
        )
    effect = (catalogue or Catalogue.default()).find(entry["effect"])
    instance = EffectInstance(effect, entry.get("joint"), entry.get("parameters") or {})
    if robot is not None:
        instance.joint_indices(robot)
    return instance


def robot_effects(robot: Robot, catalogue: Catalogue | None = None) -> tuple[EffectInstance, ...]:
    """Return the effects that the robot's own description carries."""
    return tuple(from_dict(entry, robot, catalogue) for entry in robot.effects)
