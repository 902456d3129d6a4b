# SPDX-License-Identifier: Apache-2.0
"""Torques that a controller adds gravity compensation to: seen by inverse dynamics, and simulated so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.gravity import of_held_weight
from trueup.engines.mujoco.writing.write import write_model
from trueup.loop.calibrate import Options
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording

ARM = """<mujoco><!-- kept --><option timestep=".002" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"{}/><geom type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="{}"/>
<body name="lower" pos=".4 0 0"><joint name="elbow" axis="0 1 0"{}/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1.5"/></body></body></worldbody>
<actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="elbow"/></actuator></mujoco>"""
PLAIN = ARM.format("", 3, "")
NAMELESS = PLAIN.replace(' name="upper"', "")
TRUTH = ARM.format(
    ' frictionloss=".5" damping=".6" armature=".1"', 3.3, ' frictionloss=".3" damping=".4" armature=".05"'
)
"""10 % heavier than what the controller holds."""


def _ready(folder: Path, text: str, log: Recording, refuse: Sequence[str] = ()) -> tuple[Preparation, MujocoSimulator]:
    path = folder / "arm.xml"
    path.write_text(text)
    ready = prepare(path, [log], refuse=refuse)
    assert isinstance(ready.simulator, MujocoSimulator)
    return ready, ready.simulator


def _log(*, held: bool, scale: float = 1.0) -> Recording:
    """Five seconds near level at 100 Hz, where the arm's weight is nearly constant; `held` by the controller."""
    model, plain = mujoco.MjModel.from_xml_string(TRUTH), mujoco.MjModel.from_xml_string(PLAIN)
    data, own, rows, told = mujoco.MjData(model), mujoco.MjData(plain), [], np.zeros(2)
    rng = np.random.default_rng(0)
    for k in range(2500):
        own.qpos[:] = data.qpos
        mujoco.mj_forward(plain, own)
        if k % 5 == 0:
            wanted = 0.5 * np.sin(np.array([2.2, 3.1]) * data.time)
            told = np.array([60.0, 30.0]) * (wanted - data.qpos) - np.array([6.0, 3.0]) * data.qvel
            rows.append(
                [data.time, *(data.qpos + rng.normal(0.0, 1e-4, 2)), *(told + (0.0 if held else own.qfrc_bias))]
            )
        data.ctrl[:] = told + own.qfrc_bias
        mujoco.mj_step(model, data)
    time, seen, torque = np.split(np.array(rows), [1, 3], axis=1)
    return Recording("log", {
        "position": Channel("position", ("shoulder", "elbow"), "rad", time[:, 0], seen),
        "command_torque": Channel("command_torque", ("m1", "m2"), "N m", time[:, 0], scale * torque),
    })  # fmt: skip


@pytest.mark.parametrize("text", [PLAIN, NAMELESS])
def test_an_arm_whose_controller_holds_its_weight_is_simulated_without_it(tmp_path: Path, text: str) -> None:
    ready, simulator = _ready(tmp_path, text, _log(held=True))
    (found,) = [d for d in ready.diagnoses if d.name == "gravity"]
    assert "do not hold the arm's weight" in str(found)
    space, written = simulator.parameters, tmp_path / "fitted.xml"
    values = np.array([p.nominal for p in space.parameters])
    values[space.index("lower.weight_held")] = 0.875  # what its controller was not told is left to the drives
    write_model(simulator, values, written)
    assert "<!-- kept -->" in written.read_text()
    np.testing.assert_allclose(mujoco.MjModel.from_xml_path(str(written)).body_gravcomp[1:], [1.0, 0.875])


def test_torques_of_which_no_unit_is_known_are_asked_too(tmp_path: Path) -> None:
    log = _log(held=True)
    command = log.channel("command_torque")
    ready, _ = _ready(tmp_path, PLAIN, log.with_channel(command.replace(unit="")))
    assert "gravity" in [d.name for d in ready.diagnoses]


def test_weight_that_the_controller_was_not_told_is_found(tmp_path: Path) -> None:
    ready, _ = _ready(tmp_path, PLAIN, _log(held=True))
    found = ready.calibrate(Options(cross_validate=False))
    held = found.values[ready.simulator.parameters.index("upper.weight_held")]
    assert held == pytest.approx(3.0 / 3.3, abs=0.03)
    assert found.replays[0].rmse_after().max() < 3e-3


@pytest.mark.parametrize(("held", "scale"), [(False, 1.0), (False, 0.01), (True, 0.01)])
def test_torques_that_hold_the_weight_or_are_of_another_scale_leave_it(
    tmp_path: Path, held: bool, scale: float
) -> None:
    ready, _ = _ready(tmp_path, PLAIN, _log(held=held, scale=scale))
    assert "gravity" not in [d.name for d in ready.diagnoses]


