# SPDX-License-Identifier: Apache-2.0
"""A controller that feeds the speed of its reference forward is found by itself, and is not claimed where there is none."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.leading import paces
from trueup.calibration import Calibration
from trueup.controllers.playback import Playback
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

HINGE = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" armature=".02" frictionloss=".05" solimpfriction=".999 .999 .001"/>
<inertial pos="0 0 -.2" mass=".8" diaginertia="2e-3 2e-3 2e-3"/></body></worldbody>
<actuator><position name="m" joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
SLIDE = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>
<joint name="j" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="2" diaginertia="2e-3 2e-3 2e-3"/></body></worldbody>
<actuator><position name="m" joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
ARMS = {"hinge": (HINGE, 40.0, 2.4, "rad"), "slide": (SLIDE, 800.0, 64.0, "m")}
NOISE = 2e-4  # rad or m


def reference(time: Array, seed: int) -> tuple[Array, Array]:
    """Waves that begin at rest, and their speed."""
    w, a = np.array([0.9, 2.3, 5.1]) * (1.0 + 0.1 * seed), np.array([0.3, 0.15, 0.06])
    x = np.outer(time, w)
    return (1.0 - np.cos(x)) @ a, np.sin(x) @ (a * w)


def recorded(kind: str, seed: int, fed: float, logged: bool) -> Recording:
    """A PD controller kp (q_des - q) + kd (fed qd_des - qd) that is told anew each 10 ms, one `mj_step` after the other."""
    xml, kp, kv, unit = ARMS[kind]
    model = mujoco.MjModel.from_xml_string(xml.format(step="1e-3", kp=kp, kv=kv))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    time = np.arange(0.0, 6.0, 0.001)
    wanted, pace = reference(time, seed)
    for _ in range(3000):
        mujoco.mj_step(model, data)
    seen = np.empty(len(time))
    for k in range(len(time)):
        seen[k] = data.qpos[0]
        told = k - k % 10
        data.ctrl[0] = wanted[told] + fed * kv / kp * pace[told]
        mujoco.mj_step(model, data)
    parts = {"command": wanted, "position": seen + NOISE * rng.standard_normal(len(seen))}
    parts |= {"command_velocity": pace} if logged else {}
    units = {"command_velocity": f"{unit}/s"}
    channels = {n: Channel(n, ("j",), units.get(n, unit), time[::10], v[::10, None]) for n, v in parts.items()}
    return Recording(f"log{seed}", channels)


def found(folder: Path, kind: str, *, fed: float = 1.0, logged: bool = False) -> tuple[Preparation, Calibration, float]:
    """A calibration of what it proposes itself, and its error on a motion that it has not seen."""
    path = folder / "arm.xml"
    path.write_text(ARMS[kind][0].format(step="2e-3", kp=0.5 * ARMS[kind][1], kv=0.5 * ARMS[kind][2]))
    logs = [recorded(kind, seed, fed, logged) for seed in range(3)]
    ready = prepare(path, logs[:2], logs[2:])
    done = ready.calibrate(Options(cross_validate=False, lacking=False, stages=DESCENT))
    (replay,) = done.held_out()
    return ready, done, float(np.sqrt(np.mean((replay.after - replay.measured) ** 2)))


@pytest.mark.parametrize(("kind", "logged"), [("hinge", False), ("slide", False), ("hinge", True)])
def test_a_speed_that_is_fed_forward_is_found_as_damping_by_stiffness(tmp_path: Path, kind: str, logged: bool) -> None:
    _, kp, kv, _ = ARMS[kind]
    ready, done, error = found(tmp_path, kind, logged=logged)
    lead = next(e for e in done.estimates if e.name.endswith("lead"))
    assert lead.fitted
    assert lead.value == pytest.approx(kv / kp, rel=0.03)
    assert error < 1.2 * NOISE
    said = " ".join(ready.write(done, tmp_path / "out.xml", tmp_path / "parameters.toml"))
    assert "lead of the command" in said
    assert "parameters.toml" in said
    assert "np.gradient(commands, times, axis=0)" in " ".join(ready.usage(done, tmp_path / "out.xml"))


def test_a_servo_that_knows_no_speed_is_given_no_lead(tmp_path: Path) -> None:
    """Though the log says the reference's speed."""
    ready, done, error = found(tmp_path, "hinge", fed=0.0, logged=True)
    lead = next(e for e in done.estimates if e.name.endswith("lead"))
    assert not lead.fitted
    assert lead.value == 0.0
    assert error < 1.2 * NOISE
    assert "np.gradient" not in " ".join(ready.usage(done, tmp_path / "out.xml"))


def test_a_speed_that_is_commanded_as_a_limit_leads_nothing() -> None:
    log = recorded("hinge", 1, 1.0, logged=False)
    limit = Channel("command_velocity", ("j",), "rad/s", log.time, np.full((len(log.time), 1), 2.0))
    trial = Trial.of(log.with_channel(limit))
    assert trial.command is not None
    np.testing.assert_allclose(
        paces(trial.command, trial.pace), np.gradient(trial.command.values, trial.command.time, axis=0)
    )


def test_a_controller_in_the_simulation_leads_as_a_recorded_command_does(tmp_path: Path) -> None:
    """But for what it does not know yet: the speed after its last command."""
    ready, done, _ = found(tmp_path, "hinge")
    trial = Trial.of(ready.hold_out[0])
    assert trial.command is not None
    command = trial.command
    simulator, values = ready.simulator, np.array([e.value for e in done.estimates])[None]
    (told,) = simulator.rollout([trial], values)
    (played,) = simulator.rollout(
        [trial], values, lambda rows: Playback(command, len(rows), period=0.01, start=trial.start)
    )
    apart = told.channels["position"] - played.channels["position"]
    assert np.abs(apart).max() < 0.01 * np.abs(told.channels["position"]).max()
