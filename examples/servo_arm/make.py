"""Make the recordings of docs/servo_arm.md: a servo arm in MuJoCo, not quite that of arm.xml, in
the form of LeRobot.

    python examples/servo_arm/make.py FOLDER

Commands at 50 Hz, encoders of 12 bits, no torque. Its commands reach the servos 20 ms late, its
elbow has more dry friction, and its masses, armatures and gains are a few percent off.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.robot.mjcf import open_mjcf

HERE = Path(__file__).parent
RATE, SECONDS, LATE = (
    50.0,
    (16, 10),
    1,
)  # Hz, s of each episode, and commands that the arm is behind
# Text of arm.xml -> that of the true arm.
TRUTH = {
    'name="elbow" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.05"': (
        'name="elbow" axis="0 1 0" armature="0.029" damping="0.045" frictionloss="0.2"'
    ),
    'mass="0.45"': 'mass="0.46"',
    'kp="17.8" kv="0.6" joint="pan"': 'kp="18.6" kv="0.62" joint="pan"',
}


def commands(seconds: float, seed: int, rate: float = RATE) -> np.ndarray:
    """Return smooth commands (N, 3) rad of several frequencies, from rest."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * rate)) / rate
    f = np.array([0.1, 0.23, 0.41, 0.67, 0.97, 1.2])
    size, phase = rng.normal(size=(6, 3)) / (0.6 + f)[:, None], rng.uniform(0.0, 2 * np.pi, (6, 3))
    motion = np.einsum(
        "fj,ftj->tj", size, np.sin(2 * np.pi * f[:, None, None] * t[:, None] + phase[:, None])
    )
    start = np.clip(t, 0.0, 1.0)[:, None]
    return np.array([0.0, 0.5, 0.8]) + 0.5 * motion / motion.std(axis=0) * start**2 * (
        3.0 - 2.0 * start
    )


def main(folder: Path) -> None:
    """Write a dataset of two episodes."""
    text = (HERE / "arm.xml").read_text()
    for stated, true in TRUTH.items():
        assert stated in text
        text = text.replace(stated, true)
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "true.xml").write_text(text)
        arm = open_mjcf(Path(place) / "true.xml")
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True, exist_ok=True)
    for episode, seconds in enumerate(SECONDS):
        told = commands(seconds, episode)
        late = np.vstack([told[:1].repeat(LATE, axis=0), told[:-LATE]])
        state = record_commands(arm, late, rate=RATE, bits=12).link
        step = np.arange(len(told))
        columns = {
            "observation.state": state.position.astype(np.float32).tolist(),
            "action": told.astype(np.float32).tolist(),
            "timestamp": (step / RATE).astype(np.float32),
            "frame_index": step,
            "episode_index": np.full(len(step), episode),
        }
        pq.write_table(
            pa.table(columns), data / f"episode_{episode:06d}.parquet", compression="zstd"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
