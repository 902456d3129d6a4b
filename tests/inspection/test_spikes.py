# SPDX-License-Identifier: Apache-2.0
"""Positions that a bus spoilt for a sample or two are missing; wraps, steps and quick motions are what they are."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.inspection import inspect
from trueup.inspection.spikes import lone_spikes, without_lone_spikes
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

TIME: Array = 0.01 * np.arange(800, dtype=np.float64)
MOVING = 0.35 * np.sin(1.3 * TIME)
BAD = math.radians(3276.7)


def log(position: Array, labels: tuple[str, ...] = ("wrist",)) -> Recording:
    values = {"position": position, "command": MOVING}
    return Recording(
        "run", {n: Channel(n, labels, "rad", TIME, np.stack([v] * len(labels), axis=1)) for n, v in values.items()}
    )


def spoilt(value: float, *at: int) -> Array:
    position = MOVING.copy()
    position[list(at)] = value
    return position


def test_spikes_are_missing_samples_and_a_note_names_them() -> None:
    (cleaned,), (note,) = without_lone_spikes([log(spoilt(BAD, 150, 333, 334))])
    assert np.flatnonzero(np.isnan(cleaned.channel("position").column("wrist"))).tolist() == [150, 333, 334]
    assert "3 lone samples" in note
    assert "wrist 57.189 rad (3276.7 deg) at 1.5 s" in note
    assert "wrist 57.189 rad (3276.7 deg) at 3.33 s" in note


def test_a_zero_in_place_of_a_position_is_a_spike_too() -> None:
    assert "a lone sample is" in lone_spikes(log(spoilt(0.0, 120)))[1]


@pytest.mark.parametrize(
    "position",
    [
        MOVING,
        (MOVING * 20.0 + math.pi) % math.tau - math.pi,  # an encoder that begins anew
        np.where(TIME < 4.0, MOVING, MOVING + math.tau),  # once
        np.where(np.abs(TIME - 4.0) < 0.025, 0.3, 0.0) + 0.05 * np.sin(TIME),  # knocked for five samples
        np.where(TIME % 2.0 < 1.0, 0.0, 1.0) + 0.5 * (np.abs(TIME - 5.5) < 1e-3),  # less than it goes elsewhere
        np.random.default_rng(1).normal(size=len(TIME)),
    ],
    ids=["smooth", "wraps", "one wrap", "a knock", "a step", "noise"],
)
def test_what_moves_has_no_spikes(position: Array) -> None:
    recording = log(position)
    assert lone_spikes(recording) == (recording, "")


def test_spikes_are_no_wraps(tmp_path: Path) -> None:
    spiked = log(spoilt(BAD, 150, 333))
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="wrist"/><geom size=".05" mass="1" pos=".1 0 0"/></body></worldbody>'
        '<actuator><position name="servo" joint="wrist" kp="5"/></actuator></mujoco>'
    )
    ready = prepare(path, [spiked], propose=False)
    assert [d.name for d in ready.diagnoses] == ["spikes"]
    assert float(np.nanmax(np.abs(ready.recordings[0].channel("position").values))) < 0.4
    refused = prepare(path, [spiked], propose=False, refuse=["spikes"])
    assert "turns" in [d.name for d in refused.diagnoses if not d.refused]


@pytest.mark.parametrize("labels", [("wrist",), ("left", "right")])
def test_inspect_names_spikes_and_no_wraps(labels: tuple[str, ...]) -> None:
    found = inspect(log(spoilt(BAD, 150, 333), labels)).findings()
    assert any("lone samples" in sentence for sentence in found)
    assert not any("jumps by" in sentence for sentence in found)
