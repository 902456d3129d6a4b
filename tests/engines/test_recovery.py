# SPDX-License-Identifier: Apache-2.0
"""Hidden truths are found again in recordings made by plain MuJoCo, a loop of its own around `mj_step`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.calibration import Calibration
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.inspection.alignment import clock_errors
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import DESCENT
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

STEP = 5e-4  # s
EVERY = 10  # steps between samples: 200 Hz
SETTLE = 1.0  # s of holding the first command before the recording begins
JOINTS = ("left_hip", "right_hip")
NOISE = 2e-4  # rad

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast" gravity="{gravity}"/>
  <default>
    <joint damping="{damping}" frictionloss="{friction}" armature="{armature}" solimpfriction="0.999 0.999 0.001"/>
    <position kp="{kp}"/>
  </default>
  <worldbody>
    <body name="left">
      <joint name="left_hip" axis="0 1 0"/>
      <inertial pos="{left_com}" mass="{mass}" diaginertia="{inertia}"/>{left_slack}
    </body>
    <body name="right" pos="0 0.3 0">
      <joint name="right_hip" axis="{right_axis}"/>
      <inertial pos="{right_com}" mass="{mass}" diaginertia="{inertia}"/>
    </body>
  </worldbody>
  <actuator>
    <position name="left_motor" joint="left_hip"/>
    <position name="right_motor" joint="right_hip"/>
  </actuator>
</mujoco>
"""
NOMINAL = {
    "gravity": "0 0 -9.81", "damping": 0.2, "friction": 0.05, "armature": 0.01, "kp": 15.0, "mass": 0.5,
    "inertia": "0.003 0.003 0.0006", "left_com": "0.1 0 0.02", "right_com": "0.1 0 0.02", "right_axis": "0.5 1 0",
    "left_slack": "",
}  # fmt: skip

Law = Callable[[Array, Array], Array]
"""(2,) command and (2,) measured joint angles to what the servo is told."""


def excitation(seed: int, duration: float = 5.0) -> Array:
    """(T, 2) commanded angles at each sample: a fast multisine on steps, so that delays and inertias show."""
    rng = np.random.default_rng(seed)
    time = STEP * EVERY * np.arange(round(duration / (STEP * EVERY)))
    frequency = rng.uniform(0.3, 3.0, (5, 2))
    waves = 0.25 * np.sin(2 * np.pi * frequency * time[:, None, None] + rng.uniform(0, 6, (5, 2))).sum(axis=1)
    jumps = rng.uniform(-0.5, 0.5, (int(duration), 2))[np.minimum(time.astype(int), int(duration) - 1)]
    return np.where(time[:, None] < 0.3, 0.0, waves + jumps)


def record(
    name: str, command: Array, *, delay: float = 0.0, bias: float = 0.0, sensor_delay: float = 0.0,
    law: Law | None = None, seed: int = 0, noise: float = NOISE, **truth: object,
) -> Recording:  # fmt: skip
    """Simulates the truth with plain `mj_step` from rest; a position is the joint angle with its slack, if any."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**{**NOMINAL, **truth}))
    model.opt.timestep = STEP
    data = mujoco.MjData(model)
    hips = [model.joint(j).qposadr[0] for j in JOINTS]
    slack = [i for i in range(model.nq) if i not in hips]
    before = round(SETTLE / STEP)
    angles = np.empty((before + len(command) * EVERY, 2))
    for k in range(len(angles)):
        angles[k] = data.qpos[hips]
        if slack:
            angles[k, 0] += data.qpos[slack[0]]
        sample = max(0, int(np.floor(((k - before) * STEP - delay) / (STEP * EVERY) + 1e-9)))
        data.ctrl[:] = command[sample] if law is None else law(command[sample], angles[k])
        mujoco.mj_step(model, data)
    time = STEP * EVERY * np.arange(len(command), dtype=np.float64)
    clock = STEP * (np.arange(len(angles)) - before)
    seen = np.stack([np.interp(time - sensor_delay, clock, a) for a in angles.T], axis=1)
    seen = seen + bias + noise * np.random.default_rng(seed + 100).standard_normal(seen.shape)
    channels = {
        "command": Channel("command", JOINTS, "rad", time, command),
        "position": Channel("position", JOINTS, "rad", time, seen),
    }
    return Recording(name, channels)


def found(
    folder: Path, lines: Sequence[Declaration], recordings: Sequence[Recording],
    extra: dict[str, tuple[str, ...]] | None = None, select: bool = False, step: float = 0.001, **nominal: object,
) -> tuple[dict[str, float], Calibration]:  # fmt: skip
    """The calibrated values by name, starting from the nominal model."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(**{**NOMINAL, **nominal}), encoding="utf-8")
    model = load(path)
    space, quantities = declare(model, lines, extra)
    result = calibrate(
        MujocoSimulator(model, space, quantities, step=step),
        recordings,
        options=Options(select=select, cross_validate=False, stages=DESCENT),
    )
    return {e.name: e.value for e in result.estimates}, result