@pytest.mark.parametrize("seed", range(4))
def test_where_weight_hardly_matters_nothing_is_said_of_it(tmp_path: Path, seed: int) -> None:
    """Links that turn about an axis that is upright but for 0.2 mrad, whose drives have noise of 0.05 N m."""
    level = PLAIN.replace('axis="0 1 0"', 'axis="0.0002 0 1"')
    model, rng, rows, told = mujoco.MjModel.from_xml_string(level), np.random.default_rng(seed), [], np.zeros(2)
    data, push = mujoco.MjData(model), np.zeros(2)
    for k in range(2500):
        if k % 5 == 0:
            wanted = 0.5 * np.sin(np.array([2.2, 3.1]) * data.time)
            told = np.array([60.0, 30.0]) * (wanted - data.qpos) - np.array([6.0, 3.0]) * data.qvel
            rows.append([data.time, *(data.qpos + rng.normal(0.0, 1e-4, 2)), *told])
            push = rng.normal(0.0, 0.05, 2)
        data.ctrl[:] = told + push
        mujoco.mj_step(model, data)
    time, seen, torque = np.split(np.array(rows), [1, 3], axis=1)
    ready, _ = _ready(tmp_path, level, Recording("log", {
        "position": Channel("position", ("shoulder", "elbow"), "rad", time[:, 0], seen),
        "command_torque": Channel("command_torque", ("m1", "m2"), "N m", time[:, 0], torque),
    }))  # fmt: skip
    assert "gravity" not in [d.name for d in ready.diagnoses]


HOPPER = """<mujoco><option timestep=".0005"/><worldbody><geom type="plane" size="1 1 1"/>
<body name="carriage"><joint name="rail" type="slide" axis="0 0 1"{}/><geom size=".04" mass="{}" contype="0"/>
<body name="upper"><joint name="hip" axis="0 1 0"{}/>
<geom type="capsule" size=".015" fromto="0 0 0 0 0 -.16" mass=".25" contype="0" conaffinity="0"/>
<body name="lower" pos="0 0 -.16"><joint name="knee" axis="0 1 0"{}/>
<geom type="capsule" size=".01" fromto="0 0 0 0 0 -.15" mass=".1" contype="0" conaffinity="0"/>
<geom size=".015" pos="0 0 -.16" mass=".03"/></body></body></body></worldbody>
<actuator><motor name="m1" joint="hip"/><motor name="m2" joint="knee"/></actuator></mujoco>"""


def test_a_leg_on_a_rail_is_carried_by_its_foot_and_keeps_its_weight(tmp_path: Path) -> None:
    """Hopping in place: the floor carries it, and nothing at all in the air."""
    rubs = ' armature=".008" damping=".02" frictionloss=".15"'
    model = mujoco.MjModel.from_xml_string(HOPPER.format(' damping="2" frictionloss="1.5"', 1.3, rubs, rubs))
    data, rows, rng, told = mujoco.MjData(model), [], np.random.default_rng(0), np.zeros(2)
    data.qpos[:] = 0.26, 0.75, -1.5
    for k in range(8000):
        if k % 2 == 0:
            bend = 0.75 + 0.28 * np.sign(np.sin(15.0 * data.time)) * min(1.0, data.time)
            told = np.clip(60.0 * (np.array([bend, -2.0 * bend]) - data.qpos[1:]) - 0.6 * data.qvel[1:], -8.0, 8.0)
        if k % 10 == 0:
            rows.append([data.time, *(data.qpos + rng.normal(0.0, 3e-4, 3)), *told])
        data.ctrl[:] = told
        mujoco.mj_step(model, data)
    time, seen, torque = np.split(np.array(rows), [1, 4], axis=1)
    position = Channel("position", ("rail", "hip", "knee"), "", time[:, 0], seen, ("m", "rad", "rad"))
    command = Channel("command_torque", ("hip", "knee"), "N m", time[:, 0], torque)
    log = Recording("hops", {"position": position, "command_torque": command})
    ready, _ = _ready(tmp_path, HOPPER.format("", 1, "", ""), log)
    assert "gravity" not in [d.name for d in ready.diagnoses]


def test_a_refused_compensation_leaves_the_weight(tmp_path: Path) -> None:
    _, simulator = _ready(tmp_path, PLAIN, _log(held=True), refuse=["gravity"])
    assert not simulator.model.compiled.ngravcomp


_FOUR = ("base", "shoulder", "elbow", "wrist")
_PLACES, _LENGTHS, _MASSES = ((0.05, 0.12, 0.25, 0.22), (0.12, 0.25, 0.22, 0.1), (1.2, 0.9, 0.6, 0.3))


def _four(friction: Sequence[float], damping: Sequence[float], armature: Sequence[float]) -> str:
    """A small arm of four axes, upright, on motors."""
    links = [
        f'<body pos="0 0 {place}"><joint name="{name}" axis="{"0 0 1" if name == "base" else "0 1 0"}" frictionloss="{f}" '
        f'damping="{d}" armature="{a}"/><geom type="capsule" fromto="0 0 0 0 0 {length}" size=".03" mass="{mass}" '
        'contype="0" conaffinity="0"/>'
        for name, place, length, mass, f, d, a in zip(
            _FOUR, _PLACES, _LENGTHS, _MASSES, friction, damping, armature, strict=True
        )
    ]
    motors = "".join(f'<motor name="m_{name}" joint="{name}"/>' for name in _FOUR)
    return f"<mujoco><worldbody>{''.join(links)}{'</body>' * 4}</worldbody><actuator>{motors}</actuator></mujoco>"


