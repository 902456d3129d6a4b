# SPDX-License-Identifier: Apache-2.0
"""Torques that nobody compared tell a file that is too light, of which positions alone tell nothing."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.logged_torques import beside_logged
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body><joint name="j" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/></body></worldbody>
<actuator><position name="m" joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""


def _file(times: float) -> str:
    return _ARM.format(mass=0.4 * times, inertia=2e-3 * times, kp=10.0 * times, kv=0.3 * times)


def _robot() -> Recording:
    """A robot whose masses and gains are 1.25 times those of its file: it moves as the file does."""
    model, time = mujoco.MjModel.from_xml_string(_file(1.25)), np.arange(0.0, 3.0, 0.01)
    data, told, seen, torque = mujoco.MjData(model), np.sin(4.0 * time), [], []
    for wanted in told:
        data.ctrl[0] = wanted
        mujoco.mj_forward(model, data)
        seen.append(data.qpos[0])
        torque.append(data.qfrc_actuator[0])
        mujoco.mj_step(model, data, 5)
    channels = (
        Channel("command", ("j",), "rad", time, told[:, None]),
        Channel("position", ("j",), "rad", time, np.array(seen)[:, None]),
        Channel("torque", ("j",), "N m", time, np.array(torque)[:, None]),
    )
    return Recording("log", {c.name: c for c in channels})


def test_torques_that_were_not_compared_are_said_beside_the_models(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_file(1.0))
    log = _robot()
    (tmp_path / "as_it_is.toml").write_text(
        '[[parameter]]\nquantity = "delay"\nof = "*"\nnominal = 0.0\nfrozen = true\n'
    )
    ready = prepare(tmp_path / "arm.xml", [log], parameters=tmp_path / "as_it_is.toml")
    simulator, nominal = ready.simulator, ready.simulator.parameters.nominal
    (note,) = beside_logged(simulator, nominal, ready.recordings)
    (ratio,) = re.findall(r"are ([\d.]+) \(j\) times", note)
    assert float(ratio) == pytest.approx(1.25, rel=0.03)
    assert not beside_logged(simulator, nominal, ready.recordings, ["position", "torque"])
    assert not beside_logged(simulator, nominal, [log.without("torque")])


def test_estimates_hold_what_the_logged_torques_say_where_a_file_is_too_light(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_file(1.0))
    (tmp_path / "gains.toml").write_text(
        "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\nlower = 0.01\nupper = 40.0\n' for q in ("kp", "kv"))
    )
    ready = prepare(tmp_path / "arm.xml", [_robot()], parameters=tmp_path / "gains.toml", refuse=["zero"])
    (kp, kv) = ready.calibrate().estimates
    assert kp.value == pytest.approx(10.0, rel=0.02), "as the file's masses have it"
    assert kp.verdict == kv.verdict == "tied"
    assert kp.low < 10.0 < 12.5 < kp.high
    assert kv.low < 0.3 < 0.375 < kv.high
    (other,) = re.findall(r"about ([\d.]+) if the torques are what was logged", kp.note)
    assert float(other) == pytest.approx(12.5, rel=0.03)
    ready = prepare(
        tmp_path / "arm.xml", [_robot().without("torque")], parameters=tmp_path / "gains.toml", refuse=["zero"]
    )
    assert ready.calibrate().estimates[0].verdict == "identified", "nothing speaks against the masses"
