"""Kernels: C and numpy give the same numbers, the cache is shared safely, a missing compiler is
survived and said."""

import itertools
import logging
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from elastic_arm.codegen import kernels
from elastic_arm.codegen.cache import CACHE_VARIABLE
from elastic_arm.dynamics import build_model
from elastic_arm.dynamics.gram import gram
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
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    a, b, c = x[0], x[1], x[2]
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
    x, p = np.random.default_rng(samples).normal(size=(samples, 3)), np.array([0.3, -0.2])
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


def exact_entry(a: np.ndarray, b: np.ndarray) -> Fraction:
    return sum(
        (Fraction(p) * Fraction(q) for p, q in zip(a.tolist(), b.tolist(), strict=True)),
        Fraction(0),
    )


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


@pytest.mark.parametrize("engine", ENGINES)
def test_information_is_exact_to_seventy_six_bits(
    engine: str, states: tuple[np.ndarray, ...]
) -> None:
    """Every entry of a row's matrix equals the exact sum of products, relative to the columns'
    norms."""
    model = build_model(load_robot(), engine=engine)
    rng = np.random.default_rng(3)
    columns = np.arange(0, 72, 3)
    x, dx, ddx = (v[:333] for v in states)
    y = rng.normal(size=(333, 6))
    hi, lo = model.information(x, dx, ddx, y, columns)
    assert hi.shape == (6, len(columns) + 1, len(columns) + 1)
    Phi = model.regressor(x, dx, ddx, columns)
    for row in range(6):
        whole = np.column_stack([Phi[:, row], y[:, row]])
        filled = np.flatnonzero(np.linalg.norm(whole, axis=0))
        for i, j in itertools.combinations_with_replacement(filled.tolist(), 2):
            exact = exact_entry(whole[:, i], whole[:, j])
            norm = np.linalg.norm(whole[:, i]) * np.linalg.norm(whole[:, j])
            error = Fraction(hi[row, i, j]) + Fraction(lo[row, i, j]) - exact
            assert abs(float(error)) <= 2.0**-76 * norm


@pytest.mark.parametrize("engine", ENGINES)
def test_information_adds_up_over_parts(engine: str, states: tuple[np.ndarray, ...]) -> None:
    """Fed in uneven parts, or by two accumulators merged, the sums are the same but for the
    rounding of products."""
    model = build_model(load_robot(), engine=engine)
    x, dx, ddx = states
    y = np.random.default_rng(4).normal(size=x.shape)
    whole = model.information(x, dx, ddx, y)
    parts, other = model.accumulator(), model.accumulator()
    for start, stop, target in (
        (0, 1, parts),
        (1, 130, parts),
        (130, 4000, other),
        (4000, 5001, parts),
    ):
        target.add(x[start:stop], dx[start:stop], ddx[start:stop], y=y[start:stop])
    parts.merge(other)
    assert parts.samples == len(x)
    hi, lo = parts.grams()
    diagonal = np.sqrt(np.abs(np.einsum("rii->ri", whole[0])))
    scale = diagonal[:, :, None] * diagonal[:, None, :]
    difference = (hi - whole[0]) + (lo - whole[1])
    assert (np.abs(difference) <= 2.0**-75 * scale).all()


def test_rounded_information_is_the_exact_sum_of_a_matrix_that_close(
    states: tuple[np.ndarray, ...],
) -> None:
    """Where entries may be rounded, they are to 51 bits below the largest of their column and part
    of the samples."""
    model = build_model(load_robot(), engine="c")
    columns = np.arange(0, 72, 3)
    x, dx, ddx = (v[:192] for v in states)  # no more than a tile, whose columns have one unit
    y = np.random.default_rng(3).normal(size=(192, 6))
    total = model.accumulator(columns, rounded=True)
    total.add(x, dx, ddx, y=y)
    hi, lo = total.grams()
    Phi = model.regressor(x, dx, ddx, columns)
    exact = model.information(x, dx, ddx, y, columns)
    if np.array_equal(hi, exact[0]) and np.array_equal(lo, exact[1]):
        pytest.skip("this processor has no multiplication of 52-bit integers: nothing is rounded")
    for row in range(6):
        whole = np.column_stack([Phi[:, row], y[:, row]])
        unit = 2.0 ** (np.frexp(np.abs(whole).max(axis=0))[1] - 51)
        rounded = np.rint(whole / unit) * unit
        filled = np.flatnonzero(np.linalg.norm(whole, axis=0))
        for i, j in itertools.combinations_with_replacement(filled.tolist(), 2):
            norm = np.linalg.norm(whole[:, i]) * np.linalg.norm(whole[:, j])
            error = (
                Fraction(hi[row, i, j])
                + Fraction(lo[row, i, j])
                - exact_entry(rounded[:, i], rounded[:, j])
            )
            assert abs(float(error)) <= 2.0**-95 * norm


