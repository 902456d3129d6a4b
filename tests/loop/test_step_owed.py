# SPDX-License-Identifier: Apache-2.0
"""What the step of a simulation does to estimates is in their intervals, whatever else is calibrated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from trueup.loop.calibrate import Options
from trueup.loop.considered import STEP, Considered
from trueup.loop.descent import Fit
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.loop.ties import considered
from trueup.recording import Channel, Recording

SWING = """
<mujoco><option timestep="{step}"/><worldbody><body>
  <joint name="j" axis="0 1 0" damping="{damping}" armature="{armature}"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="m" joint="j"/></actuator></mujoco>
"""
NOISE = 1e-4  # rad


def swung(true: dict[str, float], torque: float, noise: float = NOISE) -> Recording:
    """A pendulum that sines of `torque` N m swing, simulated at 0.1 ms."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 5.0, 0.005)
    model = mujoco.MjModel.from_xml_string(SWING.format(step=1e-4, **true))
    data, seen = mujoco.MjData(model), []
    told = torque * np.sin(rng.uniform(2.0, 12.0, 3) * time[:, None] + rng.uniform(0.0, 6.0, 3)).sum(axis=1)
    for u in told:
        seen.append(float(data.qpos[0]))
        data.ctrl[0] = u
        mujoco.mj_step(model, data, 50)
    measured = np.array(seen) + rng.normal(0.0, noise, len(time))
    return Recording("swing", {
        "command_torque": Channel("command_torque", ("j",), "N m", time, told[:, None]),
        "position": Channel("position", ("j",), "rad", time, measured[:, None]),
    })  # fmt: skip


@pytest.mark.parametrize(("torque", "damping"), [(0.6, 0.05), (1.5, 0.02)])
def test_intervals_hold_what_a_finer_step_would_find(tmp_path: Path, torque: float, damping: float) -> None:
    """The step damps a swing and delays it by a part of itself, which the estimates make up for."""
    true = {"damping": damping, "armature": 0.01}
    kinds = (*true, "damping_quadratic", "delay")
    (tmp_path / "swing.xml").write_text(SWING.format(step=4e-3, damping=0.5 * damping, armature=0.005))
    (tmp_path / "parameters.toml").write_text("".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in kinds))
    ready = prepare(tmp_path / "swing.xml", [swung(true, torque)], parameters=tmp_path / "parameters.toml", step=4e-3)
    found = {e.name: e for e in ready.calibrate(Options(cross_validate=False)).estimates}
    assert found["j.armature"].value < 0.998 * true["armature"]
    for kind, value in true.items():
        e = found[f"j.{kind}"]
        assert e.low <= value <= e.high, (e.value, e.low, e.high)
        assert e.high - e.low < 0.1 * value


def test_what_is_owed_to_the_step_is_asked_where_starts_are_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half the step moves a fit with corrected starts as it foretells: from starts as measured it would be elsewhere."""
    true, owed = {"damping": 0.005, "armature": 0.01}, list[Considered]()

    def kept(problem: Problem, fit: Fit, *rest: Any) -> tuple[Considered, ...]:
        asked = considered(problem, fit, *rest)
        owed.extend(c for c in asked if c.parameter.name == STEP and fit.shot is not None)
        return asked

    monkeypatch.setattr("trueup.loop.calibrate.considered", kept)
    (tmp_path / "swing.xml").write_text(SWING.format(step=4e-3, damping=0.0025, armature=0.005))
    kinds = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in true)
    (tmp_path / "parameters.toml").write_text(kinds)
    values = []
    for step in (4e-3, 2e-3):
        log = swung(true, 0.1, noise=3e-3)
        ready = prepare(tmp_path / "swing.xml", [log], parameters=tmp_path / "parameters.toml", step=step)
        found = ready.calibrate(Options(cross_validate=False, lacking=False))
        values.append([e.value for e in found.estimates])
    moved = np.subtract(*values[::-1])
    assert -2e-3 * owed[0].trade[0] == pytest.approx(moved[0], rel=0.2)
