"""The blind check: hidden arms, their sealed truth, and the score."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.errors import DiagnosisError
from elastic_arm.gap.challenge import campaign
from elastic_arm.gap.challenge.draw import SIZE, Bounds, draw_item
from elastic_arm.gap.challenge.hidden_arm import HiddenArm
from elastic_arm.gap.challenge.motion import random_motion
from elastic_arm.gap.challenge.score import Share, score
from elastic_arm.gap.challenge.seal import NAME, open_sealed, seal
from elastic_arm.gap.challenge.tree import Tree
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)


@pytest.mark.parametrize("bearings", [False, True])
def test_hidden_tree_agrees_with_the_projects_own_derivation(bearings: bool) -> None:
    """Two engines that share no code give the same torques for the same motion, to rounding."""
    rng = np.random.default_rng(0)
    tree, model = Tree(ROBOT, bearings=bearings), build_model(ROBOT, bearings=bearings)
    x, dx, ddx = (0.3 * rng.standard_normal((3, tree.dof)) for _ in range(3))
    still = np.zeros_like(x)
    # What hangs on stiffness and damping is not the tree's.
    springs = model.inverse_dynamics(x, dx, ddx) - np.array([tree.torque(*row) for row in zip(x, dx, ddx, strict=True)])
    expected = model.inverse_dynamics(x, dx, still) - np.array(
        [tree.torque(*row) for row in zip(x, dx, still, strict=True)]
    )
    np.testing.assert_allclose(springs, expected, atol=1e-8)


def test_hidden_tree_has_the_papers_coupling() -> None:
    """S_11 and S_23 are the constants of (8), and the mass matrix is that of inverse dynamics."""
    tree = Tree(ROBOT)
    x = np.array([0.3, -0.5, 0.7, 0.3, -0.5, 0.7])
    M, _ = tree.terms(x, np.zeros(6))
    columns = [tree.torque(x, np.zeros(6), e) - tree.torque(x, np.zeros(6), np.zeros(6)) for e in np.eye(6)]
    np.testing.assert_allclose(M, np.array(columns), atol=1e-9)
    assert M[0, 3] == pytest.approx(0.4356, rel=1e-6)
    assert M[1, 5] == pytest.approx(0.185, rel=0.01)


def test_hidden_motion_does_not_depend_on_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as many integration steps change angles by less than 1e-9 rad."""
    from elastic_arm.gap.challenge import hidden_arm

    motion = random_motion(np.random.default_rng(2), 3, 1.5)
    coarse = HiddenArm(ROBOT).run(motion)
    monkeypatch.setattr(hidden_arm, "SUBSTEPS", 4)
    fine = HiddenArm(ROBOT).run(motion)
    assert np.abs(coarse.q - fine.q).max() < 1e-9


def test_sealed_truth_opens_only_unchanged(tmp_path: Path) -> None:
    """What was sealed comes back; what was changed after is refused."""
    digest = seal(tmp_path, [{"name": "arm"}])
    assert open_sealed(tmp_path, digest) == [{"name": "arm"}]
    (tmp_path / NAME).write_bytes(b"other")
    with pytest.raises(DiagnosisError, match="not what was sealed"):
        open_sealed(tmp_path, digest)


def test_every_effect_can_be_drawn_above_its_bound() -> None:
    """Drawn sizes are at least ten times what theory allows to be detected, unless implausibly large."""
    rng = np.random.default_rng(4)
    bounds = Bounds(ROBOT, rng, 4.0)
    for effect in SIZE:
        item = draw_item("arm", (effect,), ROBOT, bounds, rng)
        assert item.faults[0].effect == effect
        assert item.multiple[0] is None or item.multiple[0] > 1.0


def test_small_campaign_is_made_resumed_answered_and_scored(tmp_path: Path) -> None:
    """A clean arm is called none and a faulty one is named; a second run does nothing again."""
    settings = {"seed": 3, "clean": 1, "pairs": 0, "effects": ["motor_torque_offset"], "seconds": 6.0}
    digest = campaign.create(tmp_path, validate_seconds=5.0, **settings)  # type: ignore[arg-type]
    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")}
    assert campaign.create(tmp_path, validate_seconds=5.0, **settings) == digest  # type: ignore[arg-type]
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")} == stamps
    assert campaign.solve(tmp_path) == {}
    found = score(tmp_path)
    assert found["answered"] == 2 and found["open"] == 0
    assert found["shares"]["clean called none"]["hits"] == 1
    assert found["shares"]["effect right"]["hits"] == 1
    with pytest.raises(DiagnosisError, match="another challenge"):
        campaign.create(tmp_path, seed=4)


def test_shares_carry_binomial_intervals() -> None:
    """Twenty of twenty is a share of one, whose interval begins near 0.83."""
    share = Share(20, 20)
    assert share.value == 1.0
    assert share.interval == pytest.approx((0.8316, 1.0), abs=1e-3)
