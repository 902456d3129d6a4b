# SPDX-License-Identifier: Apache-2.0
"""The Stanley law: converges as its authors say, never looks back, switches its gains with hysteresis."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.controllers.controller import Observation
from trueup.controllers.stanley import Stanley, StanleySettings
from trueup.engines.vehicle import BicycleSimulator, Vehicle
from trueup.errors import ParameterError, RecordingError
from trueup.paths import Path
from trueup.recording import Channel
from trueup.tasks.follow_path import trial_of
from trueup.trial import Trial

STRAIGHT = Path.from_points("straight", [[0.0, 0.0], [40.0, 0.0]], speed=0.9)
VEHICLE = Vehicle("plain", wheelbase=0.55, max_steering=0.698)


def offset_start(trial: Trial, left: float) -> Trial:
    position = trial.initial["position"]
    moved = position.replace(values=position.values + np.array([[0.0, left]]))
    speed = Channel("speed", ("speed",), "m/s", position.time, np.array([[0.9]]))
    return Trial(
        trial.name, 0.0, trial.duration, None, trial.observed, {**trial.initial, "position": moved, "speed": speed},
        references=trial.references,
    )  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_small_offset_decays_exponentially_at_the_rate_of_the_gain(side: float) -> None:
    gain, soft = 0.8, 0.02
    settings = StanleySettings()
    trial = offset_start(trial_of(STRAIGHT, settings), 0.05 * side)
    (driven,) = BicycleSimulator(VEHICLE, step=0.005).rollout(
        [trial], np.array([[gain, gain, gain, soft]]),
        lambda v: Stanley(v, settings, names=("k1", "k2", "k3", "softening")),
    )  # fmt: skip
    position, heading = driven.channels["position"][0], driven.channels["heading"][0, :, 0]
    front = position[:, 1] + 0.55 * np.sin(heading)
    time = trial.observed["position"].time
    moving = (time > 0.5) & (time < 5.0)
    assert np.all(front[moving] * side > 0.0)
    rate = -np.polyfit(time[moving], np.log(np.abs(front[moving])), 1)[0]
    assert rate == pytest.approx(gain * 0.9 / (0.9 + soft), rel=0.02)  # Thrun et al. 2006: x(t) = x(0) exp(-k t)


def test_the_signs_bring_it_back_from_both_sides_and_any_heading() -> None:
    law = Stanley(np.ones((4, 3)), path=STRAIGHT)
    pose = np.array([[5.0, 0.3, 0.0], [5.0, -0.3, 0.0], [5.0, 0.0, 0.3], [5.0, 0.0, -0.3 + 2 * np.pi]])
    seen = Observation(0.0, pose, np.tile([0.9, 0.0], (4, 1)), {})
    law.reset(seen)
    speed, steering = law.command(seen).T
    np.testing.assert_allclose(speed, 0.9)
    assert (np.sign(steering) == [-1, 1, -1, 1]).all(), "to the left of the path or turned left: steer right"


def test_it_never_looks_back_where_the_path_crosses_itself() -> None:
    angle = np.linspace(0.0, 4.0 * np.pi, 400)
    twice = Path.from_points("two rounds", np.stack([np.cos(angle), np.sin(angle)], axis=1))
    law = Stanley(np.ones((1, 3)), path=twice)
    arcs = []
    for a in np.linspace(0.0, 3.9 * np.pi, 300):
        heading = a + np.pi / 2
        rear = [np.cos(a) - 0.55 * np.cos(heading), np.sin(a) - 0.55 * np.sin(heading), heading]
        seen = Observation(0.0, np.array([rear]), np.array([[0.5, 0.5]]), {})
        if a == 0.0:
            law.reset(seen)
        law.command(seen)
        arcs.append(law.arc[0])
    assert np.all(np.diff(arcs) >= 0.0)
    np.testing.assert_allclose(arcs, np.linspace(0.0, 3.9 * np.pi, 300), atol=0.02)
    back = 3.6 * np.pi
    pose = np.array([[np.cos(back) - 0.55, np.sin(back), 0.0]])
    law.command(Observation(0.0, pose, np.array([[0.5, 0.5]]), {}))
    assert law.arc[0] == arcs[-1], "a jump of the pose backward moves nothing"


def test_gains_follow_the_speed_with_hysteresis() -> None:
    law = Stanley(np.array([[1.0, 2.0, 3.0]]), path=STRAIGHT)
    pose = np.array([[5.0, 0.2, 0.0]])
    law.reset(Observation(0.0, pose, np.zeros((1, 2)), {}))
    used = []
    for v in (0.4, 0.51, 0.53, 0.49, 0.47, 0.81, 0.83, 0.79, 0.77, 0.3):
        steering = law.command(Observation(0.0, pose, np.array([[v, 0.0]]), {}))[0, 1]
        used.append(round(np.tan(-steering) * (v + 0.2) / 0.2))
    assert used == [1, 1, 2, 2, 1, 2, 3, 3, 2, 1]


def test_it_stops_at_the_end() -> None:
    law = Stanley(np.ones((1, 3)), path=STRAIGHT)
    seen = Observation(0.0, np.array([[0.0, 0.0, 0.0]]), np.array([[0.9, 0.0]]), {})
    law.reset(seen)
    commands = [
        law.command(Observation(0.0, np.array([[x, 0.0, 0.0]]), np.array([[0.9, 0.0]]), {}))
        for x in np.arange(0, 41, 0.3)
    ]
    assert commands[0][0, 0] == 0.9
    np.testing.assert_array_equal(commands[-1], 0.0)


def test_what_it_cannot_follow_is_refused() -> None:
    with pytest.raises(ParameterError, match="2 values for k1, k2, k3"):
        Stanley(np.ones((1, 2)))
    with pytest.raises(RecordingError, match="no reference 'path'"):
        Stanley(np.ones((1, 3))).reset(Observation(0.0, np.zeros((1, 3)), np.zeros((1, 2)), {}))
