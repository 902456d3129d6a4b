# SPDX-License-Identifier: Apache-2.0
"""A foot that lands softer than its file has it: named where it was not declared, asked for where nothing is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.notes import about_load
from trueup.engines.simulator import CONTACTS
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

HOPPER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="5 5 1" solref="{soft} 1"/>
<body pos="0 0 {height}"><joint name="rail" type="slide" axis="0 0 1" damping="2"/>
<inertial pos="0 0 0" mass="2" diaginertia=".01 .01 .01"/>
<body><joint name="knee" type="slide" axis="0 0 1" damping="{damping}"/>
<inertial pos="0 0 -.1" mass=".3" diaginertia=".001 .001 .001"/>
<geom name="foot" type="sphere" pos="0 0 -.2" size=".02" solref="{soft} 1"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="{kp}" kv="20"/></actuator></mujoco>"""
FILE, TRUTH = {"kp": 2000, "damping": 10, "soft": 0.02, "height": 0.3}, {"kp": 2500, "damping": 14, "soft": 0.06}
NOISE = 2e-4  # m


def hops(folder: Path, truth: str, seconds: float = 2.0) -> tuple[Path, list[Recording]]:
    """The file, and two runs of a hopper as `truth` has it, simulated by MuJoCo itself."""
    (file := folder / "hopper.xml").write_text(HOPPER.format(**FILE))
    model, rng, runs = mujoco.MjModel.from_xml_string(truth), np.random.default_rng(4), []
    for name, period in (("slow", 0.8), ("fast", 0.5)):
        data, time, seen = mujoco.MjData(model), np.arange(0.0, seconds, 0.01), []
        told = np.where((time > 0.4) & (time % period < 0.15), -0.06, 0.02)[:, None]
        for u in told:
            data.ctrl[:] = u
            seen.append(data.qpos.copy())
            mujoco.mj_step(model, data, 5)
        position = np.array(seen) + rng.normal(0.0, NOISE, (len(time), 2))
        runs.append(Recording(name, {
            "command": Channel("command", ("knee",), "m", time, told),
            "position": Channel("position", ("rail", "knee"), "m", time, position),
        }))  # fmt: skip
    return file, runs


def test_contacts_that_are_softer_than_their_file_are_named_with_their_time_constant(tmp_path: Path) -> None:
    file, runs = hops(tmp_path, HOPPER.format(**{**FILE, **TRUTH}))
    lines = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "knee"\n' for q in ("kp", "damping", "armature"))
    (tmp_path / "own.toml").write_text(lines)
    found = prepare(file, runs, parameters=tmp_path / "own.toml").calibrate(
        Options(cross_validate=False, stages=DESCENT)
    )
    assert f"replayed better with {CONTACTS}, which the model lacks: contact_softness" in found.lacking
    assert float(found.lacking.partition("contact_softness ")[2].split()[0]) == pytest.approx(0.06, rel=0.05)
    for e in found.estimates:
        truth = {"kp": 2500.0, "damping": 14.0, "armature": 0.0}[e.name.rpartition(".")[2]]
        assert e.verdict != "identified" or e.low <= truth <= e.high


@pytest.mark.parametrize(("height", "asked"), [(0.3, True), (0.9, False)])
def test_softness_and_sliding_are_asked_for_where_the_measured_foot_reaches_the_floor(
    tmp_path: Path, height: float, asked: bool
) -> None:
    file, runs = hops(tmp_path, HOPPER.format(**FILE), seconds=0.3 if height > 0.5 else 1.0)
    file.write_text(HOPPER.format(**{**FILE, "height": height}))
    space = prepare(file, runs).simulator.parameters
    assert ("contact_softness" in space.names) == asked
    assert not asked or space["contact_softness"].optional == CONTACTS
    assert ("floor_friction" in space.names) == asked


@pytest.mark.parametrize("named", [True, False])
def test_shapes_without_names_that_touch_are_to_be_named_where_replays_stay_far_off(
    tmp_path: Path, named: bool
) -> None:
    file, runs = hops(tmp_path, HOPPER.format(**FILE), seconds=1.0)
    if not named:
        file.write_text(file.read_text().replace('geom name="floor"', "geom").replace('geom name="foot"', "geom"))
    simulator = cast(MujocoSimulator, prepare(file, runs).simulator)
    simulator.rollout([Trial.of(r) for r in runs], simulator.parameters.nominal[None])
    far = 30.0 * np.sign(np.random.default_rng(0).normal(size=(50, 2)))
    off = SimpleNamespace(channel="position", after=far, measured=np.zeros_like(far), noise=np.ones(2))
    (note,) = about_load(simulator, cast(Calibration, SimpleNamespace(lacking="", training=lambda: [off])))
    assert ("names, and that is asked about" in note) != named
