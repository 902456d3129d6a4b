# SPDX-License-Identifier: Apache-2.0
"""What acted on an arm of commanded torques in every log is known before anything is searched."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.calibrate import Options
from trueup.loop.disturbed import LeftOut
from trueup.loop.fit import SHIPPED
from trueup.loop.prepare import Preparation, prepare
from trueup.loop.pushed import pushed
from trueup.recording import Channel, Recording

JOINTS = ("a", "b")
ARM = """<mujoco><option timestep="0.002"/><worldbody><body>
<joint name="a" axis="0 1 0" damping="{damping}" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".6" contype="0" conaffinity="0"/>
<body name="hand" pos=".3 0 0"><joint name="b" axis="0 1 0" damping="{damping}" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".4" contype="0"/></body></body>
<geom name="table" type="box" pos=".4 0 -.33" size=".3 .3 .1" contype="{table}"/></worldbody>
<actuator><motor name="a" joint="a" gear="2"/><motor name="b" joint="b"/></actuator></mujoco>"""
PARAMETERS = '[[parameter]]\nquantity = "damping"\nof = "*"\n'
TRUE = 0.4


def run(number: int, *, table: bool) -> Recording:
    """8 s at 100 Hz of an arm that a controller of its own moves to and fro, low enough to press on a table."""
    model = mujoco.MjModel.from_xml_string(ARM.format(damping=TRUE, table=int(table)))
    data, rng = mujoco.MjData(model), np.random.default_rng(number)
    time = 0.01 * np.arange(800, dtype=np.float64)
    wanted = np.stack([0.35 + 0.4 * np.sin((1.5 + 0.2 * number) * time), 0.5 * np.sin(2.6 * time + number)], axis=1)
    data.qpos[:] = wanted[0]
    seen, told = np.zeros((2, len(time), 2))
    for k, aim in enumerate(wanted):
        seen[k] = data.qpos
        told[k] = np.array([60.0, 25.0]) * (aim - data.qpos) - data.qvel
        data.ctrl[:] = told[k] / [2.0, 1.0]  # by the gear
        mujoco.mj_step(model, data, 5)
    seen += rng.normal(0.0, 1e-4, seen.shape)
    channels = (Channel("position", JOINTS, "rad", time, seen), Channel("command_torque", JOINTS, "N m", time, told))
    return Recording(f"run{number}", {c.name: c for c in channels})


def ready(folder: Path, recordings: list[Recording], *refused: str, table: bool = False) -> Preparation:
    (folder / "arm.xml").write_text(ARM.format(damping=0.2, table=int(table)))
    (folder / "parameters.toml").write_text(PARAMETERS)
    return prepare(folder / "arm.xml", recordings, parameters=folder / "parameters.toml", refuse=["zero", *refused])


def known(made: Preparation) -> LeftOut:
    return pushed(made.family, made.simulator, made.recordings)


def test_a_table_in_every_log_is_left_out_and_damping_comes_out_right(tmp_path: Path) -> None:
    made = ready(tmp_path, [run(0, table=True), run(1, table=True)])
    (gaps,) = known(made).gaps
    assert set(gaps) == {"run0", "run1"}
    done = made.calibrate(Options(search="gradient", select=False, cross_validate=False))
    assert any("something acted on the arm" in w and "left out" in w for w in done.warnings)
    assert [e.value for e in done.estimates] == pytest.approx([TRUE, TRUE], rel=0.05)


def test_a_table_that_is_to_stay_is_named(tmp_path: Path) -> None:
    made = ready(tmp_path, [run(0, table=True), run(1, table=True)], "disturbed")
    done = made.calibrate(Options(stages=SHIPPED, select=False, cross_validate=False))
    assert any(w.startswith("refused") and "Torque is further off" in w for w in done.warnings)
    assert {r.recording for r in done.replays} == {"run0", "run1"}


def test_nothing_is_left_out_of_an_arm_by_itself_or_where_the_model_has_the_table(tmp_path: Path) -> None:
    assert not known(ready(tmp_path, [run(0, table=False), run(1, table=False)])).gaps
    assert not known(ready(tmp_path, [run(0, table=True), run(1, table=True)], table=True)).gaps


def test_commanded_positions_tell_no_torques(tmp_path: Path) -> None:
    made = ready(tmp_path, [run(0, table=False)])
    log = made.recordings[0]
    positions = log.channel("position").replace(name="command")
    served = log.without("command_torque").with_channel(positions)
    assert made.family.torques(made.simulator, [served])[1] == []
