# SPDX-License-Identifier: Apache-2.0
"""Engines swapped: calibration, transitions and the files of a robot work in DART as they do in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("dartpy", reason="the second engine is an extra: pip install trueup[dart]")

from trueup.articulated.assignments import Assignment
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.campaign.motions import transition
from trueup.campaign.plan import templates
from trueup.chance import Push
from trueup.discrepancies.whole_body import orientation_error
from trueup.engines.dart import load, simulator
from trueup.engines.mujoco.model import load as load_file
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator
from trueup.errors import ModelError, UnknownNameError
from trueup.loop.confirm import NOISE
from trueup.loop.prepare import prepare
from trueup.loop.whole_runs import whole_body, whole_runs
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

LEG = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
  <geom name="floor" type="plane" size="2 2 0.1" friction="0.9"/>
  <body name="foot" pos="0 0 0.01"><freejoint/><geom type="box" size="0.09 0.06 0.01" mass="0.3" friction="0.9"/>
    <body name="shank" pos="0 0 0.02"><joint name="ankle" axis="0 1 0" damping="0.05" armature="0.002"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.14" size="0.015" mass="0.2" contype="0" conaffinity="0"/>
      <body name="torso" pos="0 0 0.16"><joint name="hip" axis="0 1 0" damping="0.05" armature="0.002"/>
        <geom type="box" size="0.04 0.05 0.06" pos="0 0 0.06" mass="0.8" contype="0" conaffinity="0"/>
      </body></body></body></worldbody>
  <actuator><position name="ankle" joint="ankle" kp="9"/><position name="hip" joint="hip" kp="9"/></actuator></mujoco>"""
LINES = [
    Declaration("kp", ("ankle",)), Declaration("kp", ("hip",)), Declaration("mass", ("torso",)),
    Declaration("com_x", ("torso",)),
]  # fmt: skip
HIDDEN = np.array([7.0, 5.0, 1.0, 0.008])


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    (tmp_path / "leg.xml").write_text(LEG)
    return tmp_path / "leg.xml"


def declared(leg: Path) -> tuple[ParameterSpace, tuple[Assignment, ...]]:
    return declare(load_file(leg), LINES)


def swaying() -> Trial:
    joints, time, start = ("ankle", "hip"), np.arange(0.0, 1.0, 0.02), np.zeros(1)
    waves = np.stack([0.15 * np.sin(7.0 * time), -0.5 * np.sin(5.0 * time)], axis=1)
    return Trial(
        "sway", 0.0, float(time[-1]), Channel("command", joints, "rad", time, waves),
        {"position": Observed(joints, "rad", time), "base_position": Observed(("x", "y", "z"), "m", time),
         "base_orientation": Observed(("roll", "pitch", "yaw"), "rad", time)},
        {"position": Channel("position", joints, "rad", start, np.zeros((1, 2))),
         "base_position": Channel("base_position", ("x", "y", "z"), "m", start, np.array([[0.0, 0.0, 0.0102]])),
         "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", start, np.zeros((1, 3)))},
    )  # fmt: skip


def performed(robot: Simulator, noise: float = 0.0) -> Recording:
    (run,) = robot.rollout([swaying()], HIDDEN[None])
    rng, made = np.random.default_rng(0), run.recording()
    for name in ("position", "base_position", "base_orientation"):
        channel = made.channel(name)
        made = made.with_channel(
            channel.replace(values=channel.values + noise * rng.standard_normal(channel.values.shape))
        )
    return made


@pytest.mark.parametrize("robot", ["dart", "mujoco"])
def test_a_calibration_in_dart_finds_what_a_robot_in_either_engine_hides(leg: Path, robot: str) -> None:
    made = simulator(load(leg), LINES)
    hidden = made if robot == "dart" else MujocoSimulator(load_file(leg), made.parameters, made.quantities, step=0.001)
    recorded = performed(hidden, 0.001)
    problem = whole_body(made, [recorded])
    found = whole_runs([problem], made.parameters, seed=0, generations=0, members=1, descents=6, prior=1e-4)
    apart = np.abs(found.values[0] / HIDDEN - 1.0)
    assert (apart < (0.05 if robot == "dart" else 0.12)).all(), apart
    before, after = (
        orientation_error([recorded], problem.rollouts(v[None])) for v in (made.parameters.nominal, found.values[0])
    )
    assert after < 0.3 * before


def test_a_humanoid_rises_in_dart_under_noise_and_pushes_by_its_name() -> None:
    file = templates()["motion"] / "small_humanoid.xml"
    made, task = transition(file, "sit", "stand", between=["lean"], feedback={"ankle": (0.5, 0.05)}, engine="dart")
    assert isinstance(made, ArticulatedSimulator)
    (trial,) = task.trials
    rough = replace(trial, disturbances=(*NOISE, Push("torso", (0.0, 60.0), (0.1, 0.1), (0.3, 0.3)))).seeded(
        np.random.default_rng(1)
    )
    values = np.repeat(task.parameters.nominal[None], 2, axis=0)
    (run,) = made.rollout([rough], values, task.controllers)
    assert not run.failures
    assert np.isfinite(task.score([run])).all()
    place = run.channels["base_position"][:, :10]
    assert np.ptp(place, axis=0).max() > 1e-4  # no two rows meet the same chance
    (alone,) = made.rollout([rough], values[:1], task.controllers)
    assert np.array_equal(alone.channels["base_position"], run.channels["base_position"][:1], equal_nan=True)


def test_a_model_file_is_prepared_for_the_engine_that_is_named(leg: Path, tmp_path: Path) -> None:
    recorded = performed(MujocoSimulator(load_file(leg), *declared(leg)))
    ready = prepare(leg, [recorded], engine="dart")
    assert isinstance(ready.simulator, ArticulatedSimulator)
    assert "ankle.kp" in ready.simulator.parameters.names
    assert any("DART has no such thing: friction_creep" in note for note in ready.notes), ready.notes
    (tmp_path / "p.toml").write_text('[[parameter]]\nquantity = "backlash"\nof = "ankle"\n')
    with pytest.raises(ModelError, match="DART has no backlash"):
        prepare(leg, [recorded], parameters=tmp_path / "p.toml", engine="dart")
    with pytest.raises(UnknownNameError, match="bullet"):
        prepare(leg, [recorded], engine="bullet")
    (tmp_path / "car.toml").write_text("")
    with pytest.raises(ModelError, match="a way of their own"):
        prepare(tmp_path / "car.toml", [recorded], engine="dart")
