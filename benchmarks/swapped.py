# SPDX-License-Identifier: Apache-2.0
"""Engines swapped: a humanoid's simulator in DART is calibrated on a robot in MuJoCo, and on one in DART that is like it.

The robot hides the paper's parameters, drawn by a quarter of their range to either side; two squats of 1.2 s are fitted, of
which angles, torso position and orientation are recorded with noise. Judged is the torso's orientation in a third squat that
was not fitted. The peer is the model as it came.
"""

from __future__ import annotations

import argparse
import os
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.articulated.simulator import ArticulatedSimulator
from trueup.discrepancies.whole_body import orientation_error
from trueup.engines.dart.model import of
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator
from trueup.loop.settle import settled
from trueup.loop.whole_runs import whole_body, whole_runs
from trueup.recording import Channel, Recording
from trueup.studies.balance.calibration import declared
from trueup.studies.balance.scenes import STAND, model_of, pose_of
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

NOISE = {"position": 0.003, "base_position": 0.0005, "base_orientation": 0.004}
"""rad, m, rad: an encoder's step and a motion capture."""
SCENE = "kneel-to-stand"  # its floor alone
DEPTHS = (-0.25, -0.15, -0.2)
"""rad by which thighs swing forward in the squats, so that it leans; the last is not fitted."""


def squat(depth: float, start: dict[str, Channel], joints: tuple[str, ...]) -> Trial:
    """Down and up within 0.8 s."""
    time = np.arange(0.0, 1.2, 0.02)
    bent = 0.5 * depth * (1.0 - np.cos(2.0 * np.pi * np.minimum(time, 0.8) / 0.8))
    shares = {"thigh": 1.0, "shin": -1.5, "heel": 0.7, "shoulder": -0.8}
    values = pose_of(joints, STAND) + bent[:, None] * [shares.get(j[2:], 0.0) for j in joints]
    labels = {"position": joints, "base_position": ("x", "y", "z"), "base_orientation": ("roll", "pitch", "yaw")}
    observed = {n: Observed(x, "m" if n == "base_position" else "rad", time) for n, x in labels.items()}
    return Trial(
        f"squat {depth:g}", 0.0, float(time[-1]), Channel("command", joints, "rad", time, values), observed, start
    )


def performed(robot: Simulator, trial: Trial, hidden: Array, rng: np.random.Generator) -> Recording:
    """What is recorded of it."""
    (run,) = robot.rollout([trial], hidden[None])
    made = run.recording()
    for name, noise in NOISE.items():
        c = made.channel(name)
        made = made.with_channel(c.replace(values=c.values + noise * rng.standard_normal(c.values.shape)))
    return made


def main() -> None:
    """Prints the torso's error before and after, in both ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one squat is fitted, in four descents")
    quick = parser.parse_args().quick
    model, (space, quantities) = model_of(SCENE), declared(SCENE, "parameters")
    mine = ArticulatedSimulator(of(model), space, quantities)
    theirs = MujocoSimulator(model, space, quantities)
    joints = model.names("actuator")
    for name, robot in (("mujoco", theirs), ("dart", mine)):
        rng = np.random.default_rng(7)
        hidden = space.from_unit(
            np.clip(space.to_unit(space.nominal) + rng.uniform(-0.25, 0.25, len(space)), 0.02, 0.98)
        )
        start = dict(settled(theirs, joints, pose_of(joints, STAND), np.linspace(0.295, 0.31, 8).tolist()))
        recordings = [performed(robot, squat(d, start, joints), hidden, rng) for d in DEPTHS]
        fitted, (left,) = recordings[: 1 if quick else 2], recordings[-1:]
        begun = time.process_time()
        found = whole_runs([whole_body(mine, fitted)], space, seed=0, generations=0, members=1, descents=4 if quick else 8,
                           prior=0.002)  # fmt: skip
        judged = whole_body(mine, [left])
        before, after = (orientation_error([left], judged.rollouts(v[None])) for v in (space.nominal, found.values[0]))
        print(f"robot in {name}, calibrated in DART: torso in a squat left out {before:.4f} -> {after:.4f} rad, "
              f"{found.evaluations} simulations, {time.process_time() - begun:.0f} CPU s", flush=True)  # fmt: skip
        result(
            f"swapped_{name}_torso_error",
            after,
            "rad",
            0.3,
            peer="the model as it came",
            peer_value=before,
            ratio_goal=True,
        )


if __name__ == "__main__":
    main()
