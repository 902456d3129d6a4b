# SPDX-License-Identifier: Apache-2.0
"""Hard stops that recordings run into and the model lacks are recognised, calibrated and written; none are invented."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
JOINTS = ("rail", "swing")
GANTRY = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="rail" type="slide" axis="1 0 0" damping="20" frictionloss="1"/><geom type="box" size=".05 .05 .05" mass="2"/>
<body pos="0 0 -.05"><joint name="swing" axis="0 1 0" damping=".05" armature=".005" frictionloss=".02" {range}/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".4"/></body></body></worldbody>
<actuator><position name="rail" joint="rail" kp="{kp}"/><position name="swing" joint="swing" kp="8"/></actuator></mujoco>"""
STOP = 0.55  # rad


def record(name: str, seed: int, stop: bool) -> Recording:
    """The swing is told to go to 0.8 rad again and again."""
    limit = f'limited="true" range="-120 {np.degrees(STOP):.6f}"' if stop else ""
    model = mujoco.MjModel.from_xml_string(GANTRY.format(kp=400, range=limit))
    data, time = mujoco.MjData(model), 0.01 * np.arange(800)
    waves = np.random.default_rng(seed).uniform(0.9, 1.1, 2)
    told = np.stack([0.1 * np.sin(3.0 * waves[0] * time), 0.8 * np.sin(1.7 * waves[1] * time)], axis=1)
    seen = np.empty_like(told)
    for k, command in enumerate(told):
        seen[k], data.ctrl[:] = data.qpos, command
        mujoco.mj_step(model, data, 5)
    seen += 2e-4 * np.random.default_rng(seed).standard_normal(seen.shape)
    parts = {"command": told, "position": seen}
    return Recording(
        name, {n: Channel(n, JOINTS, "rad", np.asarray(time, dtype=np.float64), v) for n, v in parts.items()}
    )


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    path = tmp_path / "gantry.xml"
    path.write_text(GANTRY.format(kp=300, range=""), encoding="utf-8")
    return path


def test_a_stop_is_recognised_calibrated_and_written(gantry: Path) -> None:
    ready = prepare(gantry, [record("a", 0, stop=True)], [record("b", 1, stop=True)])
    (diagnosis,) = (d for d in ready.diagnoses if d.name == "stops")
    assert list(diagnosis.numbers) == ["swing upper"]
    assert diagnosis.numbers["swing upper"] == pytest.approx(STOP, abs=0.01)
    found = ready.calibrate(Options(cross_validate=False, lacking=False, stages=DESCENT))
    stop = next(e for e in found.estimates if e.name == "swing.stop_upper")
    assert stop.value == pytest.approx(STOP, abs=3e-3)
    (swing,) = (float(r.rmse_after()[r.labels.index("swing")]) for r in found.held_out() if "swing" in r.labels)
    assert swing < 2e-3  # without a stop the pendulum goes on for a quarter of a radian
    ready.write(found, gantry.with_name("out.xml"), gantry.with_name("parameters.toml"))
    written = mujoco.MjModel.from_xml_path(str(gantry.with_name("out.xml")))
    assert written.joint("swing").range[1] == pytest.approx(stop.value, abs=1e-6)
    assert not written.jnt_limited[written.joint("rail").id]


def test_none_is_invented_nor_added_where_it_was_refused(gantry: Path) -> None:
    assert not [d for d in prepare(gantry, [record("a", 0, stop=False)]).diagnoses if d.name == "stops"]
    refused = prepare(gantry, [record("a", 0, stop=True)], refuse=["stops"])
    assert not [n for n in refused.simulator.parameters.names if "stop_" in n]
    known = gantry.with_name("known.xml")
    known.write_text(GANTRY.format(kp=300, range=f'range="-120 {np.degrees(STOP):.6f}"'), encoding="utf-8")
    assert not [d for d in prepare(known, [record("a", 0, stop=True)]).diagnoses if d.name == "stops"]


CRAWLER = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="5 5 .1"/>
<body name="base" pos="0 0 .1"><freejoint/><geom type="box" size=".2 .2 .1" mass="9"/><body pos=".25 0 .05">
<joint name="arm" axis="0 1 0" damping=".05" armature=".01"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/>
</body></body></worldbody><actuator><position name="arm" joint="arm" kp="15"/></actuator></mujoco>"""


def test_what_the_floor_stops_of_a_robot_that_stands_on_it_is_no_hard_stop(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(CRAWLER)
    data, time, rows = mujoco.MjData(model), np.linspace(0.0, 7.99, 800), []
    told = 0.8 * np.sin(2.0 * time)
    for command in told:
        rows.append(data.qpos.copy())
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 5)
    seen = np.array(rows) + 2e-4 * np.random.default_rng(0).standard_normal((800, 8))
    assert np.sum(told - seen[:, 7] > 0.1) > 100, "the floor is in the way"
    channels = (
        Channel("command", ("arm",), "rad", time, told[:, None]),
        Channel("position", ("arm",), "rad", time, seen[:, 7:]),
        Channel("base_position", ("x", "y", "z"), "m", time, seen[:, :3]),
        Channel("base_orientation", ("w", "x", "y", "z"), "", time, seen[:, 3:7]),
    )
    (tmp_path / "crawler.xml").write_text(CRAWLER, encoding="utf-8")
    ready = prepare(tmp_path / "crawler.xml", [Recording("crawl", {c.name: c for c in channels})])
    assert not [d for d in ready.diagnoses if d.name == "stops"]
