"""The derivative stage of a batch states where joints stick as the whole recording shows it."""

from types import SimpleNamespace

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation import smoother
from elastic_arm.estimation.smoother import Smoother
from elastic_arm.identification.batch.derivatives import DerivativeStage, repeats
from elastic_arm.recording import Samples

RATE = 1000.0
SECONDS = 20
LAWS = SimpleNamespace(columns=(None,), laws=lambda motion: np.zeros((len(motion), 6, 1)))


def samples(angles: np.ndarray, rate: float = RATE, lost: slice | None = None) -> Samples:
    """Return a recording of angles (N, n) alone, read with 1e-6 rad; samples are lost where it is
    said."""
    kept = np.ones(len(angles), dtype=bool)
    if lost is not None:
        kept[lost] = False
    t = np.flatnonzero(kept) / rate
    noise = 1e-6 * np.random.default_rng(1).standard_normal(angles.shape)
    lacking = dict.fromkeys(("q", "dq", "tau_J", "dtheta", "tau_m"))
    return Samples(
        t=t, stamp_ns=np.rint(t * 1e9).astype(np.int64), theta=(angles + noise)[kept], **lacking
    )


def swinging(seconds: float = SECONDS, rate: float = RATE, frequency: float = 0.5) -> np.ndarray:
    """Return angles (N, 2) of two joints that swing, reversing at other times."""
    t = np.arange(round(seconds * rate)) / rate
    return np.stack([np.sin(2 * np.pi * frequency * t), np.cos(2 * np.pi * frequency * t)], axis=1)


def stuck(recording: Samples) -> np.ndarray:
    """Return where joints stick, of all runs one after another, (M, n)."""
    motions = list(DerivativeStage(recording)(LAWS, stuck=True).motions)
    assert all(len(motion.stuck) == len(motion) for motion in motions)
    return np.concatenate([motion.stuck for motion in motions])


def test_a_joint_that_is_parked_sticks_in_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where runs are shorter than the 7.5 s for which it stands, their own speeds do not show
    it."""
    angles = swinging()
    end = round(12.5 * RATE)
    angles[end:, 0] = angles[end, 0]
    whole = stuck(samples(angles))
    monkeypatch.setattr(smoother, "RUN", 2048)
    np.testing.assert_array_equal(stuck(samples(angles)), whole)
    assert whole[:, 0].mean() == pytest.approx(0.375, abs=0.03)
    assert whole[:, 1].mean() < 0.1


def test_a_run_or_piece_of_one_sample_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a piece that is one sample longer than what the smoother loses, that sample is left."""
    lost = 4 * DerivativeStage(samples(swinging()))._smoother.lag
    first = 2 * lost
    cut = samples(swinging((first + 501 + lost) / RATE), lost=slice(first, first + 500))
    monkeypatch.setattr(Smoother, "lag", property(lambda self: lost // 4))
    assert [len(motion) for motion in DerivativeStage(cut)(LAWS, stuck=True).motions][-1] == 1
    monkeypatch.setattr(smoother, "RUN", first - lost - 1)
    assert 1 in [len(motion) for motion in DerivativeStage(cut)(LAWS, stuck=True).motions][:-1]


def test_reversals_are_as_short_in_motion_that_is_thinned() -> None:
    """A reversal of 2 ms is none at which a joint sticks, though one sample of those that are kept
    falls into it."""
    stage = DerivativeStage(samples(swinging(frequency=2.0)))
    motions = list(stage(LAWS, stuck=True).motions)
    assert not any(motion.stuck.any() for motion in motions)


def test_a_recording_that_is_too_short_is_named_with_what_it_needs() -> None:
    """Its own length and all that is needed: twice as much with laws, which pass the smoother a
    second time."""
    whole = DerivativeStage(samples(swinging()))._smoother.lag / RATE
    seconds = round(3.0 * whole, 1)
    short = DerivativeStage(samples(swinging(seconds)), source="runs/short")
    need = 2.0 * short._smoother.lag / RATE
    assert need < seconds < 2.0 * need
    with pytest.raises(IdentificationError) as raised:
        short(SimpleNamespace(columns=["coulomb_friction"]))  # type: ignore[arg-type]
    assert f"runs/short is {seconds:.2f} s long" in raised.value.problem
    assert (
        f"needs more than {2.0 * need:.2f} s, as effects in addition to the model pass it twice"
        in raised.value.problem
    )
    assert (
        f"Record longer, or identify without effects (--with), for which {need:.2f} s"
        in raised.value.remedy
    )
    assert len(next(short().motions)) > 0
    end = round(0.5 * need * RATE)
    gaps = samples(swinging(2.0 * seconds), lost=slice(end, round(2.0 * seconds * RATE) - end))
    with pytest.raises(
        IdentificationError, match="the recording has 2 intervals between gaps, the longest"
    ):
        DerivativeStage(gaps)()


def test_a_motion_that_repeats_is_told_from_one_that_does_not() -> None:
    """Three harmonics under noise, and a chirp."""
    t = np.arange(5000) / 250.0
    angle = sum(
        a * np.sin(2 * np.pi * k * t / 4.0 + 0.3 * k) for k, a in ((1, 0.5), (2, 0.2), (5, 0.05))
    )
    noise = 1e-4 * np.random.default_rng(0).standard_normal((len(t), 1))
    assert repeats(np.asarray(angle)[:, None] + noise)
    assert not repeats(np.sin(0.3 * t**2)[:, None])
