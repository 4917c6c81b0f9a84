"""A servo that swings a pendulum, integrated here, whose duty is recorded: the firmware is none of
the description's."""

import math
from functools import cache
from pathlib import Path

import numpy as np

from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, load_robot

SUPPLY = 7.4  # V
PER_VOLT = 0.1  # kt / R, Nm/V
BACK_EMF = 0.4  # V s/rad
MASS = 0.5  # kg, at LENGTH m
LENGTH = 0.1
INERTIA = 1e-4  # kg m² about the centre of mass
ARMATURE = 0.0018  # kg m²
FRICTION = 0.03  # Nm
FULL = 885  # number of full duty
RATE = 250.0  # Hz
STEP = 2.5e-4  # s of the integration
BITS = 15

URDF = f"""<robot name="pendulum"><link name="base"/>
<joint name="servo" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<origin xyz="0 0 1"/><dynamics friction="{FRICTION}"/>
<limit lower="-6" upper="6" effort="0.2" velocity="20"/></joint>
<link name="rod"><inertial><origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""
# A kp of the firmware that is far from the one simulated; its limit of torque is, too.
ARM = f"""urdf: arm.urdf
armature: {{servo: {ARMATURE}}}
controller:
  servo:
    motor:
      {{supply: {SUPPLY}, torque_per_volt: {PER_VOLT}, back_emf: {BACK_EMF}, duty_per_rad: 9.0}}
    torque: 0.05
    dead_band: 0.3
"""


def described(folder: Path) -> Robot:
    """Write the arm as a file, and read it."""
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.yaml").write_text(ARM)
    return load_robot(folder / "arm.yaml")


@cache
def recorded(
    seed: int,
    *,
    per_volt: float = PER_VOLT,
    sag: float = 0.0,
    seconds: float = 20.0,
    falls: float = 0.0,
) -> Recording:
    """Return positions and the duty of a servo with 2 kp, a dead band, and late commands, as by a
    controller that nobody described.

    falls: share of the supply's voltage that is lost until the end, steadily; the voltage is
    recorded if it falls.
    """
    rng = np.random.default_rng(seed)
    frequencies = np.array([0.15, 0.4, 0.9, 1.7])
    sizes = np.array([0.9, 0.5, 0.25, 0.1])
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    count = round(seconds / STEP)
    t = STEP * np.arange(count)
    command = np.sin(2.0 * np.pi * frequencies * t[:, None] + phases) @ sizes
    whole = INERTIA + MASS * LENGTH**2 + ARMATURE
    q = float(command[0])
    w = 0.0
    angle, duty = np.empty((2, count))
    late = round(0.02 / STEP)
    volts = SUPPLY * (1.0 - falls * np.arange(count) / count)
    # Numbers of Python: arrays give one at a time slowly.
    supplied = volts.tolist()
    told = command[np.maximum(np.arange(count) - late, 0)].tolist()
    for k in range(count):
        error = told[k] - q
        felt = error - min(max(error, -0.03), 0.03)
        u = min(max(1.8 * felt, -1.0), 1.0)
        angle[k] = q
        duty[k] = u
        torque = per_volt * (supplied[k] * u * (1.0 - sag * abs(u)) - BACK_EMF * w)
        torque -= MASS * 9.81 * LENGTH * math.sin(q) + FRICTION * math.tanh(w / 2e-3)
        # Friction is stiff: its slope is taken along implicitly.
        slope = FRICTION / 2e-3 / math.cosh(min(abs(w) / 2e-3, 300.0)) ** 2
        w += STEP * torque / (whole + STEP * slope)
        q += STEP * w
    every = round(1.0 / (RATE * STEP))
    code = 2.0 * np.pi / 2**BITS
    stamps = np.round(1e9 * t[::every]).astype(np.int64)
    position = code * np.round(angle[::every] / code)
    share = np.round(FULL * duty[::every]) / FULL
    supply = np.round(10.0 * volts[::every, None]) / 10.0 if falls else None
    return Recording(
        ("servo",),
        link=Side(stamps, position=position[:, None]),
        motor=Side(stamps, pwm=share[:, None], supply=supply),
        source=f"run_{seed}",
    )
