# SPDX-License-Identifier: Apache-2.0
"""Where the robot was measured beyond a range of its model, nothing stops it there."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.write import write_model
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

_ARM = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body>
<joint name="pan" axis="0 0 1" range="-1 1" limited="true"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><position name="pan" joint="pan" kp="200" kv="10"/></actuator></mujoco>"""
_TIME = np.arange(0.0, 2.0, 0.01)


def _turned(furthest: float) -> Recording:
    way = furthest * np.sin(np.pi * _TIME / 4.0)[:, None] ** 2
    channels = [Channel(name, ("pan",), "rad", _TIME, way) for name in ("position", "command")]
    return Recording("turned", {c.name: c for c in channels})


def _replayed(folder: Path, furthest: float, *refuse: str) -> tuple[MujocoSimulator, float, list[str]]:
    (folder / "arm.xml").write_text(_ARM)
    recording = _turned(furthest)
    ready = prepare(folder / "arm.xml", [recording], refuse=refuse, propose=False)
    simulator, notes = ready.simulator, (*ready.notes, *ready.diagnoses)
    (out,) = simulator.rollout([Trial.of(recording)], simulator.parameters.nominal[None])
    assert isinstance(simulator, MujocoSimulator)
    return simulator, float(out.channels["position"][0].max()), [str(n) for n in notes]


def test_a_range_that_the_robot_went_beyond_does_not_stop_it_and_stays_in_the_file(tmp_path: Path) -> None:
    simulator, reached, notes = _replayed(tmp_path, 2.0)
    assert reached > 1.9
    assert any("beyond their range in the model (pan)" in note for note in notes)
    write_model(simulator, simulator.parameters.nominal, tmp_path / "fit.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml")).jnt_range[0].tolist() == [-1.0, 1.0]


def test_it_stops_where_that_is_refused_or_the_robot_stayed_within(tmp_path: Path) -> None:
    _, reached, _ = _replayed(tmp_path, 2.0, "ranges")
    assert reached < 1.6
    _, _, notes = _replayed(tmp_path, 0.9)
    assert not any("beyond their range" in note for note in notes)
