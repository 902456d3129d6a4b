# SPDX-License-Identifier: Apache-2.0
"""A robot of which only some joints were logged: the rest is held, as it was in truth, and is in the calibrated file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.write import write_model
from trueup.loop.prepare import simulator_for
from trueup.recording import Channel, Recording
from trueup.trial import Trial

_FINGER = """<body pos="0 0 -.3"><joint name="finger" axis="0 1 0" {finger}/>
<geom size=".03" mass=".5" pos=".1 0 0"/></body>"""
_ROBOT = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody>
<body><joint name="arm" axis="0 1 0" damping=".4" armature=".01"/><geom size=".05" mass="1" pos="0 0 -.2"/>
{hand}</body></worldbody>{more}<actuator><position name="arm" joint="arm" kp="60"/></actuator>{keys}</mujoco>"""
_KEY = '<keyframe><key qpos="{} {}"/></keyframe>'


def _text(finger: str = "", more: str = "", keys: str = "") -> str:
    return _ROBOT.format(hand=_FINGER.format(finger=finger), more=more, keys=keys)


def _log() -> Recording:
    """Only the arm is logged; its finger is clamped."""
    clamped = _text().replace('<joint name="finger" axis="0 1 0" />', "")
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(clamped))
    time, seen = np.arange(0.0, 2.0, 0.01), []
    told = 0.5 * np.sin(4.0 * time)
    for wanted in told:
        seen.append(float(data.qpos[0]))
        data.ctrl[0] = wanted
        mujoco.mj_step(model, data, 5)
    return Recording("log", {
        n: Channel(n, ("arm",), "rad", time, np.asarray(v)) for n, v in (("command", told), ("position", seen))
    })  # fmt: skip


def _simulator(folder: Path, text: str) -> tuple[MujocoSimulator, tuple[str, ...]]:
    (folder / "robot.xml").write_text(text)
    simulator, notes = simulator_for(folder / "robot.xml", [_log()])
    assert isinstance(simulator, MujocoSimulator)
    return simulator, notes


@pytest.mark.parametrize("keys", ["", _KEY.format(0.3, 0)], ids=["no keyframe", "a keyframe"])
def test_a_joint_that_nobody_saw_and_nothing_drives_is_held(tmp_path: Path, keys: str) -> None:
    simulator, notes = _simulator(tmp_path, _text(keys=keys))
    assert any("held as the model has them: finger" in note for note in notes)
    (run,) = simulator.shipped().rollout([Trial.of(_log(), ["position"])], np.zeros((1, 0)))
    off = np.abs(run.channels["position"][0] - _log().channel("position").values)
    assert off[100:].max() < 1e-3  # the speed at the start is known roughly
    write_model(simulator, simulator.parameters.nominal, tmp_path / "fit.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml")).joint("finger").id == 1


def test_a_rail_that_nobody_saw_is_named_as_what_the_drives_hang_on(tmp_path: Path) -> None:
    text = _text().replace('<body><joint name="arm"', '<body><joint name="rail" type="slide"/><geom size=".1"/>'
                           '<body><joint name="arm"').replace("</worldbody>", "</body></worldbody>")  # fmt: skip
    _, notes = _simulator(tmp_path, text)
    assert any("held as the model has them: rail, finger. What the drives move hangs on rail" in note for note in notes)
    _, notes = _simulator(tmp_path, _text())
    assert not any("hangs on" in note for note in notes)


@pytest.mark.parametrize(
    "text",
    [
        _text(finger='stiffness="1"'),
        _text(more='<tendon><fixed name="t"><joint joint="finger" coef="1"/></fixed></tendon>'),
        _text(more='<equality><joint joint1="finger" joint2="arm"/></equality>'),
        _text(more='<sensor><jointpos joint="finger"/></sensor>'),
        _text(keys=_KEY.format(0, 0.4)),
    ],
    ids=["a spring", "a tendon", "coupled", "a sensor", "bent in the keyframe"],
)
def test_what_is_tied_or_sprung_keeps_its_joint(tmp_path: Path, text: str) -> None:
    simulator, _ = _simulator(tmp_path, text)
    assert simulator.compiled.nv == 2


_WHEEL = '<joint name="finger" axis="0 1 0" {}/><geom type="{}" size="{}" zaxis="{}" pos="{}"/>'
_FORK = '<joint name="fork" axis="0 0 1"/><geom size=".01" pos=".05 0 0"/><body pos="-.03 0 -.1">{}</body>'
_TYRE = ("cylinder", ".05 .01", "0 1 0", "0 .1 0")


@pytest.mark.parametrize(
    ("body", "held"),
    [
        (_WHEEL.format("", *_TYRE), set[str]()),
        (_WHEEL.format("", "sphere", ".05", "1 2 3", "0 0 0"), set[str]()),
        (_FORK.format(_WHEEL.format("", *_TYRE)), set[str]()),
        (_WHEEL.format('limited="true" range="-90 90"', *_TYRE), {"finger"}),
        (_WHEEL.format("", "cylinder", ".05 .01", "1 0 0", "0 0 0"), {"finger"}),
        (_WHEEL.format("", "cylinder", ".05 .01", "0 1 0", ".02 0 0"), {"finger"}),
        (_WHEEL.format("", "box", ".05 .01 .05", "0 0 1", "0 0 0"), {"finger"}),
        (
            _WHEEL.format("", *_TYRE) + '<body><joint name="ring"/><geom type="box" size=".1 .1 .1"/></body>',
            {"finger", "ring"},
        ),
    ],
    ids=["a wheel", "a ball", "a caster", "with limits", "across", "beside its axis", "a box", "a column that carries"],
)
def test_wheels_and_casters_that_nothing_drives_roll(tmp_path: Path, body: str, held: set[str]) -> None:
    simulator, _ = _simulator(tmp_path, _ROBOT.format(hand=f'<body pos="0 0 -.3">{body}</body>', more="", keys=""))
    assert set(simulator.model.still) == held
