# SPDX-License-Identifier: Apache-2.0
"""The paper's four transitions of the small humanoid: lean-, sit-, kneel-to-stand and stand-to-handstand.

Poses and first keyframes are those of an own first trial (the paper's lie in its figures only).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.controllers.keyframes import Degree, Motion, mirrored
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator
from trueup.loop.settle import settled
from trueup.tasks.transitions import Transition

PATH = Path(str(resources.files("trueup") / "studies" / "balance" / "bioloid_gp.xml"))
PITCH = ("shoulder", "hand", "thigh", "shin", "heel")
"""What is searched, the same on both sides; the other joints keep their pose."""
DEGREES: tuple[Degree, ...] = mirrored(PITCH, "l_", "r_")
ARM_ROLL = -0.15
STAND = (-0.2, -0.6, -0.2, 0.45, -0.25)


@dataclass(frozen=True)
class Scene:
    """One transition: pitch angles in rad in the order of `PITCH`, boxes that stand on the floor."""

    start: tuple[float, ...]
    seeds: tuple[tuple[float, ...], ...]
    intervals: tuple[float, ...]
    final: tuple[float, ...] = STAND
    reach: float = 0.7
    pitch: float = 0.0
    """Of the torso at the start, in rad."""
    heights: tuple[float, float] = (0.1, 0.34)
    """Of the torso from which it is let down, in m."""
    box: tuple[float, ...] = ()
    """Centre and half sizes of what it sits or leans on, in m."""
    inverted: bool = False


SCENES = {
    "sit-to-stand": Scene(
        start=(0.2, -0.6, 1.25, -0.66, -0.59), seeds=((0.5, -0.8, 1.6, -0.78, -0.3),), intervals=(0.3, 0.5),
        box=(-0.12, 0.0, 0.047, 0.15, 0.15, 0.047), heights=(0.18, 0.30),
    ),
    "lean-to-stand": Scene(
        start=(-0.2, -0.6, 0.05, 0.45, -0.25), seeds=(), intervals=(0.15,), pitch=-0.12, heights=(0.28, 0.33),
        box=(-0.1319, 0.0, 0.25, 0.06, 0.2, 0.25),
    ),
    "kneel-to-stand": Scene(
        start=(-0.2, -0.6, -0.4, -1.6, 1.0), pitch=-0.05,
        seeds=((-1.2, -0.6, -0.7, -1.4, 0.9), (0.8, -0.6, 1.35, -1.55, 0.9)), intervals=(0.3, 0.25, 0.5),
        heights=(0.16, 0.30),
    ),
    "stand-to-handstand": Scene(
        start=(2.6, 0.52, -0.2, 0.45, -0.25), final=(2.6, 0.52, -0.2, 0.45, -0.25),
        seeds=((2.6, 0.52, -1.2, -0.6, 0.9), (2.6, 0.52, 0.8, 0.0, 0.3)), intervals=(0.4, 0.3, 0.3), reach=1.0,
        inverted=True, heights=(0.28, 0.33),
    ),
}  # fmt: skip


def model_of(name: str) -> Model:
    """The humanoid with what it sits or leans on."""
    model, box = load(PATH), SCENES[name].box
    if not box:
        return model
    spec = model.spec.copy()
    spec.worldbody.add_geom(
        name="support", type=mujoco.mjtGeom.mjGEOM_BOX, pos=box[:3], size=box[3:], friction=[0.8, 0.005, 0.0001]
    )
    return replace(model, spec=spec, compiled=spec.compile())


def pose_of(joints: tuple[str, ...], pitch: tuple[float, ...]) -> Array:
    """(k,) all joints of a symmetric pose, in rad."""
    angles: dict[str, float] = dict(zip(PITCH, pitch, strict=True))
    side = {"l": 1.0, "r": -1.0}
    return np.array([angles.get(j[2:], side[j[0]] * ARM_ROLL if j[2:] == "arm" else 0.0) for j in joints])


def motion_of(name: str, model: Model, interpolation: str = "linear") -> Motion:
    """What is searched of a transition."""
    scene, joints = SCENES[name], model.names("actuator")
    ranges = np.array([model.compiled.jnt_range[model.index("joint", j)] for j in joints])
    return Motion(
        joints, pose_of(joints, scene.start), pose_of(joints, scene.final), DEGREES,
        np.array(scene.seeds).reshape(-1, len(PITCH)), np.array(scene.intervals), ranges[:, 0], ranges[:, 1],
        reach=scene.reach, interpolation=interpolation,
    )  # fmt: skip


def transition(name: str, *, step: float = 0.002, fitness: str = "repaired") -> tuple[Simulator, Transition]:
    """The simulator of a scene and its task, begun from rest. Raises TrialError where the start pose cannot rest."""
    model = model_of(name)
    scene, motion = SCENES[name], motion_of(name, model)
    simulator = MujocoSimulator(model, step=step)
    heights = np.linspace(*scene.heights, 25)
    start = settled(simulator, motion.joints, motion.first, heights.tolist(), pitch=scene.pitch, name=name)
    height = _final_height(motion, step, inverted=scene.inverted)
    return simulator, Transition(name, motion, start, height, inverted=scene.inverted, fitness=fitness)


def _final_height(motion: Motion, step: float, *, inverted: bool) -> float:
    """m, of the torso that rests in the last pose, on its feet or its hands, with nothing beside it."""
    heights = np.linspace(0.07, 0.16, 19) if inverted else np.linspace(0.29, 0.32, 13)
    bare = MujocoSimulator(load(PATH), step=step)
    rest = settled(bare, motion.joints, motion.last, heights.tolist(), roll=np.pi if inverted else 0.0, name="last")
    return float(rest["base_position"].column("z")[0])
