# SPDX-License-Identifier: Apache-2.0
"""A load that a late camera watches beside a trolley's encoder: how late it is seen is found, and told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.own_sensors import OWN_SENSOR
from trueup.engines.mujoco.setup.proposal import propose
from trueup.engines.mujoco.writing.notes import about_sensors
from trueup.inspection.scattered import gathered
from trueup.loop.calibrate import Options, calibrate
from trueup.recording import Channel, Recording
from trueup.trial import Trial

LATE = 0.065
CRANE = """
<mujoco model="crane"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body><joint name="trolley" type="slide" axis="1 0 0" damping="2"/><geom type="box" size=".1 .08 .04" mass="4"/>
    <body><joint name="sway" axis="0 1 0" damping=".01"/><geom type="sphere" size=".05" pos="0 0 -.6" mass="1"/></body>
  </body></worldbody>
  <actuator><position joint="trolley" kp="{kp}" kv="{kv}"/></actuator></mujoco>
"""


def crane(folder: Path) -> Model:
    """As its maker says it is; the one that is recorded is another."""
    path = folder / "crane.xml"
    path.write_text(CRANE.format(kp=3000, kv=120), encoding="utf-8")
    return load(path)


def recorded(seed: int, late: float, *, apart: bool = True, duration: float = 8.0, pushed: float = 0.0) -> Recording:
    """One run by plain `mj_step`: the trolley at 100 Hz, the sway at 30 Hz in a channel of its own, `late` s after it was so;
    or both at 100 Hz in one channel.
    """
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(CRANE.format(kp=2100, kv=160))
    model.opt.timestep = 0.001
    data = mujoco.MjData(model)
    data.qvel[1] = pushed
    time = 0.01 * np.arange(round(100 * duration), dtype=np.float64)
    goals = rng.uniform(-0.5, 0.5, round(duration / 2) + 1)
    goals[0] = 0.0
    goal = np.convolve(np.repeat(goals, 200)[: len(time)], np.ones(60) / 60)[: len(time)]
    states = []
    for at in goal.repeat(10):
        states.append(data.qpos.copy())
        data.ctrl[0] = at
        mujoco.mj_step(model, data)
    clock, moved = 0.001 * np.arange(len(states), dtype=np.float64), np.array(states)
    seen = moved[::10] + rng.normal(0.0, [5e-5, 1e-3], (len(time), 2))
    command = Channel("command", ("trolley",), "m", time, goal)
    if not apart:
        both = Channel("position", ("trolley", "sway"), "m", time, seen, units=("m", "rad"))
        return Recording(f"r{seed}", {"command": command, "position": both})
    frames = 0.004 + np.arange(round(30 * duration) - 2, dtype=np.float64) / 30.0
    images = np.interp(frames - late, clock, moved[:, 1]) + rng.normal(0.0, 1e-3, len(frames))
    camera = Channel("position_camera", ("sway",), "rad", frames, images)
    position = Channel("position", ("trolley",), "m", time, seen[:, :1])
    return Recording(f"r{seed}", {"command": command, "position": position, "position_camera": camera})


def taken(recordings: Sequence[Recording]) -> list[Recording]:
    return gathered(recordings, ("trolley", "sway"))[0]


SOME = ("kp", "kv", "damping", "delay", "joint_sensor_delay")


def simulator(model: Model, lines: Sequence[Declaration]) -> MujocoSimulator:
    return MujocoSimulator(model, *declare(model, lines))


def test_what_a_joints_own_sensor_tells_is_what_was_so_before_and_the_others_are_as_they_were(tmp_path: Path) -> None:
    model = crane(tmp_path)
    (run,) = taken([recorded(1, 0.0)])
    trial = Trial.of(run)
    late = simulator(model, [Declaration("joint_sensor_delay", ("sway",), nominal=0.0)])
    (done,) = late.rollout([trial], np.array([[0.0], [0.05], [-0.05]]))
    now, later, earlier = done.channels["position"]
    np.testing.assert_allclose([later[:, 0], earlier[:, 0]], [now[:, 0]] * 2, atol=1e-5)  # but for where the sway began
    assert np.abs(later[5:, 1] - now[5:, 1]).max() > 0.05
    np.testing.assert_allclose(later[5:, 1], now[:-5, 1], atol=2e-3)
    np.testing.assert_allclose(earlier[:-5, 1], now[5:, 1], atol=2e-3)


def test_a_run_that_begins_amid_a_swing_begins_where_its_late_sensor_saw_it_later(tmp_path: Path) -> None:
    model = crane(tmp_path)
    (run,) = taken([recorded(1, LATE, pushed=1.0).slice(0.5, 2.0)])  # before the trolley is told to move
    trial = Trial.of(run)
    made = simulator(model, [Declaration("joint_sensor_delay", ("sway",))])
    (done,) = made.rollout([trial], np.array([[0.0], [LATE]]))
    seen = run.channel("position").column("sway")
    off = np.nanstd(done.channels["position"][1, :, 1] - seen)
    assert off < 3e-3 < 0.1 * np.nanstd(seen)


def test_only_joints_that_were_logged_apart_are_asked_how_late_they_are_seen(tmp_path: Path) -> None:
    model = crane(tmp_path)
    together, apart = [recorded(1, 0.0, apart=False)], taken([recorded(1, LATE)])
    assert not [d for d in propose(model, together) if d.quantity == "joint_sensor_delay"]
    (line,) = [d for d in propose(model, apart) if d.quantity == "joint_sensor_delay"]
    assert (line.of, line.optional) == (("sway",), OWN_SENSOR)


def test_how_late_a_camera_is_is_found_and_told_and_the_servo_is_not_bent_to_it(tmp_path: Path) -> None:
    model = crane(tmp_path)
    runs = taken([recorded(seed, LATE) for seed in (1, 2)])
    made = simulator(model, [d for d in propose(model, runs) if d.quantity in SOME])
    fit = calibrate(made, runs, options=Options(cross_validate=False, lacking=False))
    found = {e.name: e for e in fit.estimates}
    assert found["sway.joint_sensor_delay"].value == pytest.approx(LATE, abs=0.003)
    assert found["trolley.kp"].value == pytest.approx(2100.0, rel=0.05)
    (note,) = about_sensors(made, fit)
    assert "sway was logged by a sensor of its own" in note
    assert "too late" in note


def test_a_camera_that_is_not_late_is_left_as_it_is(tmp_path: Path) -> None:
    model = crane(tmp_path)
    runs = taken([recorded(seed, 0.0) for seed in (1, 2)])
    made = simulator(model, [d for d in propose(model, runs) if d.quantity in SOME])
    fit = calibrate(made, runs, options=Options(cross_validate=False, lacking=False))
    assert not about_sensors(made, fit)


SWUNG = """
<mujoco model="swung"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body><joint name="turn" axis="0 0 1" damping=".05"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
    <site name="board" pos=".3 0 0"/></body></worldbody>
  <actuator><position joint="turn" kp="{kp}" kv=".6"/></actuator>
  <sensor><gyro name="rates" site="board"/><accelerometer name="forces" site="board"/></sensor></mujoco>
