# SPDX-License-Identifier: Apache-2.0
"""Drives that limit their command's speed and acceleration: seen in steps, found, replayed on steps of other sizes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.kernels import limited_commands
from trueup.controllers.playback import Playback
from trueup.discrepancies.weighted import Weighted
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.loop.profiles import met_beyond
from trueup.recording import Channel, Recording
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

_ARM = """<mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" damping=".4" armature=".02"/><geom size=".05" mass="1" pos="0 0 -.2"/></body></worldbody>
<actuator><position name="m" joint="j" kp="60" kv="2"/></actuator></mujoco>"""


def _way(distance: float, speed: float, acceleration: float, time: Array) -> Array:
    """Where a trapezoidal profile is that begins and ends at rest (a triangle where it is short), in closed form."""
    top = max(min(speed, np.sqrt(abs(distance) * acceleration)), 1e-9)
    rise, whole = top / acceleration, abs(distance) / top + top / acceleration
    t = np.clip(time, 0.0, whole)
    up, last = 0.5 * acceleration * np.minimum(t, rise) ** 2, whole - t
    way = np.where(t <= rise, up, np.where(last <= rise, abs(distance) - 0.5 * acceleration * last**2,
                                           0.5 * acceleration * rise**2 + top * (t - rise)))  # fmt: skip
    return np.sign(distance) * way


def _steps(name: str, targets: tuple[float, ...], speed: float, acceleration: float) -> Recording:
    """An arm told to jump every 1.2 s, whose drive moves its set point in trapezoids instead."""
    model = mujoco.MjModel.from_xml_string(_ARM)
    data, rows = mujoco.MjData(model), []
    at = 0.0
    for target in targets:
        for t in np.arange(0.0, 1.2, 0.01):
            rows.append((target, float(data.qpos[0])))
            for k in range(20):
                data.ctrl[0] = at + _way(target - at, speed, acceleration, np.array(t + 5e-4 * (k + 1)))
                mujoco.mj_step(model, data)
        at = target
    told, seen = np.array(rows).T
    time = 0.01 * np.arange(float(len(told)))
    seen = seen + np.random.default_rng(0).normal(0.0, 3e-4, len(seen))
    return Recording(name, {n: Channel(n, ("j",), "rad", time, v) for n, v in (("command", told), ("position", seen))})


def _found(folder: Path, speed: float, acceleration: float) -> tuple[dict[str, float], float]:
    """What a calibration finds that proposes its own parameters, and its error in rad on steps of other sizes."""
    path = folder / "arm.xml"
    path.write_text(_ARM.replace('kp="60" kv="2"', 'kp="40" kv="1"').replace("5e-4", "2e-3"))
    log = _steps("log", (0.0, 0.3, -0.5, 0.6, 0.5), speed, acceleration)
    other = _steps("other", (0.0, -0.4, 0.7, 0.6), speed, acceleration)
    done = prepare(path, [log], [other]).calibrate(Options(cross_validate=False, lacking=False, stages=DESCENT))
    (replay,) = done.held_out()
    return {e.name: e.value for e in done.estimates if e.fitted}, float(np.std(replay.after - replay.measured))


def test_a_speed_limit_of_the_drive_is_found_with_its_acceleration(tmp_path: Path) -> None:
    found, error = _found(tmp_path, speed=1.2, acceleration=12.0)
    assert found["m.speed_limit"] == pytest.approx(1.2, rel=0.02)
    assert found["m.acceleration_limit"] == pytest.approx(12.0, rel=0.15)
    assert error < 2e-3


def test_an_acceleration_limit_alone_is_found(tmp_path: Path) -> None:
    found, error = _found(tmp_path, speed=50.0, acceleration=6.0)
    assert "m.speed_limit" not in found
    assert found["m.acceleration_limit"] == pytest.approx(6.0, rel=0.03)
    assert error < 2e-3


def test_a_servo_without_limits_is_given_none(tmp_path: Path) -> None:
    found, error = _found(tmp_path, speed=1e6, acceleration=1e9)
    assert not {"m.speed_limit", "m.acceleration_limit"} & set(found)
    assert error < 3e-3


@pytest.mark.parametrize("distance", [0.05, -0.4, 2.0])
def test_a_limited_command_is_the_trapezoid_of_the_books(distance: float) -> None:
    step, place, pace = 1e-3, np.zeros((1, 1)), np.zeros((1, 1))
    out, told = np.empty((1, 3000, 1)), np.full((1, 3000, 1), distance)
    limited_commands(told, np.full((1, 1), 1.5), np.full((1, 1), 8.0), step, place, pace, out)
    exact = _way(distance, 1.5, 8.0, step * np.arange(1.0, 3001.0))
    assert np.abs(out[0, :, 0] - exact).max() < 3.0 * step * 1.5
    assert out[0, -1, 0] == pytest.approx(distance, abs=1e-9)


def test_a_drive_takes_a_controllers_commands_as_it_takes_recorded_ones(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(_ARM)
    told = {"delay": 0.02, "speed_limit": 1.2, "acceleration_limit": 9.0, "offset": 0.15}
    simulator = MujocoSimulator(load(path), *declare(load(path), [Declaration(n, nominal=v) for n, v in told.items()]))
    time = 0.01 * np.arange(150.0)
    steps = Channel("command", ("j",), "rad", time, np.where(time[:, None] < 0.5, 0.4, -0.3))
    start = Channel("position", ("j",), "rad", np.zeros(1), np.full((1, 1), 0.4))
    trial = Trial("steps", 0.0, 1.4, command=steps, observed={"position": Observed(("j",), "rad", time[:140])},
                  initial={"position": start})  # fmt: skip
    played = replace(trial, command=None, controller=lambda values: Playback(steps, len(values), period=0.01))
    recorded, asked = simulator.rollout([trial, played], simulator.parameters.nominal[None])
    np.testing.assert_allclose(asked.channels["position"], recorded.channels["position"], atol=1e-6)
    plain = MujocoSimulator(load(path)).rollout([trial], np.zeros((1, 0)))[0]
    assert np.abs(asked.channels["position"] - plain.channels["position"]).max() > 0.1


def test_a_limit_that_is_not_met_is_looked_at_where_it_would_be_alone(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(_ARM.replace('kv="2"', 'kv="2" forcerange="-60 60"'))
    log, model = _steps("jumps", (0.0, 0.3, -0.2), 2.0, 8.0), load(file)
    space, quantities = declare(model, [Declaration(n, ("m",)) for n in ("kp", "force_limit")], {})
    problem = Problem(MujocoSimulator(model, space, quantities), [log], Weighted.estimated([log], ["position"]))
    point, k = np.clip(space.to_unit(space.nominal), 0.0, 1.0), space.index("m.force_limit")
    places = np.linspace(point[k], 0.0, 20)[1:]
    rows = np.repeat(point[None], len(places), axis=0)
    rows[:, k] = places
    every, here = problem.residuals(space.from_unit(rows)), problem.residuals(space.from_unit(point[None]))[0]
    other = [not np.array_equal(r, here) for r in every]
    assert 0 < sum(other) < len(other), "at some of these places it is met"
    before = problem.evaluations
    met = met_beyond(problem, space, rows, here)
    assert np.array_equal(met[:, k], places[other])
    assert problem.evaluations - before <= 6
