# SPDX-License-Identifier: Apache-2.0
"""Factors on motors' torques that all say the same may as well be masses: intervals hold both, and that is said."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration, Estimate
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.proportion import Proportion, proportion_of
from trueup.recording import Channel, Recording

JOINTS = ("shoulder", "elbow")


def _arm(times: float) -> str:
    links = [f'<inertial mass="{m * times}" pos="0 0 -0.15" diaginertia="{i * times} {i * times} {i * times}"/>'
             for m, i in ((1.0, 0.01), (0.6, 0.006))]  # fmt: skip
    return f"""<mujoco><compiler angle="radian"/><option timestep="0.002"/>
    <default><joint damping="0.1" armature="0.005"/></default>
    <worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>{links[0]}
    <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>{links[1]}</body></body></worldbody>
    <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>"""


def _hopper(times: float) -> mujoco.MjModel:
    text = "".join(f"""<body name="{side}" pos="{x} 0 0"><joint name="{side}" axis="0 1 0" damping="{0.1 * times}"
    frictionloss="{0.2 * times}" armature="{0.01 * times}"/><geom type="capsule" fromto="0 0 0 {0.1 * np.sign(x)} 0 -0.3"
    size="0.02" mass="{0.8 * times}"/></body>""" for side, x in (("front", 0.2), ("back", -0.2)))  # fmt: skip
    return mujoco.MjModel.from_xml_string(f"""<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="1 1 1"
    friction="0.6"/><body pos="0 0 0.33"><freejoint/><geom type="box" size="0.25 0.1 0.05" mass="{5.0 * times}"/>{text}</body>
    </worldbody><actuator><motor joint="front"/><motor joint="back"/></actuator></mujoco>""")


def test_a_robot_on_a_floor_moves_alike_with_all_masses_friction_and_torques_as_many_times_as_large() -> None:
    ends = []
    for times in (1.0, 1.4):
        model = _hopper(times)
        data, moved = mujoco.MjData(model), 0.0
        for _ in range(500):
            data.ctrl[:] = times * np.array([2.0, -1.5]) * np.sin(20.0 * data.time)
            mujoco.mj_step(model, data)
            moved = max(moved, float(np.abs(data.qvel[6:]).max()))
        assert data.ncon
        assert moved > 0.5  # rad/s
        ends.append(data.qpos.copy())
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)


def _log(times: float, seed: int) -> Recording:
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(_arm(times))
    data, time = mujoco.MjData(model), np.arange(0.0, 6.0, 0.01)
    pace, phase = rng.uniform(1.0, 6.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
    told = np.array([2.0, 0.7]) * np.sum(np.sin(pace * time[:, None, None] + phase), axis=2)
    rows = []
    for torque in told:
        rows.append(data.qpos + rng.normal(0.0, 3e-4, 2))
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, 5)
    return Recording(f"log{seed}", {
        "command_torque": Channel("command_torque", JOINTS, "N m", time, told),
        "position": Channel("position", JOINTS, "rad", time, np.array(rows)),
    })  # fmt: skip


def _found(folder: Path, times: float, seed: int = 1) -> Calibration:
    (file := folder / "arm.xml").write_text(_arm(1.0))
    return prepare(file, [_log(times, seed)]).calibrate(Options(cross_validate=False, lacking=False))


def test_factors_on_all_torques_may_as_well_be_masses_and_intervals_hold_both(tmp_path: Path) -> None:
    found = _found(tmp_path, 1.4)
    (note,) = [n for n in found.notes if "in proportion to the masses" in n]
    (said,) = re.findall(r"these bodies are about ([\d.]+) times as heavy", note)
    assert float(said) == pytest.approx(1.4, rel=0.05)
    truth = {f"{j}.{kind}": v for j in JOINTS for kind, v in (("damping", 0.1), ("armature", 0.005), ("gain", 1.0))}
    there = {e.name: e for e in found.estimates if e.name in truth and e.fitted}
    assert len(there) == len(truth)
    for name, e in there.items():
        assert e.low <= truth[name] <= e.high
        assert e.verdict != "identified"
        # what was measured, if the file is right, stays the value
        assert e.value == pytest.approx(truth[name] / 1.4, rel=0.05)


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_where_masses_are_right_values_of_a_swinging_arm_are_identified(tmp_path: Path, seed: int) -> None:
    """The links turn over, several times each: replays of 6 s do not follow slopes, nor any start that is off by a hair."""
    found = _found(tmp_path, 1.0, seed)
    assert not [n for n in found.notes if "in proportion to the masses" in n]
    for e in found.estimates:
        if e.name.endswith((".damping", ".armature")):
            assert e.verdict == "identified"
            assert e.value == pytest.approx(0.1 if e.name.endswith(".damping") else 0.005, rel=0.02)


def _estimate(name: str, value: float, width: float = 0.01) -> Estimate:
    low, high = value * (1.0 - width), value * (1.0 + width)
    return Estimate(name, "kg", 1.0, value, low, high, 0.01, 100.0, fitted=True, verdict="identified")


@pytest.mark.parametrize(
    ("factors", "alike"), [((0.7, 0.72, 0.71), True), ((0.7, 1.3, 1.02), False), ((0.98, 1.03, 1.01), False)]
)
def test_motors_that_each_have_a_constant_of_their_own_say_nothing_of_masses(
    factors: tuple[float, ...], alike: bool
) -> None:
    names = tuple(f"m{k}" for k in range(len(factors)))
    estimates = [*(_estimate(n, f) for n, f in zip(names, factors, strict=True)), _estimate("trunk", 5.0)]
    shown = Proportion(names, {"trunk": "", **{n: n for n in names}}, ("leg",), 4.0)
    told, notes = shown.applied(estimates)
    assert bool(notes) == alike
    assert (told[-1].verdict == "tied") == alike
    assert (told[-1].high > 6.9) == alike


@pytest.mark.parametrize(
    ("lines", "bodies"),
    [
        ('quantity = "gain"|quantity = "damping"', ("upper", "lower")),
        ('quantity = "gain"|quantity = "mass"\nof = "lower"', ("upper",)),
        ('quantity = "gain"|quantity = "mass"', ()),
        ('quantity = "gain"\nof = "elbow"|quantity = "damping"', None),  # the shoulder's torque tells what all weighs
        ('quantity = "damping"', None),
    ],
)
def test_masses_are_the_measure_where_no_torque_is(tmp_path: Path, lines: str, bodies: tuple[str, ...] | None) -> None:
    (file := tmp_path / "arm.xml").write_text(_arm(1.0))
    (declared := tmp_path / "parameters.toml").write_text("".join(f"[[parameter]]\n{x}\n" for x in lines.split("|")))
    simulator = prepare(file, [_log(1.0, 0)], parameters=declared).simulator
    shown = proportion_of(simulator, simulator.parameters)
    assert (None if shown is None else shown.bodies) == bodies