"""


def swung(seed: int, late: float) -> Recording:
    """An arm told to turn, its encoder at 100 Hz, and a board at 200 Hz that tells `late` s after it was so."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(SWUNG.format(kp=22))
    model.opt.timestep = 0.0005
    data, time = mujoco.MjData(model), 0.01 * np.arange(500, dtype=np.float64)
    goal = np.convolve(np.repeat(rng.uniform(-0.6, 0.6, 11), 50), np.ones(12) / 12)[: len(time)] * np.minimum(1.0, time)
    states = []
    for at in goal.repeat(20):
        data.ctrl[0] = at
        mujoco.mj_step(model, data)
        states.append([data.qpos[0], *data.sensordata])
    clock, seen = 0.0005 * np.arange(len(states), dtype=np.float64), np.array(states)
    asked = 0.0021 + 0.005 * np.arange(990, dtype=np.float64)
    board = np.stack([np.interp(asked - late, clock, column) for column in seen.T[1:]], axis=1)
    board += rng.normal(0.0, np.repeat([0.005, 0.05], 3), board.shape)
    angle = np.interp(time, clock, seen[:, 0]) + rng.normal(0.0, 2e-4, len(time))
    return Recording(f"r{seed}", {
        "command": Channel("command", ("turn",), "rad", time, goal),
        "position": Channel("position", ("turn",), "rad", time, angle),
        "rates": Channel("rates", tuple(f"rates.{a}" for a in "xyz"), "rad/s", asked, board[:, :3]),
        "forces": Channel("forces", tuple(f"forces.{a}" for a in "xyz"), "m/s^2", asked, board[:, 3:]),
    })  # fmt: skip


@pytest.mark.parametrize("late", [0.008, -0.006])
def test_a_board_that_tells_late_or_early_does_not_bend_the_drive_to_it(tmp_path: Path, late: float) -> None:
    (tmp_path / "swung.xml").write_text(SWUNG.format(kp=30), encoding="utf-8")
    model, runs = load(tmp_path / "swung.xml"), [swung(seed, late) for seed in (1, 2)]
    lines = [d for d in propose(model, runs) if d.quantity in ("kp", "damping", "delay", "sensor_delay")]
    made = MujocoSimulator(model, *declare(model, lines, {"channel": ("rates", "forces")}))
    fit = calibrate(made, runs, options=Options(cross_validate=False, lacking=False))
    found = {e.name: e for e in fit.estimates}
    assert found["rates+forces.sensor_delay"].value == pytest.approx(late, abs=0.001)
    assert found["delay"].value < 0.003
    assert found["turn.kp"].value == pytest.approx(22.0, rel=0.03)
    (note,) = about_sensors(made, fit)
    assert (
        f"tells {1e3 * abs(found['rates+forces.sensor_delay'].value):.3g} ms too {'late' if late > 0 else 'early'}"
        in note
    )