def pair(seed: int = 0, seconds: float = 3.0, **truth: object) -> list[Recording]:
    """Two recordings of different motions and lengths."""
    return [record(f"r{i}", excitation(10 * seed + i, seconds - i), seed=i, **truth) for i in range(2)]  # type: ignore[arg-type]


@pytest.mark.parametrize("delay", [0.0035, 0.0291])
def test_a_command_delay_is_found_within_half_a_millisecond(tmp_path: Path, delay: float) -> None:
    lines = [Declaration("delay", tie="all"), Declaration("kp", tie="all"), Declaration("damping", tie="all")]
    values, _ = found(tmp_path, lines, pair(delay=delay, kp=22.0, damping=0.3), step=5e-4)
    assert values["delay"] == pytest.approx(delay, abs=5e-4)
    assert values["kp"] == pytest.approx(22.0, rel=0.02)


def test_a_sensor_delay_is_found_within_half_a_millisecond(tmp_path: Path) -> None:
    lines = [Declaration("sensor_delay", ("position",)), Declaration("damping", tie="all")]
    values, _ = found(tmp_path, lines, pair(sensor_delay=0.0123), {"channel": ("position",)})
    assert values["position.sensor_delay"] == pytest.approx(0.0123, abs=5e-4)


def test_commands_stamped_by_another_clock_are_noticed_and_set_right(tmp_path: Path) -> None:
    wrong, right = pair(seconds=4.0, delay=0.012, kp=22.0, damping=0.3)
    command = wrong.channel("command")
    for late in (0.3, -0.6):
        mixed = [right, wrong.with_channel(command.replace(time=command.time + late))]
        clocks = clock_errors(mixed)
        assert list(clocks) == ["r0"]
        assert clocks["r0"] == pytest.approx(late, abs=0.02)
    lines = [Declaration("clock", ("r0",), nominal=clocks["r0"]), Declaration("delay", tie="all"),
             Declaration("kp", tie="all"), Declaration("damping", tie="all")]  # fmt: skip
    values, _ = found(tmp_path, lines, mixed, {"recording": ("r0", "r1")}, step=1e-3)
    assert values["r0.clock"] == pytest.approx(late, abs=1e-3)
    assert values["delay"] == pytest.approx(0.012, abs=1e-3)
    assert values["kp"] == pytest.approx(22.0, rel=0.02)


SLACK = """
      <joint name="slop" axis="0 1 0" limited="true" range="-{half} {half}" armature="2e-4" damping="0.01"
             solreflimit="0.006 1" solimplimit="0.95 0.99 0.0005"/>"""


def test_backlash_is_found_within_a_tenth(tmp_path: Path) -> None:
    backlash = 0.02
    recordings = pair(left_slack=SLACK.format(half=backlash / 2), kp=20.0)
    lines = [Declaration("backlash", ("left_hip",)), Declaration("kp", tie="all")]
    values, _ = found(tmp_path, lines, recordings)
    assert values["left_hip.backlash"] == pytest.approx(backlash, rel=0.1)


def test_dead_bands_are_found_within_a_tenth(tmp_path: Path) -> None:
    bands = np.array([0.02, 0.06])

    def law(command: Array, position: Array) -> Array:
        error = command - position
        return position + np.sign(error) * np.maximum(np.abs(error) - bands / 2, 0.0)

    lines = [Declaration("dead_band"), Declaration("kp", tie="all")]
    values, _ = found(tmp_path, lines, pair(seconds=2.5, law=law, kp=20.0), step=STEP)
    assert [values[f"{side}_motor.dead_band"] for side in ("left", "right")] == pytest.approx(bands, rel=0.1)
    assert values["kp"] == pytest.approx(20.0, rel=0.02)


def test_a_sensor_bias_is_found_within_a_milliradian(tmp_path: Path) -> None:
    values, _ = found(tmp_path, [Declaration("bias"), Declaration("kp", tie="all")], pair(bias=0.031, kp=18.0))
    assert values["left_hip.bias"] == pytest.approx(0.031, abs=1e-3)
    assert values["right_hip.bias"] == pytest.approx(0.031, abs=1e-3)