def test_an_arm_that_sticks_under_torques_that_hold_its_weight_keeps_it(tmp_path: Path) -> None:
    """Computed torque of a model without friction: a light wrist sticks, whose torques say nothing of weight either way."""
    plain = mujoco.MjModel.from_xml_string(_four([0.0] * 4, [0.1] * 4, [0.01] * 4))
    real = mujoco.MjModel.from_xml_string(
        _four([0.5, 0.9, 0.5, 0.2], [0.4, 0.5, 0.25, 0.08], [0.03, 0.05, 0.02, 0.006])
    )
    real.opt.timestep = 5e-4
    own, data, rng, rows = mujoco.MjData(plain), mujoco.MjData(real), np.random.default_rng(0), []
    begin, way = np.array([0.5, -0.3, 1.0, 0.2]), np.array([-0.9, 0.7, -0.9, 0.5])
    data.qpos[:] = last = begin
    speed = np.zeros(4)
    for time in np.arange(0.0, 3.0, 0.01):
        seen = data.qpos + rng.normal(0.0, 3e-4, 4)
        speed, last = 0.5 * speed + 50.0 * (seen - last), seen
        phase, moves = np.pi * min(time / 1.5, 1.0), float(time < 1.5)
        wanted = begin + way * (0.5 - 0.5 * np.cos(phase))
        pace, push = (way * 0.5 * (np.pi / 1.5) ** n * moves * f(phase) for n, f in ((1, np.sin), (2, np.cos)))
        own.qpos[:], own.qvel[:] = seen, speed
        own.qacc[:] = push + 80.0 * (wanted - seen) + 12.0 * (pace - speed)
        mujoco.mj_inverse(plain, own)
        data.ctrl[:] = own.qfrc_inverse
        rows.append([time, *seen, *data.ctrl])
        mujoco.mj_step(real, data, 20)
    times, positions, torques = np.split(np.array(rows), [1, 5], axis=1)
    log = Recording("log", {
        "position": Channel("position", _FOUR, "rad", times[:, 0], positions),
        "command_torque": Channel("command_torque", _FOUR, "N m", times[:, 0], torques),
    })  # fmt: skip
    ready, simulator = _ready(tmp_path, _four([0.0] * 4, [0.1] * 4, [0.01] * 4), log)
    assert "gravity" not in {d.name for d in ready.diagnoses}
    friction = {p.name: p.nominal for p in simulator.parameters.parameters if p.name.endswith(".friction")}
    assert (
        max(friction.values()) < 2.0
    )  # N m: what moved one way is not given friction and an opposite offset without end


def _model(folder: Path, text: str) -> Model:
    (folder / "arm.xml").write_text(text)
    return load(folder / "arm.xml")


SERVOS = PLAIN.partition("<actuator>")[0] + (
    '<actuator><position name="shoulder" joint="shoulder" kp="400"/><position name="elbow" joint="elbow" kp="200"/>'
    "</actuator></mujoco>"
)
LEVEL = np.array([3 * 0.2 + 1.5 * 0.55, 1.5 * 0.15]) * 9.81  # N m


def _rested(share: float, rng: np.random.Generator) -> Recording:
    """Ten postures near level, each held for a second by servos of 800 and 300 N m/rad that bear that share of the weight."""
    told = np.repeat(rng.uniform(-0.1, 0.1, (10, 2)), 100, axis=0)
    position = told + share * LEVEL / [800.0, 300.0] + rng.normal(0.0, 1e-4, told.shape)
    return Recording("rests", {
        name: Channel(name, ("shoulder", "elbow"), "rad", np.linspace(0.0, 9.99, len(told)), values)
        for name, values in (("command", told), ("position", position))
    })  # fmt: skip


def test_of_an_arm_on_servos_that_hardly_sags_one_share_of_all_weight_is_asked_about(tmp_path: Path) -> None:
    arm, both, rng = _model(tmp_path, SERVOS), ["shoulder", "elbow"], np.random.default_rng(1)
    held = [_rested(0.05, rng)]
    (line,) = of_held_weight(arm, both, held)
    assert (line.of, line.tie) == (("upper", "lower"), "all")
    assert line.optional
    assert line.nominal == 0.0  # what stands where it is left out
    for sags in (1.0, 3.0):  # as the file's servos would have it by half, or by more than they
        assert not of_held_weight(arm, both, [_rested(sags, rng)])
    assert not of_held_weight(arm, [], held)
    assert not of_held_weight(arm, both, [])
    assert not of_held_weight(_model(tmp_path, SERVOS.replace('name="lower"', 'name="lower" gravcomp="1"')), both, held)
    free = SERVOS.replace('<body name="upper">', '<body name="trunk"><freejoint/><geom size=".1"/><body name="upper">')
    free = free.replace("</worldbody>", "</body></worldbody>")
    assert not of_held_weight(_model(tmp_path, free), both, held)
    railed = free.replace("<freejoint/>", '<joint name="rail" type="slide" axis="0 0 1"/>')
    assert not of_held_weight(_model(tmp_path, railed), both, held)
