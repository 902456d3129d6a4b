# SPDX-License-Identifier: Apache-2.0
"""Ends say when a run was over: in simulations, in recordings of robots, and in what is scored of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.controllers.controller import Observation
from trueup.ends import Arrived, Ended, Fallen, Left, When, end_of, ended, which_end, with_end
from trueup.engines.simulator import Rollout, refuse_unsupported
from trueup.errors import ModelError, ParameterError
from trueup.formats import read, write
from trueup.recording import Channel, Recording
from trueup.tasks.task import as_rollout
from trueup.trial import Observed, Trial

TIME = np.linspace(10.0, 14.0, 401)


def toppling() -> Recording:
    """A robot that leans over from 12 s on, by 1 rad/s, and lies on its side from 13.5 s on."""
    lean = np.clip(TIME - 12.0, 0.0, 1.5)
    angles = np.stack([lean, 0.0 * lean, np.full_like(lean, 2.0)], axis=1)
    place = np.stack([0.1 * (TIME - 10.0), 0.0 * lean, np.cos(lean)], axis=1)
    return Recording("r", {
        "base_position": Channel("base_position", ("x", "y", "z"), "m", TIME, place),
        "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", TIME, angles),
    })  # fmt: skip


def trial(**more: object) -> Trial:
    observed = {"base_position": Observed(("x", "z"), "m", np.linspace(0.0, 4.0, 81))}
    return Trial("t", 0.0, 4.0, None, observed, **more)  # type: ignore[arg-type]


def test_lean_is_the_angle_from_upright_whatever_the_heading() -> None:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.2, 1.2, (100, 3))
    seen = Observation(0.0, angles, angles, {}, channels={"base_orientation": angles})
    (roll, pitch), end = angles.T[:2], Fallen(tilt=0.9)
    vertical = np.cos(roll) * np.cos(pitch)  # of the base's own z axis
    assert np.array_equal(end.reached(seen), np.arccos(vertical) > 0.9)
    assert 0 < end.reached(seen).sum() < 100


def test_a_fall_is_seen_in_a_recording_too() -> None:
    fallen, left = Fallen(height=0.2, tilt=0.8), Left("base_position", {"x": (-1.0, 0.25)})
    for ends, at, name in (([fallen], 12.8, "fallen"), ([fallen, left], 12.5, "left the area")):
        end = end_of(toppling(), ends)
        assert end is not None
        assert end.name == name
        assert end.at == pytest.approx(at, abs=0.03)
    assert end_of(toppling(), [Fallen(tilt=1.6)]) is None
    assert end_of(toppling(), [Arrived("heading", {"heading": 0.0}, 1.0)]) is None  # never measured


def test_what_a_driver_says_of_its_run_survives_files_and_slices(tmp_path: Path) -> None:
    recording = with_end(toppling(), Ended(13.25, "left the area"))
    write(recording, tmp_path / "r.parquet")
    (again,) = read(tmp_path / "r.parquet")
    assert ended(again) == Ended(13.25, "left the area")
    assert end_of(again, [Fallen(tilt=0.8)]) == Ended(13.25, "left the area")
    assert ended(again.slice(10.0, 13.25)) == Ended(13.25, "left the area")
    assert ended(again.slice(10.0, 12.0)) is None
    assert ended(toppling()) is None


def test_the_trial_that_repeats_a_run_stops_where_it_ended() -> None:
    again = Trial.of(with_end(toppling(), Ended(12.5, "fallen")))
    assert again.duration == pytest.approx(2.5)
    assert again.observed["base_position"].time[-1] == pytest.approx(12.5)


def test_recordings_that_ended_keep_their_end_where_they_are_scored() -> None:
    told, seen, whole = with_end(toppling(), Ended(11.0, "stopped")), toppling(), toppling().slice(10.0, 12.4)
    rollout = as_rollout(trial(ends=(Fallen(tilt=0.8),)), [told, seen, whole])
    assert rollout.ends[0] == Ended(1.0, "stopped")
    assert rollout.ends[1].name == "fallen"
    assert rollout.ends[1].at == pytest.approx(2.8, abs=0.03)
    assert 2 not in rollout.ends
    lasted = np.isfinite(rollout.channels["base_position"][:, :, 0]).sum(axis=1)
    assert lasted.tolist() == [21, 57, 49]
    assert rollout.failures == {}


def test_what_was_last_known_is_held_from_an_end_on() -> None:
    values = np.tile(np.arange(81.0)[None, :, None], (2, 1, 2))
    values[0, 21:] = np.nan
    rollout = Rollout(trial(), {"base_position": values}, {}, {0: Ended(1.0, "fallen")})
    held = rollout.held().channels["base_position"]
    assert np.array_equal(held[0, :21], values[0, :21])
    assert (held[0, 21:] == 20.0).all()
    assert np.array_equal(held[1], values[1])
    assert rollout.recording(0).stop == 1.0
    assert ended(rollout.recording(0)) == Ended(1.0, "fallen")
    assert ended(rollout.recording(1)) is None


def test_the_first_of_several_conditions_counts_and_shapes_are_checked() -> None:
    seen = Observation(1.0, np.zeros((3, 1)), np.zeros((3, 1)), {})
    ends = [When("a", lambda o: np.array([False, True, False])), When("b", lambda o: np.array([False, True, True]))]
    assert which_end(ends, [seen, seen], 3).tolist() == [-1, 0, 1]
    with pytest.raises(ParameterError, match=r"end 'c' gave shape \(\) for 3 runs"):
        which_end([When("c", lambda o: True)], [seen], 3)  # type: ignore[arg-type,return-value]
    with pytest.raises(ParameterError, match="give the least height"):
        Fallen()


def test_a_simulator_without_ends_says_which_trial_declares_what() -> None:
    with pytest.raises(ModelError, match=r"'toy' does not support ends; trial 't' declares ends: fallen"):
        refuse_unsupported("toy", [trial(), trial(ends=(Fallen(tilt=1.0),))], "ends", "sensing")