def test_a_tilted_base_is_found_within_a_milliradian(tmp_path: Path) -> None:
    roll, pitch = 0.06, -0.09
    tilted = np.array([0.0, 9.81 * np.sin(roll), -9.81 * np.cos(roll)])
    gravity = (np.cos(pitch) * tilted[0] + np.sin(pitch) * tilted[2], tilted[1],
               -np.sin(pitch) * tilted[0] + np.cos(pitch) * tilted[2])  # fmt: skip
    recordings = pair(gravity=" ".join(f"{g:.9f}" for g in gravity))
    values, _ = found(tmp_path, [Declaration("tilt_roll"), Declaration("tilt_pitch")], recordings, step=STEP)
    assert values["tilt_pitch"] == pytest.approx(pitch, abs=1e-3)
    assert values["tilt_roll"] == pytest.approx(roll, abs=2e-3)  # seen by the slanted joint only


def test_mass_and_centre_of_mass_are_found(tmp_path: Path) -> None:
    # A planar link shows m x, m z and its inertia; the servo's known stiffness gives the scale.
    recordings = pair(mass=0.62, inertia="0.00372 0.00372 0.000744", left_com="0.13 0 0.045")
    lines = [Declaration("mass", ("left+right",)), Declaration("com_x", ("left",)), Declaration("com_z", ("left",))]
    values, _ = found(tmp_path, lines, recordings)
    assert values["left+right.mass"] == pytest.approx(0.62, rel=0.015)
    assert values["left.com_x"] == pytest.approx(0.13, abs=2e-3)
    assert values["left.com_z"] == pytest.approx(0.045, abs=2e-3)


def test_the_full_inertia_found_moves_like_the_truth_and_is_physical(tmp_path: Path) -> None:
    recordings = pair(seconds=4.0, inertia="0.0045 0.0052 0.0011", mass=0.56)
    lines = [Declaration(f"inertia_{c}", ("left+right",)) for c in
             ("alpha", "d1", "d2", "d3", "s12", "s23", "s13", "t1", "t2", "t3")]  # fmt: skip
    _, result = found(tmp_path, lines, recordings, select=True, step=STEP)
    for replay in result.training():
        assert replay.rmse_after().max() < 1.2 * NOISE


def test_tied_joints_share_one_value_and_mirrored_sides_share_theirs(tmp_path: Path) -> None:
    recordings = pair(damping=0.35, left_com="0.1 0.02 0.02", right_com="0.1 -0.02 0.02", right_axis="-0.5 1 0")
    start = {"left_com": "0.1 0.005 0.02", "right_com": "0.1 -0.005 0.02", "right_axis": "-0.5 1 0"}
    lines = [Declaration("damping", tie="mirror"), Declaration("com_y", tie="mirror", lower=-0.1, upper=0.1)]
    values, result = found(tmp_path, lines, recordings, **start)  # type: ignore[arg-type]
    assert len(result.estimates) == 2
    assert values["left_hip+right_hip.damping"] == pytest.approx(0.35, rel=0.02)
    assert values["left+right.com_y"] == pytest.approx(0.02, abs=2e-3)


@pytest.fixture(scope="module")
def on_the_move() -> Recording:
    """A recording that begins in the middle of a fast motion."""
    whole = record("r", excitation(3), kp=24.0)
    speed = np.abs(np.diff(whole.channel("position").values, axis=0)).max(axis=1)
    return whole.slice(float(whole.time[200 + int(speed[200:600].argmax())]), 5.0)


def test_a_start_on_the_move_is_estimated(tmp_path: Path, on_the_move: Recording) -> None:
    values, _ = found(tmp_path, [Declaration("kp", tie="all")], [on_the_move], step=STEP)
    assert values["kp"] == pytest.approx(24.0, rel=0.01)


def test_a_start_corrected_as_a_parameter_is_exact(tmp_path: Path, on_the_move: Recording) -> None:
    lines = [Declaration("kp", tie="all"), Declaration("start_position"), Declaration("start_velocity")]
    extra = {"recording": ("r",)}
    values, result = found(tmp_path, lines, [on_the_move], extra, step=STEP)
    assert values["kp"] == pytest.approx(24.0, rel=0.003)
    assert result.training()[0].rmse_after().max() < 1.1 * NOISE


def test_joint_friction_and_armature_are_found(tmp_path: Path) -> None:
    lines = [Declaration("friction", tie="all"), Declaration("armature", tie="all"), Declaration("damping", tie="all")]
    values, _ = found(tmp_path, lines, pair(friction=0.12, armature=0.02, damping=0.1), step=STEP)
    assert values["friction"] == pytest.approx(0.12, rel=0.02)
    assert values["armature"] == pytest.approx(0.02, rel=0.02)
    assert values["damping"] == pytest.approx(0.1, rel=0.05)
