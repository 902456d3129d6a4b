# SPDX-License-Identifier: Apache-2.0
"""Recordings made in a user's own code mean what their units say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import trueup
from trueup.inspection.si import in_si
from trueup.recording import Channel, Recording

ARM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 1 0" range="-2 2"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".4"/></body></worldbody>
<actuator><position name="hinge" joint="hinge" kp="10" kv=".5"/></actuator></mujoco>"""


def test_angles_that_are_said_to_be_in_degrees_are_prepared_as_radians(tmp_path: Path) -> None:
    time = np.arange(0.0, 2.0, 0.01)
    angle = 0.5 * np.sin(3.0 * time)[:, None]
    command = Channel("command", ("hinge",), "rad", time, angle)
    measured = Channel("position", ("hinge",), "deg", time, np.degrees(0.9 * angle))
    (tmp_path / "arm.xml").write_text(ARM)
    ready = trueup.prepare(tmp_path / "arm.xml", [Recording("run", {"command": command, "position": measured})])
    position = ready.recordings[0].channel("position")
    assert position.unit == "rad"
    np.testing.assert_allclose(position.values, 0.9 * angle, atol=1e-12)


def test_each_label_has_its_own_unit_and_shares_stay_shares() -> None:
    time = np.arange(3.0)
    mixed = Channel("position", ("hinge", "slide"), "deg", time, np.full((3, 2), 90.0), units=("deg", "mm"))
    duty = Channel("duty", ("hinge",), "%", time, np.full((3, 1), 50.0))
    ticks = Channel("ticks", ("hinge",), "ticks of 4096", time, np.full((3, 1), 7.0))
    found = in_si(Recording("run", {c.name: c for c in (mixed, duty, ticks)}))
    assert found.channel("position").units == ("rad", "m")
    np.testing.assert_allclose(found.channel("position").values[0], [np.pi / 2.0, 0.09])
    assert (found.channel("duty").unit, found.channel("duty").values[0, 0]) == ("%", pytest.approx(50.0))
    assert found.channel("ticks") is ticks


def test_units_that_are_si_are_called_as_everywhere_else() -> None:
    acc = Channel("acc", ("x",), "m/s2", np.arange(3.0), np.ones((3, 1)))
    found = in_si(Recording("run", {"acc": acc})).channel("acc")
    assert found.unit == "m/s^2"
    np.testing.assert_array_equal(found.values, acc.values)
