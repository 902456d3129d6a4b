# SPDX-License-Identifier: Apache-2.0
"""Where the real robot was, its parts do not push each other away, though their hulls overlap in the model."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.overlaps import passable
from trueup.engines.mujoco.writing.write import write_model
from trueup.loop.prepare import simulator_for
from trueup.recording import Channel, Recording
from trueup.trial import Trial

# The base reaches into the shoulder, as convex hulls do; the hand may rest on the table.
_URDF = """<robot name="arm"><link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="upper"><inertial><mass value="1"/><origin xyz="0 0 -0.2"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0"
 ixz="0" iyz="0"/></inertial><collision><origin xyz="0.05 0 -0.05"/><geometry><sphere radius="0.1"/></geometry>
</collision></link><joint name="swing" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="5"/></joint></robot>"""
_TABLE = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1" pos="0 0 -.3"/>
<body name="table" pos=".3 0 -.2"><geom type="box" size=".1 .1 .05"/></body>
<body name="a"><joint name="j" axis="0 1 0"/><geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
<body name="b" pos=".3 0 0"><joint name="k" axis="0 1 0"/><geom type="sphere" size=".06" pos="0 0 -.1"/></body></body>
</worldbody></mujoco>"""

_FOLDED = """<mujoco><!-- an arm that folds --><worldbody><body name="a"><joint name="j" axis="0 1 0"/><geom size=".1"/>
<body name="b" pos=".3 0 0"><joint name="k" axis="0 0 1"/><geom size=".01" pos=".1 0 0"/>
<body name="c" pos="-.15 0 0"><joint name="m" axis="0 0 1"/><geom size=".1"/></body></body></body></worldbody>
<actuator><position name="s" joint="j"/></actuator></mujoco>"""


def _still(**angles: float) -> Recording:
    time = np.arange(0.0, 1.0, 0.01)
    values = np.tile(list(angles.values()), (len(time), 1)) + np.random.default_rng(0).normal(
        0, 1e-4, (100, len(angles))
    )
    channels = [Channel(name, tuple(angles), "rad", time, values) for name in ("position", "command")]
    return Recording("still", {c.name: c for c in channels})


def test_a_base_whose_hull_holds_its_first_link_lets_it_go_and_so_does_the_written_file(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(_URDF)
    recording = _still(swing=0.3)
    simulator, notes = simulator_for(tmp_path / "arm.urdf", [recording])
    assert any("base and upper" in note for note in notes)
    (out,) = simulator.rollout([Trial.of(recording)], simulator.parameters.nominal[None])
    assert np.abs(out.channels["position"][0] - recording.channel("position").values).max() < 0.03
    assert isinstance(simulator, MujocoSimulator)
    write_model(simulator, simulator.parameters.nominal, tmp_path / "fit.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml")).nexclude == 1


def test_bodies_without_names_let_each_other_go_too(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_FOLDED.replace('<body name="c"', "<body"))
    changed = passable(load(tmp_path / "arm.xml"), [_still(j=0.0, k=0.0, m=0.0)])
    assert changed.compiled.nexclude == 1
    assert "a and body 3 (50 mm)" in changed.notes[-1]


def test_what_stands_around_the_robot_keeps_its_contacts(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_TABLE)
    model = load(tmp_path / "arm.xml")
    assert passable(model, [_still(j=0.0, k=0.0)]) is model


def test_an_mjcf_keeps_its_text_and_its_contacts_and_the_fit_says_which_parts_did_not_touch(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_FOLDED)
    simulator, notes = simulator_for(tmp_path / "arm.xml", [_still(j=0.0, k=0.0, m=0.0)])
    assert any("a and c" in note for note in notes)
    assert isinstance(simulator, MujocoSimulator)
    said = write_model(simulator, simulator.parameters.nominal, tmp_path / "fit.xml")
    assert any("touch each other in the file as they did" in note for note in said)
    written = (tmp_path / "fit.xml").read_text()
    assert "exclude" not in written
    assert "<!-- an arm that folds -->" in written
