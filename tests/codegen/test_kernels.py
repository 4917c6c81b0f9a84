"""Kernels: C and numpy give the same numbers, the cache is shared safely, a missing compiler is
survived and said."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from elastic_arm.codegen import kernels
from elastic_arm.codegen.cache import CACHE_VARIABLE
from elastic_arm.dynamics import build_model
from elastic_arm.errors import KernelError
from elastic_arm.robot import load_robot

ENGINES = ("c", "numpy")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path


@pytest.fixture
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, dx, ddx = np.random.default_rng(0).normal(size=(3, 5001, 6))
    return x, dx, ddx


def every_operation() -> ca.Function:
    """A function that uses all that the effects' laws may: branches, signs, hysteresis,
    saturation."""
    x = ca.SX.sym("x", 3)
    p = ca.SX.sym("p", 2)
    a = x[0]
    b = x[1]
    c = x[2]
    parts = [
        ca.sin(a), ca.cos(b), ca.tan(c), ca.exp(a), ca.log(ca.fabs(b) + 1), ca.sqrt(ca.fabs(c)),
        ca.tanh(a * p[0]), ca.sinh(a), ca.cosh(b), ca.atan(c), ca.atan2(a, b), ca.asin(ca.tanh(a)),
        ca.acos(ca.tanh(b)), ca.sign(c), ca.fabs(a), ca.floor(b), ca.ceil(c), ca.fmin(a, b),
        ca.fmax(b, p[1]), ca.fmod(a, 0.7), ca.if_else(a > b, c, -c),
        ca.if_else(ca.logic_and(a > 0, b > 0), 1, 2),
        ca.if_else(ca.logic_or(a > 0, b > 0), c, p[0]), ca.logic_not(a > 0), a**3,
        ca.fabs(a) ** 1.5, a / b, 1 / c, 2 * a, a * a, ca.erf(a), ca.log1p(ca.fabs(a)), ca.expm1(b),
        ca.hypot(a, b), ca.copysign(a, b), ca.asinh(a), p[0] * p[1], p[0] + 1, ca.SX(0), a, a >= b,
        a == a,  # noqa: PLR0124
    ]  # fmt: skip
    return ca.Function(
        "law",
        [x, p],
        [ca.vertcat(*parts), ca.vertcat(a, b) @ ca.horzcat(c, 1, p[0])],
        ["x", "p"],
        ["y", "Y"],
    )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("samples", [1, 7, 9, 4999])
def test_kernels_are_the_function(engine: str, samples: int) -> None:
    """For any number of samples, every operation gives CasADi's own value, shared inputs and
    matrices included."""
    function = every_operation()
    kernel = kernels.compile(function, engine, shared=("p",))
    x = np.random.default_rng(samples).normal(size=(samples, 3))
    p = np.array([0.3, -0.2])
    values, matrices = kernel(x, p)
    assert values.shape == (samples, function.size1_out(0)) and matrices.shape == (samples, 2, 3)
    for k in range(0, samples, max(1, samples // 20)):
        expected, matrix = (np.array(v) for v in function(x[k], p))
        np.testing.assert_allclose(values[k], expected[:, 0], rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(matrices[k], matrix, rtol=1e-13)


def test_engines_agree_on_the_models(states: tuple[np.ndarray, ...]) -> None:
    """C and numpy differ by rounding alone, in every function of a model."""
    compiled, plain = (build_model(load_robot(), "mod3", engine=engine) for engine in ENGINES)
    x, dx, ddx = states
    for name in ("inverse_dynamics", "regressor"):
        expected = getattr(plain, name)(x, dx, ddx)
        np.testing.assert_allclose(
            getattr(compiled, name)(x, dx, ddx),
            expected,
            rtol=0,
            atol=1e-13 * np.abs(expected).max(),
        )
    for name, expected in plain.terms(x, dx).items():
        found = compiled.terms(x, dx)[name]
        np.testing.assert_allclose(
            found, expected, rtol=0, atol=1e-12 * max(np.abs(expected).max(), 1.0)
        )


@pytest.mark.parametrize("engine", ENGINES)
def test_chosen_columns_are_those_of_the_whole_regressor(
    engine: str, states: tuple[np.ndarray, ...]
) -> None:
    """Columns come in the order asked for, null ones included."""
    model = build_model(load_robot(), "mod3", engine=engine)
    columns = np.random.default_rng(1).permutation(len(model.Psi))[:31]
    np.testing.assert_allclose(
        model.regressor(*states, columns),
        model.regressor(*states)[:, :, columns],
        rtol=0,
        atol=1e-11,
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_a_bad_sample_spoils_no_other(engine: str, states: tuple[np.ndarray, ...]) -> None:
    """NaN in one sample stays in that sample, also among the eight that are computed together."""
    x, dx, ddx = (v[:20].copy() for v in states)
    x[11] = np.nan
    forces = build_model(load_robot(), engine=engine).inverse_dynamics(x, dx, ddx)
    assert np.isnan(forces[11]).all() and np.isfinite(np.delete(forces, 11, axis=0)).all()


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (((5, 6), (5, 6)), "2 arrays given"),
        (((5, 6), (5, 7), (5, 6)), "dx has shape"),
        (((5, 6), (4, 6), (5, 6)), "dx has 4"),
    ],
)
def test_wrong_shapes_are_refused_by_name(
    shapes: tuple[tuple[int, int], ...], message: str
) -> None:
    """The error names the input and both shapes."""
    kernel = build_model(load_robot(), engine="numpy").kernel("regressor")
    with pytest.raises(ValueError, match=message):
        kernel(*(np.zeros(shape) for shape in shapes))


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).parents[2]
    inherited = {k: v for k, v in os.environ.items() if k != "CC"}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env=inherited | environment,
        capture_output=True,
        text=True,
        check=True,
    )


USE = """
import numpy as np
from elastic_arm.dynamics import build_model
from elastic_arm.robot import load_robot
model = build_model(load_robot())
print(model.inverse_dynamics(*np.ones((3, 2, 6))).sum())
"""


def test_later_use_derives_and_compiles_nothing(cache: Path) -> None:
    """A second process finds derivation and kernel in the cache: it never loads CasADi and calls no
    compiler."""
    first = run_python(USE)
    made = {path.name: path.stat().st_mtime_ns for path in cache.iterdir()}
    second = run_python(USE + "import sys; print('casadi' in sys.modules)")
    assert second.stdout.split() == [first.stdout.strip(), "False"]
    assert {path.name: path.stat().st_mtime_ns for path in cache.iterdir()} == made
    assert sorted(Path(name).suffix for name in made) == [".npz", ".so"]


def test_processes_may_build_the_same_kernel_at_once(cache: Path) -> None:
    """Four processes on an empty cache all get the right numbers, and leave no half-made files."""
    root = Path(__file__).parents[2]
    running = [
        subprocess.Popen([sys.executable, "-c", USE], cwd=root, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    answers = {process.communicate()[0].strip() for process in running}
    assert len(answers) == 1 and answers != {""}
    assert {path.suffix for path in cache.iterdir()} == {".npz", ".so"}


def test_without_a_compiler_numpy_serves_and_says_so_once(
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    states: tuple[np.ndarray, ...],
) -> None:
    """An empty CC means no compiler: one warning, the same numbers; asking for C by name is
    refused."""
    expected = build_model(load_robot()).inverse_dynamics(*states)
    monkeypatch.setenv("CC", "")
    kernels._say_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            found = build_model(load_robot()).inverse_dynamics(*states)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert [record.message for record in caplog.records if "no C compiler" in record.message] != []
    assert len(caplog.records) == 1
    with pytest.raises(KernelError, match="Install gcc or clang"):
        build_model(load_robot(), engine="c").inverse_dynamics(*states)


def test_a_compiler_that_fails_is_named_with_its_first_words(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A broken compiler gives an error that says which, what it said, and what to do."""
    broken = tmp_path / "broken-cc"
    broken.write_text("#!/bin/sh\necho 'licence expired' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(KernelError, match=r"broken-cc failed: licence expired.*Set CC"):
        kernels.build("int answer(void) { return 42; }")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_branch_that_is_not_taken_leaves_zero(engine: str) -> None:
    """Where the condition is false its value does not count, be it infinite or no number at all."""
    a = ca.SX.sym("a")
    kernel = kernels.compile(
        ca.Function("f", [a], [ca.if_else(a > 0, ca.log(a), 0), ca.if_else(a > 0, 1 / a, 0)]),
        engine,
    )
    found = np.hstack(kernel(np.array([[-1.0], [0.0], [1.0], [np.e]])))
    np.testing.assert_allclose(found, [[0, 0], [0, 0], [0, 1], [1, np.exp(-1)]], rtol=1e-15)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("samples", [3, 30_000])
def test_results_written_to_given_memory_are_those_returned(engine: str, samples: int) -> None:
    """`out` holds the same numbers, whatever it held before, aligned or not; what does not fit is
    refused."""
    model = build_model(load_robot(), engine=engine)
    states = np.random.default_rng(1).normal(size=(3, samples, 6))
    expected = model.regressor(*states)
    for skip in (0, 1):
        out = np.full(expected.size + skip, np.nan)[skip:].reshape(expected.shape)
        found = model.regressor(*states, out=out)
        assert np.shares_memory(found, out)
        np.testing.assert_array_equal(out, expected)
    for wrong in (out[:-1], out.astype(np.float32), np.asfortranarray(out)):
        with pytest.raises(ValueError, match="contiguous, writable"):
            model.regressor(*states, out=wrong)