@pytest.mark.parametrize("rounded", [False, True])
def test_a_sum_over_samples_of_all_sizes_is_that_of_its_parts(
    rounded: bool, states: tuple[np.ndarray, ...]
) -> None:
    """Columns that grow beyond their range on the way, and more samples than integers hold at a
    time, are no matter."""
    model = build_model(load_robot(), engine="c")
    rng = np.random.default_rng(6)
    x, dx, ddx = (np.tile(v, (20, 1)) for v in states)
    dx = dx * np.geomspace(1e-6, 1e3, len(dx))[:, None]
    y = rng.normal(size=x.shape)
    whole, parts = (model.accumulator(rounded=rounded) for _ in range(2))
    whole.add(x, dx, ddx, y=y)
    for start in range(0, len(x), 777):
        part = slice(start, start + 777)
        parts.add(x[part], dx[part], ddx[part], y=y[part])
    hi, lo = whole.grams()
    diagonal = np.sqrt(np.abs(np.einsum("rii->ri", hi)))
    difference = (hi - parts.grams()[0]) + (lo - parts.grams()[1])
    assert (
        np.abs(difference)
        <= 2.0 ** (-51 if rounded else -75) * diagonal[:, :, None] * diagonal[:, None, :]
    ).all()


@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_makes_sums_that_are_not(
    rounded: bool, value: float, states: tuple[np.ndarray, ...]
) -> None:
    """A sample without a number is not taken for one, and rows that it does not touch stay as they
    are."""
    model = build_model(load_robot(), engine="c")
    sums = []
    for given in (0.0, value):
        y = np.ones((5001, 6))
        y[1234, 2] = given
        total = model.accumulator(rounded=rounded)
        total.add(*states, y=y)
        sums.append(total.grams()[0])
    assert not np.isfinite(sums[1][2, -1, -1])
    others = np.arange(6) != 2
    np.testing.assert_array_equal(sums[1][others], sums[0][others])


def test_squaring_a_condition_of_1e7_loses_no_digit() -> None:
    """The solution from the doubled Gram matrix of a badly conditioned problem is as good as a
    QR's."""
    rng = np.random.default_rng(5)
    left, _ = np.linalg.qr(rng.normal(size=(3000, 12)))
    right, _ = np.linalg.qr(rng.normal(size=(12, 12)))
    A = (left * np.logspace(0, -7, 12)) @ right
    b = A @ np.ones(12)
    hi, lo = gram(np.column_stack([A, b]))
    to_fractions = np.vectorize(lambda h, rest: Fraction(h) + Fraction(rest), otypes=[object])
    solution = solve_exactly(
        to_fractions(hi[:-1, :-1], lo[:-1, :-1]), to_fractions(hi[:-1, -1], lo[:-1, -1])
    )
    reference = np.linalg.lstsq(A, b, rcond=None)[0]
    assert np.abs(solution - 1.0).max() <= 10 * np.abs(reference - 1.0).max()


def solve_exactly(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Gaussian elimination in fractions, so that only the Gram matrix's own errors show."""
    size = len(right)
    system = np.column_stack([matrix, right])
    for k in range(size):
        for i in range(k + 1, size):
            system[i] = system[i] - system[i, k] / system[k, k] * system[k]
    solution = np.zeros(size, dtype=object)
    for k in reversed(range(size)):
        solution[k] = (system[k, -1] - sum(system[k, k + 1 : -1] * solution[k + 1 :])) / system[
            k, k
        ]
    return solution.astype(float)
