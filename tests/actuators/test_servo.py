# SPDX-License-Identifier: Apache-2.0
"""A servo's law moves the same load in the same way wherever it is used, and does what physics says."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from trueup.actuators.actuator import HARD, mjcf_text, python_text, replay_file
from trueup.actuators.bench import Bench, runs_of
from trueup.actuators.experiment import Experiment
from trueup.actuators.identify import Actuator
from trueup.actuators.replay import replay
from trueup.actuators.servo import Law, Servo
from trueup.actuators.simulated import servo_quantity
from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load as load_file
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.recording import Channel, Recording
from trueup.trial import Trial

STEP = 0.002
BENCH = Bench(mass=0.4, length=0.1, inertia=3e-4, hangs_at=0.2)
RICH = Law(
    stiffness=2.0, armature=2e-3, back_emf=0.04, coulomb=0.01, viscous=3e-3, quadratic=1e-3, static=0.02, stribeck_speed=0.1,
    load_motor=0.15, load_external=0.1, load_static=0.1, voltage_limit=1.2, sag=0.1, dead_band=0.01, punch=0.02,
    derivative=0.004, integral=0.5, zero=0.01, delay=0.007, speed_limit=8.0, acceleration_limit=80.0,
)  # fmt: skip


def recording(command: np.ndarray, step: float = STEP) -> Recording:
    """Commands on the grid of the simulation; NaN switches the motor off. Positions are of no matter but the first."""
    time = np.arange(len(command), dtype=np.float64) * step
    channels = {
        "command": Channel("command", ("joint",), "rad", time, command[:, None]),
        "position": Channel("position", ("joint",), "rad", time, np.zeros((len(time), 1))),
    }
    return Recording("bench", channels)


def swinging(seconds: float = 3.0) -> np.ndarray:
    time = STEP * np.arange(round(seconds / STEP))
    command = np.where(time < 1.5, np.sign(np.sin(5.0 * time)), 1.2 * np.sin(9.0 * time))
    command[(time > 2.2) & (time < 2.5)] = np.nan
    return command


def delivered(law: Law, folder: Path) -> ModuleType:
    """The file that a user is given, loaded from where it lies."""
    nothing = Experiment((), (), 0.0, ())
    found = Actuator(law, law, (), (), (), nothing, (), (), BENCH, 400.0, STEP, (), 0.0)
    path = folder / "actuator.py"
    path.write_text(python_text(found), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("actuator", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rig(law: Law, bench: Bench) -> str:
    return f"""<mujoco><option timestep="{STEP}" integrator="implicitfast"/><worldbody><body>
      <joint name="joint" axis="0 1 0" ref="{math.degrees(bench.hangs_at)}" armature="{law.armature}" {HARD}/>
      <inertial pos="0 0 {-bench.length}" mass="{bench.mass}" diaginertia="{bench.inertia} {bench.inertia} {bench.inertia}"/>
      </body></worldbody><actuator><motor name="joint" joint="joint"/></actuator></mujoco>"""


def in_mujoco(servo: Servo, command: np.ndarray, bench: Bench) -> np.ndarray:
    """The ten lines of the delivered file's docstring."""
    model = mujoco.MjModel.from_xml_string(rig(servo.law, bench))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.0
    servo.reset(data.qpos[0])
    mujoco.mj_forward(model, data)
    out = []
    for wanted in command:
        out.append(data.qpos[0])
        servo.step(wanted, data.qpos[0], data.qvel[0], model.opt.timestep, -data.qfrc_bias[0])
        data.ctrl[0] = servo.torque
        model.dof_damping[0], model.dof_frictionloss[0] = servo.damping, servo.friction
        mujoco.mj_step(model, data)
    return np.array(out)


@pytest.mark.parametrize(
    "law", [RICH, Law(2.0, 2e-3, 0.04, 0.05), Law(2.0, 2e-3, 0.04, force_limit=0.3)], ids=["rich", "plain", "force"]
)
def test_the_delivered_file_moves_plain_mujoco_as_trueup_replays(law: Law, tmp_path: Path) -> None:
    command = swinging()
    (run,), _, _ = runs_of([recording(command)], BENCH)
    ours = replay(law, run, STEP)
    theirs = in_mujoco(delivered(law, tmp_path).Servo(), command, BENCH)
    assert np.ptp(ours) > 0.5
    np.testing.assert_allclose(theirs, ours, atol=2e-4)


def test_the_delivered_file_needs_nothing_but_python(tmp_path: Path) -> None:
    delivered(RICH, tmp_path)
    code = f"""import sys; sys.path.insert(0, {str(tmp_path)!r}); import actuator; servo = actuator.Servo()
for _ in range(50): servo.step(1.0, 0.0, 0.0, 0.002)
print(servo.torque, "numpy" in sys.modules)"""
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    torque, numpy = done.stdout.split()
    assert 0.0 < float(torque) <= RICH.voltage_limit
    assert numpy == "False"


