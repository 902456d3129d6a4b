# SPDX-License-Identifier: Apache-2.0
"""The simulator of any engine moves an arm as MuJoCo's own simulator does, once MuJoCo is told to it in a few lines."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.model import BasePose
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.controllers.playback import Playback
from trueup.engines.mujoco.attributes import MujocoCopies
from trueup.engines.mujoco.model import Model, load, prepared
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.recording import Channel, Recording
from trueup.studies.servo_arm.demo import model_path, motions
from trueup.testing import check_simulator
from trueup.trial import Trial

Array = NDArray[np.float64]

JOINTS = ("base", "shoulder", "elbow", "wrist")
STEP = 0.002
LINES = [
    Declaration("kp"), Declaration("zero", nominal=0.02), Declaration("friction", tie="all"), Declaration("armature"),
    Declaration("delay", tie="all", nominal=0.013), Declaration("mass", ("hand",)), Declaration("offset"),
    Declaration("dead_band", tie="all", nominal=0.01), Declaration("friction_load", tie="all", nominal=0.05),
    Declaration("speed_limit", tie="all", nominal=3.0), Declaration("sensor_delay", ("position",), nominal=0.004),
    Declaration("clock", ("r",), nominal=-0.005), Declaration("start_position", ("r:elbow",)),
    Declaration("joint_sensor_delay", ("wrist",), nominal=0.021),
]  # fmt: skip
NAMES = {"recording": ("r",), "channel": ("position",)}


class Told:
    """A MuJoCo model as an engine that `ArticulatedSimulator` can step."""

    def __init__(self, model: Model) -> None:
        self.name, self.width = model.name, model.width
        self.names, self.drives, self.columns, self.get = model.names, model.drives, model.columns, model.get
        self.compiled = prepared(model, step=STEP)

    def channels(self) -> dict[str, tuple[str, ...]]:
        return {}

    def copies(self, rows: int) -> Copies:
        return Copies(self.compiled, Batch(self.compiled, rows, 1), list(self.drives()))


class Copies(MujocoCopies):
    def __init__(self, compiled: mujoco.MjModel, batch: Batch, joints: list[str]) -> None:
        super().__init__(compiled, batch)
        self._joints, self._rows = joints, batch.nsim
        batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))

    @property
    def position(self) -> Array:
        return self.reader("position", self._joints)(self._rows)

    @property
    def velocity(self) -> Array:
        return self.reader("velocity", self._joints)(self._rows)

    @property
    def force(self) -> Array:
        return self.reader("force", self._joints)(self._rows)

    def place(self, position: Array, velocity: Array, base: BasePose | None = None) -> None:
        self._batch.set_const()
        self._batch.bind("qpos")[:], self._batch.bind("qvel")[:] = position, velocity

    def step(self, command: Array, step: float) -> None:
        assert step == STEP
        self._batch.bind("ctrl")[:] = command
        self._batch.step()


@pytest.fixture(scope="module")
def both() -> tuple[ArticulatedSimulator, MujocoSimulator]:
    model = load(Path(model_path()))
    space, assignments = declare(model, LINES, NAMES)
    one = ArticulatedSimulator(Told(model), space, assignments, step=STEP)
    return one, MujocoSimulator(model, space, assignments, step=STEP, threads=1)


def recording() -> Recording:
    command = motions(4)["multisine"][20:100]
    time = np.arange(len(command)) / 50.0
    return Recording("r", {n: Channel(n, JOINTS, "rad", time, command) for n in ("command", "position", "torque")})


def values(simulator: MujocoSimulator) -> Array:
    space = simulator.parameters
    unit = np.clip(space.to_unit(space.nominal), 0.05, 0.95)
    return space.from_unit(np.stack([unit, 0.9 * unit + 0.05, 0.8 * unit + 0.1]))


def test_it_moves_an_arm_as_the_simulator_made_for_its_engine(
    both: tuple[ArticulatedSimulator, MujocoSimulator],
) -> None:
    trial = Trial.of(recording())
    (one,), (other,) = (s.rollout([trial], values(both[1])) for s in both)
    assert np.ptp(one.channels["position"][0], axis=0).min() > 0.3
    for name, tolerance in (("position", 1e-9), ("torque", 1e-6)):
        assert np.abs(one.channels[name] - other.channels[name]).max() < tolerance, name


def test_a_controller_acts_in_it_as_in_the_other(both: tuple[ArticulatedSimulator, MujocoSimulator]) -> None:
    command = recording().channel("command")
    trial = Trial.of(recording(), ("position",))
    (one,), (other,) = (
        s.rollout([trial], values(both[1]), lambda v: Playback(command, len(v), period=0.02)) for s in both
    )
    assert np.abs(one.channels["position"] - other.channels["position"]).max() < 1e-9


def test_it_keeps_the_contract_of_simulators() -> None:
    model = load(Path(model_path()))
    made = ArticulatedSimulator(
        Told(model), *declare(model, [Declaration("kp"), Declaration("delay", tie="all")]), step=STEP
    )
    check_simulator(made, recording())
