# SPDX-License-Identifier: Apache-2.0
"""Two joints driven by servos, in plain MuJoCo: gains, friction, inertia and a delay are hidden from who fits them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <joint axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="{armature}"
           solimpfriction="0.999 0.999 0.001"/>
    <position kp="{kp}"/>
  </default>
  <worldbody>
    <body>
      <joint name="shoulder"/><inertial pos="0 0 -0.12" mass="0.6" diaginertia="0.004 0.004 0.001"/>
      <body pos="0 0 -0.25">
        <joint name="elbow"/><inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="shoulder" joint="shoulder"/><position name="elbow" joint="elbow"/></actuator>
</mujoco>
"""
JOINTS = ("shoulder", "elbow")
NOMINAL = {"kp": 18.0, "damping": 0.4, "friction": 0.08, "armature": 0.015}
STEP, EVERY, NOISE = 0.001, 10, 5e-4  # s, steps between samples, rad


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """Another robot: each value up to four times smaller or larger, and commands that act up to 30 ms late."""
    return {k: v * float(np.exp(rng.uniform(-1.4, 1.4))) for k, v in NOMINAL.items()} | {
        "delay": float(rng.uniform(0.0, 0.03))
    }


def recordings(truth: dict[str, float], rng: np.random.Generator, duration: float = 8.0) -> list[Recording]:
    """Three multisines on steps, with noise on the measured positions."""
    return [record(f"motion_{k}", truth, rng, duration) for k in range(3)]


def record(name: str, truth: dict[str, float], rng: np.random.Generator, duration: float) -> Recording:
    """The truth in plain MuJoCo, one `mj_step` after the other."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**truth))
    data = mujoco.MjData(model)
    time = STEP * EVERY * np.arange(round(duration / (STEP * EVERY)), dtype=np.float64)
    rates, phases = rng.uniform(0.2, 2.5, (4, 2)), rng.uniform(0.0, 6.0, (4, 2))
    waves = 0.2 * np.sin(2.0 * np.pi * rates * time[:, None, None] + phases).sum(axis=1)
    steps = rng.uniform(-0.3, 0.3, (int(duration) + 1, 2))[time.astype(int)]
    asked = (waves + steps) * np.clip(time[:, None] / 0.5, 0.0, 1.0)
    seen = np.empty_like(asked)
    for k in range(len(time) * EVERY):
        if k % EVERY == 0:
            seen[k // EVERY] = data.qpos
        late = int(np.floor((k * STEP - truth["delay"]) / (STEP * EVERY) + 1e-9))
        data.ctrl[:] = asked[max(late, 0)]
        mujoco.mj_step(model, data)
    noisy = seen + NOISE * rng.standard_normal(seen.shape)
    channels = (Channel("command", JOINTS, "rad", time, asked), Channel("position", JOINTS, "rad", time, noisy))
    return Recording(name, {c.name: c for c in channels})


def simulator(folder: Path) -> MujocoSimulator:
    """The arm as a user has it, one value of each kind for both joints; a delay of each servo."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(**NOMINAL), encoding="utf-8")
    model = load(path)
    lines = [Declaration(kind, lower=0.05 * v, upper=20.0 * v) for kind, v in NOMINAL.items()]
    return MujocoSimulator(model, *declare(model, [*lines, Declaration("delay")]), step=STEP)


def known(truth: dict[str, float]) -> dict[str, float]:
    """The truth by the names of the simulator's parameters."""
    return {f"{joint}.{kind}": value for joint in JOINTS for kind, value in truth.items()}
