# SPDX-License-Identifier: Apache-2.0
"""Carts whose pole goes over the top are searched in windows that grow, and end there before noise at their starts has."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.discrepancies.weighted import Weighted
from trueup.loop.horizon import cut_for_search
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.loop.windows import swinging
from trueup.recording import Channel, Recording

_CART = """<mujoco><option timestep="0.0025" integrator="implicitfast"/><worldbody><body name="cart">
<joint name="x" type="slide" axis="1 0 0" damping=".02"/><geom type="box" size=".05 .04 .03" mass="{cart}" contype="0"/>
<body name="pole"><joint name="a" axis="0 1 0" damping="2e-6"/>
<geom type="capsule" fromto="0 0 0 0 0 -.12" size=".005" mass="{pole}" contype="0"/></body></body></worldbody>
<actuator><motor name="x" joint="x" ctrlrange="-9 9"/></actuator></mujoco>"""
_MASSES = 'quantity = "mass"\nof = ["cart", "pole"]\nlower = 0.002\nupper = 0.2\n'


def _swung() -> Recording:
    """3 s of a cart of 20 g that shakes a pole of 10 g over the top."""
    model = mujoco.MjModel.from_xml_string(_CART.format(cart=0.02, pole=0.01))
    data, time, rng = mujoco.MjData(model), np.arange(0.0, 3.0, 0.005), np.random.default_rng(0)
    seen, told = [], []
    for now in time:
        wanted = 0.09 * (0.7 * np.sin(8.8 * now) + 0.6 * np.sin(11.5 * now + 1.0) + 0.5 * np.sin(6.0 * now + 2.0))
        told.append(14.0 * (wanted - data.qpos[0]) - 0.9 * data.qvel[0])
        seen.append(data.qpos.copy())
        data.ctrl[:] = told[-1]
        mujoco.mj_step(model, data, 2)
    assert np.ptp(np.array(seen)[:, 1]) > 2.0 * np.pi
    noisy = np.array(seen) + rng.normal(0.0, (2e-4, 1e-3), (len(time), 2))
    position = Channel("position", ("x", "a"), "m", time, noisy, units=("m", "rad"))
    command = Channel("command_torque", ("x",), "N", time, np.array(told)[:, None])
    return Recording("swung", {"position": position, "command_torque": command})


def test_masses_of_a_cart_that_were_a_third_off_are_found_before_its_replays_part(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(_CART.format(cart=0.026, pole=0.007))
    (tmp_path / "masses.toml").write_text("[[parameter]]\n" + _MASSES)
    ready = prepare(tmp_path / "cart.xml", [_swung()], parameters=tmp_path / "masses.toml")
    told = ready.simulator.parameters
    problem = Problem(
        ready.simulator, ready.recordings, Weighted.estimated(ready.recordings, ["position"]), ("position",)
    )
    assert swinging(problem)
    begun, found, lasting, (note,) = cut_for_search(problem, told.nominal, told, np.inf, 0)
    assert found == pytest.approx([0.02, 0.01], rel=0.05)
    assert lasting < 1.0
    assert "in windows of 0." in note
    assert np.mean(begun.residuals(found[None]) ** 2) < 0.2 * np.mean(begun.plain_residuals(found[None]) ** 2)
