# SPDX-License-Identifier: Apache-2.0
"""Poses of a free base are brought to the model's floor, and what was lifted by hand is no motion of the robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.setup.footing import on_the_floor, without_lifts
from trueup.recording import Channel, Recording

_STOOL = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 .1"/>{more}<body name="trunk" pos="0 0 .2">
<freejoint/><geom type="box" size=".1 .05 .02" mass="1"/><body name="leg"><joint name="knee" type="slide" axis="0 0 1"/>
<geom name="foot" type="sphere" size=".02" pos="0 0 -.18" mass=".1"/></body></body></worldbody></mujoco>"""
_TIME = np.arange(0.0, 4.0, 0.01)


def _stool(folder: Path, more: str = "") -> Model:
    (folder / "stool.xml").write_text(_STOOL.format(more=more))
    return load(folder / "stool.xml")


def _stands(
    height: np.ndarray | float = 0.0, name: str = "log", quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
) -> Recording:
    """It stands 0.2 m high, as high over the floor as is said, and bends its knee a little."""
    knee = 0.01 * np.sin(3.0 * _TIME)
    place = np.stack([0.0 * _TIME, 0.0 * _TIME, 0.2 - knee + height], axis=1)
    return Recording(name, {c.name: c for c in (
        Channel("command", ("knee",), "m", _TIME, knee[:, None]),
        Channel("position", ("knee",), "m", _TIME, knee[:, None]),
        Channel("base_position", ("x", "y", "z"), "m", _TIME, place),
        Channel("base_orientation", ("w", "x", "y", "z"), "", _TIME, np.tile(quaternion, (len(_TIME), 1))),
    )})  # fmt: skip


def _z(recording: Recording) -> np.ndarray:
    return recording.channel("base_position").column("z")


def test_heights_counted_from_elsewhere_are_brought_to_the_floor(tmp_path: Path) -> None:
    (moved, other), notes = on_the_floor(_stool(tmp_path), [_stands(0.5, "table"), _stands(0.51, "again")])
    assert _z(moved) == pytest.approx(_z(_stands()), abs=0.01)
    assert np.median(_z(other) - _z(moved)) == pytest.approx(0.01)  # what is common is taken off, no more
    (note,) = notes
    assert "table +0.5" in note
    assert "again +0.5" in note


def test_what_stands_on_the_floor_stays_as_it_is(tmp_path: Path) -> None:
    log = _stands(0.02)
    hop = _stands(np.where(abs(_TIME - 2.0) < 0.25, 0.306 - 4.905 * (_TIME - 2.0) ** 2, 0.0), "hop")
    assert on_the_floor(_stool(tmp_path), [log, hop]) == ([log, hop], [])
    assert without_lifts(_stool(tmp_path), [log, hop]) == ([log, hop], [])


def test_a_frame_whose_y_points_up_is_turned(tmp_path: Path) -> None:
    upright, half = _stands(), np.sqrt(0.5)
    place = upright.channel("base_position")
    lies = _stands(quaternion=(half, -half, 0.0, 0.0))
    lies = lies.with_channel(place.replace(values=place.values[:, [0, 2, 1]] * [1.0, 1.0, -1.0]))
    (turned,), (note,) = on_the_floor(_stool(tmp_path), [lies])
    assert turned.channel("base_position").values == pytest.approx(place.values)
    assert turned.channel("base_orientation").values == pytest.approx(np.zeros((len(_TIME), 3)), abs=1e-9)
    assert "y points up" in note


def test_what_was_lifted_by_hand_is_left_out(tmp_path: Path) -> None:
    lifted = _stands(np.clip(0.3 * (_TIME - 3.0), 0.0, None), "lifted")
    (part,), (note,) = without_lifts(_stool(tmp_path), [lifted])
    assert part.name == "lifted part 1"
    assert 3.0 < part.stop < 3.25
    assert "'lifted'" in note
    assert "held in the air" in note


def test_steps_that_the_model_has_are_no_wrong_heights(tmp_path: Path) -> None:
    stairs = _stool(tmp_path, '<geom type="box" size="1 1 .25" pos="0 0 .25"/>')
    log = _stands(0.5)
    assert on_the_floor(stairs, [log]) == ([log], [])