@pytest.mark.parametrize(
    ("more", "apart"),
    [({}, 2e-4), ({"punch": 0.05}, 5e-3), ({"delay": 0.0123}, 2e-4), ({"force_limit": 0.3, "back_emf": 0.0}, 2e-4),
     ({"zero": 0.1, "delay": 0.01}, 2e-4), ({"quadratic": 0.02}, 2e-4), ({"zero": 0.1, "delay": 0.01, "punch": 0.05}, 5e-3)],
    ids=lambda x: "+".join(x) if isinstance(x, dict) else "",
)  # fmt: skip
def test_the_written_mjcf_moves_as_its_law(more: dict[str, float], apart: float, tmp_path: Path) -> None:
    plain = Law(2.0, 2e-3, 0.05, 0.03, voltage_limit=1.0)
    law = plain._replace(**more)
    command = swinging(2.0)
    (run,), _, _ = runs_of([recording(command)], BENCH)
    run = dataclasses.replace(run, gain=0.5)
    if more:
        assert np.max(np.abs(replay(plain, run, STEP) - replay(law, run, STEP))) >= 2.0 * apart
    path = tmp_path / "actuator.xml"
    path.write_text(mjcf_text(law, BENCH, STEP), encoding="utf-8")
    np.testing.assert_allclose(replay_file(path, run), replay(law, run, STEP, file=True), atol=apart)


def test_the_voltage_limit_sets_the_speed_that_a_motor_reaches() -> None:
    law = Law(5.0, 1e-3, back_emf=0.05, voltage_limit=0.5)
    (run,), _, _ = runs_of([recording(np.full(1500, 100.0))], Bench(inertia=1e-3))
    speed = np.diff(replay(law, run, STEP)) / STEP
    assert speed[-1] == pytest.approx(0.5 / 0.05, rel=1e-3)


def test_friction_holds_a_load_that_is_lighter_than_it_and_no_other() -> None:
    top = BENCH.moment
    for coulomb, holds in ((1.02 * top, True), (0.9 * top, False)):
        law = Law(1e-9, 1e-3, coulomb=coulomb)
        start = Bench(BENCH.mass, BENCH.length, BENCH.inertia, hangs_at=-math.pi / 2)  # held out level
        (run,), _, _ = runs_of([recording(np.zeros(500))], start)
        assert (abs(replay(law, run, STEP)[-1]) < 1e-3) == holds


def test_energy_never_grows_while_the_motor_is_off() -> None:
    law = Law(2.0, 1e-3, coulomb=0.01, viscous=2e-3, load_external=0.1)
    command = np.full(2000, np.nan)
    command[0] = 0.0
    (run,), _, _ = runs_of([recording(command)], Bench(0.4, 0.1, hangs_at=1.5))
    q = replay(law, run, STEP)
    swing = np.abs(q - 1.5)
    peaks = swing[1:-1][(swing[1:-1] >= swing[:-2]) & (swing[1:-1] > swing[2:])]
    assert len(peaks) > 3
    assert np.all(np.diff(peaks) < 0.0)


def test_a_gain_half_as_high_pulls_half_as_much() -> None:
    pulls = []
    for gain in (1.0, 0.5):
        servo = Servo(Law(2.0), gain)
        servo.reset(0.0)
        for _ in range(2):
            servo.step(0.3, 0.0, 0.0, STEP)
        pulls.append(servo.torque)
    assert pulls == [pytest.approx(0.6), pytest.approx(0.3)]


def test_firmware_that_damps_by_a_ratio_does_so_by_the_root_of_its_gain() -> None:
    pulls = []
    for gain in (1.0, 0.25):
        servo = Servo(Law(2.0, rate_gain=0.2), gain)
        servo.reset(0.0)
        servo.step(0.0, 0.0, 1.0, STEP)
        pulls.append(servo.torque - servo.damping)  # half is left to the engine
    assert pulls == [pytest.approx(-0.2), pytest.approx(-0.1)]


def test_trueups_own_simulator_moves_as_the_replay(tmp_path: Path) -> None:
    command = swinging()
    command[np.isnan(command)] = 0.3
    recorded = recording(command)
    (run,), _, _ = runs_of([recorded], BENCH)
    path = tmp_path / "rig.xml"
    path.write_text(rig(RICH, BENCH), encoding="utf-8")
    model = load_file(path)
    servos = declare(model, [Declaration(servo_quantity(RICH), ("*",))])
    simulator = MujocoSimulator(model, *servos, step=STEP)
    trial = Trial.of(recorded)
    (seen,) = simulator.rollout([trial], np.array([[1.0], [0.5]]))
    for row, gain in enumerate((1.0, 0.5)):
        ours = replay(RICH, dataclasses.replace(run, gain=gain), STEP)
        np.testing.assert_allclose(seen.channels["position"][row, :, 0], ours, atol=1e-3)
