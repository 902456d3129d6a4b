# SPDX-License-Identifier: Apache-2.0
"""Transitions of a humanoid: what counts as standing, start poses that can rest, and a motion that is found and holds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.chance import Push
from trueup.controllers.keyframes import Keyframes, pitch_of
from trueup.ends import Ended
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Rollout
from trueup.errors import ParameterError, TrialError, UnknownNameError
from trueup.loop.confirm import holds, hunt
from trueup.loop.settle import settled
from trueup.studies.balance.scenes import SCENES, STAND, Scene, model_of, pose_of, transition
from trueup.tasks.transitions import Transition

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def sitting() -> tuple[Any, Transition]:
    return transition("sit-to-stand", step=0.004)


def runs(task: Transition, pitch: Array, height: Array, ends: dict[int, Ended] | None = None) -> Rollout:
    """Made-up runs (b, T) of the torso."""
    rows, (trial,) = len(pitch), task.trials
    count = len(trial.observed["base_position"].time)
    angles, place = np.zeros((rows, count, 3)), np.zeros((rows, count, 3))
    angles[:, :, 1], place[:, :, 2] = pitch, height
    joints = np.zeros((rows, count, len(task.motion.joints)))
    return Rollout(trial, {"base_orientation": angles, "base_position": place, "position": joints}, {}, ends or {})


def test_only_who_ends_upright_high_and_still_has_succeeded(sitting: tuple[Any, Transition]) -> None:
    _, task = sitting
    count = len(task.trials[0].observed["base_position"].time)
    time = np.arange(count) / task.rate
    stand = task.final_height
    pitch = np.stack([
        np.maximum(0.6 - time, 0.0),  # rises and stands
        np.full(count, 0.3),  # leans
        np.zeros(count),  # upright, on its knees
        0.2 * np.sin(20.0 * time),  # still rocking
        np.zeros(count),  # stood, and fell in the end
    ])  # fmt: skip
    height = np.stack([np.full(count, z) for z in (stand, stand, 0.6 * stand, stand, stand)])
    done = runs(task, pitch, height, {4: Ended(task.duration - 0.2, "fallen")})
    assert task.succeeded([done]).tolist() == [True, False, False, False, False]
    score = task.score([done])
    assert np.argmin(score) == 0


def test_waiting_and_then_falling_pays_by_the_printed_integral_alone() -> None:
    printed, repaired = (transition("sit-to-stand", step=0.004, fitness=f)[1] for f in ("paper", "repaired"))
    time = printed.trials[0].observed["base_position"].time
    # One rises at once and stands, leaning a little; the other sits upright as long as it may, and falls 0.9 s later.
    pitch = np.stack([np.full(len(time), 0.1), np.where(time < 2.5, 0.1, 1.4)])
    height = np.stack([np.where(time < 0.4, 0.2, 0.3), np.where(time < 2.5, 0.2, 0.08)])
    settings = np.tile(printed.parameters.nominal, (2, 1))
    settings[:, -2:] = [[0.1, 0.3], [0.8, 0.8]]
    done = replace(runs(printed, pitch, height), settings=settings)
    assert np.argmin(printed.score([done])) == 1
    assert np.argmin(repaired.score([done])) == 0
    # Eq. 3 by hand: 1.4 s at 0.1 rad, and 2.5 s at 0.1 rad with 0.1 s on the floor.
    np.testing.assert_allclose(printed.score([done]), [-1.4 / 0.2, -(2.5 / 0.2 + 0.1 / 1.5)], rtol=0.02)
    # Whoever only sits has gained nothing; how long he does so does not matter.
    sitting_still = replace(runs(repaired, pitch[:1] * 0.0 + 0.1, np.full((1, len(time)), 0.2)), settings=settings[:1])
    later = replace(sitting_still, settings=settings[1:])
    assert repaired.score([sitting_still])[0] == repaired.score([later])[0]


def test_whoever_falls_early_keeps_the_tilt_of_the_fall(sitting: tuple[Any, Transition]) -> None:
    _, task = sitting
    count = len(task.trials[0].observed["base_position"].time)
    pitch = np.zeros((2, count))
    pitch[:, 40:] = 1.4
    early = runs(task, pitch, np.full((2, count), 0.3), {0: Ended(41 / task.rate, "fallen")})
    early.channels["base_orientation"][0, 42:] = np.nan
    early.channels["base_position"][0, 42:] = np.nan
    score = task.score([early])
    assert score[0] == pytest.approx(score[1])


@pytest.mark.parametrize("name", ["sit-to-stand", "kneel-to-stand"])
def test_a_motion_is_found_that_holds_under_noise_and_at_finer_steps(name: str) -> None:
    simulator, task = transition(name, step=0.004)
    found = hunt(task, simulator, np.random.default_rng(0), wanted=1, simulations=1600)
    (winner,) = found.winners
    assert min(winner.shares) >= 5 / 6
    # What holds by these replays holds with all clocks and draws of another seed too.
    shares, _ = holds(task, simulator, winner.values, np.random.default_rng(99), steps=(0.002,), replays=10)
    assert shares


def test_who_stays_seated_has_not_risen(sitting: tuple[Any, Transition]) -> None:
    simulator, task = sitting
    (trial,) = task.trials
    held = task.motion.first[None, None].repeat(2, axis=1)
    seated = simulator.rollout(
        [trial], np.zeros((1, 0)), lambda values: Keyframes(held, np.array([[0.0, 1.0]]), task.period)
    )
    assert not task.succeeded(seated)[0]


def test_runs_end_once_they_are_over_and_are_judged_as_if_they_had_gone_on(sitting: tuple[Any, Transition]) -> None:
    simulator, task = sitting
    (trial,) = task.trials
    space, rng = task.parameters, np.random.default_rng(0)
    near = np.clip(space.to_unit(space.nominal) + 0.1 * rng.standard_normal((96, len(space))), 0.0, 1.0)
    candidates = space.from_unit(near)
    on = replace(trial, ends=tuple(e for e in trial.ends if e.name == "fallen"))
    ended, whole = (simulator.rollout([t], candidates, task.controllers)[0] for t in (trial, on))
    stood = task.succeeded([whole])
    assert 5 < stood.sum() < 90
    assert np.array_equal(task.succeeded([ended]), stood)
    stop = np.array([ended.ends[row].at for row in np.flatnonzero(stood)])
    arrival = task.arrivals(ended)[stood]
    assert (stop <= arrival + task.after + 0.03).all()
    assert np.mean(stop - arrival) < 0.9 * task.after  # who stands still stands
    pushed = replace(trial, disturbances=(Push("torso", (1.0, 1.0), (2.5, 2.5), (0.1, 0.1)),)).seeded(rng)
    (going,) = simulator.rollout([pushed], candidates[stood][:3], task.controllers)
    assert not [e for e in going.ends.values() if e.name != "fallen"]  # whether it stands a push is seen after it


def test_a_recording_that_stops_before_it_is_judged_is_no_success(sitting: tuple[Any, Transition]) -> None:
    _, task = sitting
    count = len(task.trials[0].observed["base_position"].time)
    motion = task.parameters.nominal
    arrival = float(task.motion.knots(motion[None])[1][0, -1])
    done = replace(
        runs(task, np.zeros((2, count)), np.full((2, count), task.final_height)), settings=np.tile(motion, (2, 1))
    )
    for row, stop in enumerate((arrival + task.after, arrival + 0.5)):
        for channel in done.channels.values():
            channel[row, int(stop * task.rate) + 1 :] = np.nan
    assert task.succeeded([done]).tolist() == [True, False]


def test_what_a_robot_would_be_sent_leads_to_the_same_end(sitting: tuple[Any, Transition]) -> None:
    simulator, task = sitting
    (planned,) = task.planned(task.parameters.nominal)
    assert planned.command is not None
    assert planned.command.time[-1] >= task.duration
    by_command = simulator.rollout([planned], np.zeros((1, 0)))
    by_controller = simulator.rollout(task.trials, task.parameters.nominal[None], task.controllers)
    np.testing.assert_allclose(task.score(by_command), task.score(by_controller), rtol=0.05)


def test_a_start_that_penetrates_the_floor_or_tips_over_is_named() -> None:
    simulator = MujocoSimulator(model_of("kneel-to-stand"), step=0.004)
    joints = simulator.model.names("actuator")
    with pytest.raises(TrialError, match=r"'low' penetrates .* 0\.1 to 0\.2 m"):
        settled(simulator, joints, pose_of(joints, STAND), [0.1, 0.15, 0.2], name="low")
    rest = settled(simulator, joints, pose_of(joints, STAND), np.linspace(0.2, 0.33, 27).tolist())
    assert rest["base_position"].column("z")[0] == pytest.approx(0.302, abs=2e-3)


@pytest.mark.parametrize("name", sorted(SCENES))
def test_every_scene_begins_at_rest(name: str) -> None:
    _, task = transition(name, step=0.004)
    assert task.parameters.names[-1].startswith("interval")
    scene: Scene = SCENES[name]
    assert abs(float(task.start["base_orientation"].column("pitch")[0]) - scene.pitch) < 0.1


def test_impossible_transitions_are_named(sitting: tuple[Any, Transition]) -> None:
    _, task = sitting
    with pytest.raises(UnknownNameError, match="fitness 'printed'"):
        Transition("x", task.motion, task.start, 0.3, fitness="printed")
    with pytest.raises(ParameterError, match="lacks 'base_position'"):
        Transition("x", task.motion, {"position": task.start["position"]}, 0.3)


def test_what_reacts_to_the_tilt_reacts_on_a_robot_too(sitting: tuple[Any, Transition]) -> None:
    simulator, plain = sitting
    motion = replace(plain.motion, feedback={"heel": (1.0, 0.1)})
    task = replace(plain, motion=motion, tilt=pitch_of())
    candidate = np.concatenate([plain.parameters.nominal, [0.8, 0.05]])
    (planned,) = task.planned(candidate)
    played = simulator.rollout([planned], np.zeros((1, 0)))
    with_it = simulator.rollout(task.trials, candidate[None], task.controllers)
    without = simulator.rollout(plain.planned(plain.parameters.nominal), np.zeros((1, 0)))
    same, other = (
        np.nanmax(np.abs(played[0].channels["position"] - r[0].channels["position"])) for r in (with_it, without)
    )
    assert same < 1e-9
    assert other > 0.05
