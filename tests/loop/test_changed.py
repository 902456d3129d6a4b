# SPDX-License-Identifier: Apache-2.0
"""A robot that becomes another one within a recording is told from one that the model does not describe well."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration
from trueup.loop.calibrate import Options
from trueup.loop.changed import replayed_too
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_ARM = """<mujoco><option timestep="0.005"/><worldbody><body>
<joint name="a" axis="0 1 0" damping="{damping} {more}" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".6"/>
<body pos=".3 0 0"><joint name="b" axis="0 1 0" damping="{damping}" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".4"/>
<body name="load" pos=".25 0 0"><geom size=".02" mass=".01"/></body></body></body></worldbody>
<actuator><position name="a" joint="a" kp="{kp}" kv="2"/><position name="b" joint="b" kp="25" kv="1"/></actuator></mujoco>"""
_PARAMETERS = '[[parameter]]\nquantity = "kp"\nof = "*"\n[[parameter]]\nquantity = "damping"\nof = "*"\n'


def _run(*, loaded_from: float = np.inf, more: float = 0.0, name: str = "log", pace: float = 1.0) -> Recording:
    """12 s of an arm that takes up 0.4 kg, or whose friction grows with the square of speed; the last 5 s are faster."""
    model = mujoco.MjModel.from_xml_string(_ARM.format(damping=0.4, kp=70, more=more))
    data, time, seen = mujoco.MjData(model), np.arange(0.0, 12.0, 0.02), []
    phase = np.cumsum(np.where(time < 7.0, 1.5, 3.0)) * 0.02 * pace
    told = 0.4 * np.stack([np.sin(phase), np.sin(1.7 * phase)], axis=1)
    for now, row in zip(time, told, strict=True):
        seen.append(data.qpos.copy())
        if now >= loaded_from and model.body("load").mass[0] < 0.1:
            model.body("load").mass[0] += 0.4
            mujoco.mj_setConst(model, mujoco.MjData(model))
        data.ctrl[:] = row
        mujoco.mj_step(model, data, 4)
    noisy = np.array(seen) + np.random.default_rng(0).normal(0.0, 3e-4, (len(time), 2))
    rows = {"command": told, "position": noisy}
    return Recording(name, {role: Channel(role, ("a", "b"), "rad", time, values) for role, values in rows.items()})


def _calibrated(folder: Path, *runs: Recording) -> Calibration:
    (folder / "arm.xml").write_text(_ARM.format(damping=0.2, kp=50, more=0.0))
    (folder / "parameters.toml").write_text(_PARAMETERS)
    ready = prepare(folder / "arm.xml", runs, parameters=folder / "parameters.toml", refuse=["zero"])
    return ready.calibrate(Options(search="gradient", cross_validate=False, lacking=False))


def test_a_load_that_is_taken_up_within_a_recording_is_named_with_its_instant(tmp_path: Path) -> None:
    (said,) = [w for w in _calibrated(tmp_path, _run(loaded_from=5.0)).warnings if "becomes another one" in w]
    found = re.search(r"within 'log' .* about ([\d.]+) s: ", said)
    assert found is not None
    assert float(found[1]) == pytest.approx(5.0, abs=0.6)


@pytest.mark.parametrize("more", [0.0, 0.6])
def test_friction_of_another_form_is_no_change_of_the_robot(more: float, tmp_path: Path) -> None:
    found = _calibrated(tmp_path, _run(more=more))
    assert not [w for w in found.warnings if "becomes another one" in w]


def test_recordings_with_a_load_are_told_from_those_without(tmp_path: Path) -> None:
    """Which of the two is the robot nobody knows: the fewer are named."""
    loads = {"slow": np.inf, "heavy": 0.0, "fast": np.inf}
    runs = [_run(loaded_from=loaded, name=n, pace=0.7 + 0.3 * i) for i, (n, loaded) in enumerate(loads.items())]
    found = _calibrated(tmp_path, *runs)
    (said,) = [w for w in found.warnings if "another one than in the other recordings" in w]
    assert said.startswith("in 'heavy' the robot is another one")
    assert "identified" not in {e.verdict for e in found.estimates}  # kp is that of no load, nor of one


@pytest.mark.parametrize("more", [0.0, 0.6])
def test_recordings_at_several_speeds_are_of_one_robot_whatever_its_friction(more: float, tmp_path: Path) -> None:
    runs = [_run(more=more, name=str(pace), pace=pace) for pace in (0.4, 0.8, 1.2)]
    assert not [w for w in _calibrated(tmp_path, *runs).warnings if "another one" in w]


@pytest.mark.parametrize("parts", [False, True])
def test_values_of_their_own_that_slopes_promise_are_to_be_replayed(*, parts: bool) -> None:
    """Errors of two recordings, +1 and -1, that values of their own take away, unless replays part on their own."""
    errors = np.repeat([1.0, -1.0], 5)

    def residuals(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return errors + (6.0 + 0.0 * values if parts else values)

    space = SimpleNamespace(from_unit=lambda unit: unit - 0.5)
    problem = SimpleNamespace(residuals=residuals)
    fit = SimpleNamespace(
        space=space, unit=np.full(1, 0.5), residual=errors, jacobian=np.ones((10, 1)), weights=np.ones(10)
    )
    steps, second = (np.full(1, -0.5), np.full(1, 0.5)), errors < 0.0
    assert replayed_too(cast("Any", problem), cast("Any", fit), steps, second, np.arange(10)) != parts
