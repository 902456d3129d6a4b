# SPDX-License-Identifier: Apache-2.0
"""Where predictions of a drive begin: at rest, where the robot stood when it was first commanded; else as the model goes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.beginning import as_tracked
from trueup.engines.vehicle.judging import Ahead
from trueup.engines.vehicle.vehicle import TURNED
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.recording import Channel, Recording
from trueup.samples import MOSTLY
from trueup.tracking.past import Past
from trueup.tracking.rest import stood
from trueup.trial import Trial

Array = NDArray[np.float64]
ROBOT = {
    "speed_gain": 3.0, "acceleration_limit": 1.0, "braking_limit": 2.0, "turn_left": 0.9, "turn_right": 0.9, "turn_lag": 0.08,
    "turn_change_limit": 50.0, "speed_delay": 0.06, "turn_delay": 0.06, "speed_kept": 1.0, "speed_scale": 1.0,
}  # fmt: skip
EXACT = dict.fromkeys(("push_lasts", "trim_lasts", "pose_ahead", "pose_turn", "turn_offset", "speed_lag"), 0.0)
STEP = 2e-4  # s


def log(seconds: float = 6.0, noise: float = 0.0, seed: int = 0) -> tuple[Recording, Array]:
    """A robot on two wheels that stands when its first command comes, and (T, 5) what it does: pose, speed, turn rate."""
    x = y = psi = v = w = 0.0
    told, rows = ((0.8, 1.2), (-0.3, -0.7), (0.5, 0.9)), []
    for k in range(round(seconds / STEP)):
        t, late = k * STEP, k * STEP - ROBOT["speed_delay"]
        if k % 100 == 0:
            rows.append([t, *told[int(t / 1.5 + 1e-9) % 3], x, y, psi, v, w])
        speed, turn = told[int(late / 1.5 + 1e-9) % 3] if late >= -1e-9 else (0.0, 0.0)
        push = min(max(ROBOT["speed_gain"] * (speed - v), -ROBOT["braking_limit"]), ROBOT["acceleration_limit"])
        faster, bent = v + STEP * push, w + STEP / ROBOT["turn_lag"] * (ROBOT["turn_left"] * turn - w)
        x, y = x + 0.5 * STEP * (v + faster) * math.cos(psi), y + 0.5 * STEP * (v + faster) * math.sin(psi)
        psi, v, w = psi + 0.5 * STEP * (w + bent), faster, bent
    table = np.array(rows)
    seen = table[:, 3:6] + noise * np.random.default_rng(seed).standard_normal((len(table), 3))
    channels = {
        "command": Channel("command", ("throttle", "steering"), "", table[:, 0], table[:, 1:3]),
        "position": Channel("position", ("x", "y"), "m", table[:, 0], seen[:, :2]),
        "heading": Channel("heading", ("heading",), "rad", table[:, 0], seen[:, 2:]),
    }
    return Recording("log", channels), table[:, 3:]


def robot() -> VehicleSimulator:
    return VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values={**ROBOT, **EXACT}))


@pytest.mark.parametrize("noise", [0.0, 3e-3])
def test_a_log_whose_robot_stood_when_it_was_first_commanded_begins_at_rest(noise: float) -> None:
    recording, true = log(2.5, noise)
    trial, simulator = Trial.of(recording, ["position", "heading"]), robot()
    past = simulator.past(trial)
    assert past.log_begin[2] > 0
    assert not past.commands[: past.log_begin[0]].any()
    starts, first = np.array([past.log_begin[1]]), np.array([0, 2])
    begun, later = simulator.predict(past, simulator.rows(np.zeros(0))[0], starts, first, np.array([0.0, 1.0]))[0]
    at = past.begin + past.step * (starts[0] + np.array([0.0, 100.0]))
    speeds = np.stack([np.interp(at, recording.channel("position").time, column) for column in true.T], axis=1)
    assert begun[3:] == pytest.approx(speeds[0, 3:], abs=3e-3)
    assert later[2] == pytest.approx(speeds[1, 2], abs=2e-3 + noise)


def test_a_command_that_was_told_before_the_log_began_is_believed_once_the_speed_is_seen() -> None:
    recording, true = log(2.5)
    gone = 3  # samples of 0.02 s, as long as commands are late: it moves at once
    channels = {
        n: c if n == "command" else c.replace(time=c.time[:-gone], values=c.values[gone:])
        for n, c in recording.channels.items()
    }
    trial, simulator = Trial.of(recording.replace(channels=channels), ["position", "heading"]), robot()
    past = simulator.past(trial)
    starts = np.array([past.log_begin[0] + round(0.4 / past.step)])
    assert past.known[starts[0]]
    found = simulator.predict(past, simulator.rows(np.zeros(0))[0], starts, np.array([0, 1]), np.array([0.8]))[0]
    at, time = past.begin + past.step * float(starts[0]) + 0.8, recording.channel("position").time[:-gone]
    wanted = [np.interp(at, time, column[gone:]) for column in true.T]
    assert np.linalg.norm(found[0, :2] - wanted[:2]) < 0.02


def test_a_prediction_keeps_the_speed_that_the_true_model_carries_while_it_changes() -> None:
    recording, true = log()
    trial, simulator = Trial.of(recording, ["position", "heading"]), robot()
    past = simulator.past(trial)
    starts = np.arange(past.log_begin[1], len(past.known) - 120, 7)
    starts = starts[past.known[starts]]
    first, since = np.arange(len(starts) + 1) * 2, np.tile([0.0, 1.0], len(starts))
    found = simulator.predict(past, simulator.rows(np.zeros(0))[0], starts, first, since)[0].reshape(-1, 2, 5)
    at = past.begin + past.step * (starts[:, None] + np.array([0.0, 100.0]))
    wanted = np.stack([np.interp(at, recording.channel("position").time, column) for column in true.T], axis=2)
    seen = past.seen[starts, 3] - wanted[:, 0, 3]
    assert np.abs(seen).max() > 0.05  # a tracked speed lags where it changes
    assert np.abs(found[:, 0, 3] - wanted[:, 0, 3]).max() < 6e-3
    assert np.linalg.norm(found[:, 1, :2] - wanted[:, 1, :2], axis=1).max() < 6e-3


def test_half_the_step_predicts_the_same() -> None:
    recording, _ = log()
    trial, simulator = Trial.of(recording, ["position", "heading"]), robot()
    coarse, fine = (
        s.rollout([trial], np.zeros((1, 0)))[0].channels["position"][0] for s in (simulator, simulator.at_step(0.002))
    )
    assert np.linalg.norm(coarse - fine, axis=1).max() < 4e-3


def test_a_models_speed_is_taken_as_a_tracked_one_is() -> None:
    recording, true = log(3.0)
    past = Past.of(Trial.of(recording, ["position", "heading"]), 0.01, ("throttle", "steering"), turned=True)
    ring, sums = np.zeros(past.lag), np.zeros(2)
    grid = past.begin + past.step * np.arange(len(past.seen))
    speeds = np.interp(grid, recording.channel("position").time, true[:, 3])
    taken = [as_tracked(k, 0.5 * (speeds[k] + speeds[k + 1]), ring, sums) for k in range(len(grid) - 5)]
    known = np.flatnonzero(past.known[:-5])[20:]
    assert np.array(taken)[known - 1] == pytest.approx(past.seen[known, 3], abs=2e-3)


def test_what_stands_is_told_from_what_goes_on() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 1.0, 0.02)
    for noise in (0.0, 1e-3, 4e-3):
        held = [noise * rng.standard_normal((len(time), 3)) for _ in range(20)]
        since = np.maximum(time - 0.04, 0.0)[:, None] * [0.8, 0.2, 1.0]
        assert np.mean([stood(time, h, 0.0) for h in held]) > 0.7  # the others do not move either way
        assert all(stood(time, h + since**2, 0.0) for h in held)
        assert not any(stood(time, h + 0.5 * time[:, None] * [0.8, 0.2, 1.0], 0.0) for h in held)
        assert not any(stood(time, h + 0.5 * time[:, None] * [0.8, 0.2, 1.0], 0.5) for h in held)
        assert np.mean([stood(time, h + np.maximum(time - 0.5, 0.0)[:, None], 0.5) for h in held]) > 0.7
    assert not stood(time[:3], np.zeros((3, 3)), 0.0)  # too little
    assert not stood(time + 1.0, np.zeros((len(time), 3)), 0.0)  # commanded long before it was seen


def test_noise_of_the_pose_at_a_start_is_taken_out_of_all_that_follows() -> None:
    simulator, shares = robot(), []
    for noise in (1e-4, 4e-3):
        recording, _ = log(6.0, noise)
        trial = Trial.of(recording, ["position", "heading"])
        (done,) = simulator.rollout([trial], np.zeros((1, 0)))
        plain = Ahead(simulator, [recording])
        counted = plain.compared(recording, trial)
        before = plain.residual(recording, done)[:, counted]
        level = float(np.sqrt(np.mean(before**2)))
        freed = Ahead(simulator, [recording], level=level)
        after = freed.residual(recording, done)[:, counted]
        shares.append(freed.noise_of_starts(plain.residuals(np.zeros(0), [recording]), [recording]))
        assert np.linalg.norm(after) < np.linalg.norm(before)
    assert shares[0] < 1.0 - MOSTLY < shares[1]


def test_turn_rates_are_told_better_where_the_noise_of_starts_is_taken_out() -> None:
    drives = [log(6.0, 5e-3, seed)[0].replace(name=f"drive {seed}") for seed in range(3)]
    simulator = VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values={**ROBOT, **EXACT}))
    space = simulator.vehicle.space(["turn_left", "turn_right"])
    simulator = VehicleSimulator(simulator.vehicle, space)
    off = []
    for level in (None, 0.25):
        problem = Problem(simulator, drives, Ahead(simulator, drives, level=level))
        step = np.zeros(len(space.names))
        columns = []
        for k in (space.index("turn_left"), space.index("turn_right")):
            step[:] = space.nominal
            step[k] += 1e-3
            columns.append((problem.residuals(step[None])[0] - problem.residuals(space.nominal[None])[0]) / 1e-3)
        jacobian = np.stack(columns, axis=1)
        off.append(np.linalg.lstsq(jacobian, -problem.residuals(space.nominal[None])[0], rcond=None)[0])
    assert np.linalg.norm(off[1]) < 0.5 * np.linalg.norm(off[0])


def test_a_fix_in_a_second_is_enough_to_be_predicted_from() -> None:
    """Its speed is seen over longer than the past lasts over which it is compared with the model's."""
    recording, _ = log(20.0)
    lasting = {"push_lasts": 0.5, "trim_lasts": 0.5, "speed_kept": 0.0}
    for rate in (1.0, 2.0):
        every = round(50.0 / rate)
        slow = [recording.channel(n) for n in ("position", "heading")]
        seen = {c.name: c.replace(time=c.time[::every], values=c.values[::every]) for c in slow}
        trial = Trial.of(recording.replace(channels={**recording.channels, **seen}), ["position", "heading"])
        vehicle = Vehicle("robot", 0.4, drive=TURNED, values={**ROBOT, **EXACT, **lasting})
        (done,) = VehicleSimulator(vehicle).rollout([trial], np.zeros((1, 0)))
        assert not done.failures
        assert np.isfinite(done.channels["position"]).all()


def test_a_piece_of_a_drive_may_be_shorter_than_what_a_slow_receiver_is_seen_over() -> None:
    recording, _ = log(20.0)
    slow = [recording.channel(n) for n in ("position", "heading")]
    seen = {c.name: c.replace(time=c.time[::50], values=c.values[::50]) for c in slow}
    trial = Trial.of(recording.replace(channels={**recording.channels, **seen}), ["position", "heading"])
    drive = Past.of(replace(trial, duration=0.1), 0.01, ("throttle", "steering"))
    assert drive.doubt == pytest.approx([0.0, 0.0, 0.0, 0.0])


def test_noise_of_the_speed_at_a_start_does_not_bend_how_a_speed_is_pursued() -> None:
    """Braking, limits and delays are fitted to two noisy logs: a speed that is taken as exact where predictions begin
    moves them by 3 % (root mean square; the delay by 8).
    """
    names = ("speed_gain", "acceleration_limit", "braking_limit", "speed_delay")
    vehicle = Vehicle("robot", 0.4, drive=TURNED, values={**ROBOT, **EXACT})
    simulator, wrong = VehicleSimulator(vehicle, vehicle.space(names)), []
    truth, free = simulator.parameters.nominal, simulator.parameters.free
    for seed in (2, 3):
        recording, _ = log(24.0, 3e-3, seed)
        each = Ahead(simulator, [recording]).residuals(truth, [recording])[0]
        measure = Ahead(simulator, [recording], level=float(np.sqrt(np.mean(each[each != 0.0] ** 2))), values=truth)

        def residual(values: Array, recording: Recording = recording, measure: Ahead = measure) -> Array:
            full = truth.copy()
            full[free] = values
            return measure.residuals(full, [recording])[0]

        found = least_squares(residual, truth[free], diff_step=1e-2, x_scale=truth[free], max_nfev=15).x
        wrong.append(found / truth[free] - 1.0)
    assert np.sqrt(np.mean(np.square(wrong))) < 0.02


def test_whether_a_command_is_slow_or_a_controller_soft_is_told_where_noise_of_starts_is_eliminated(
    tmp_path: Path,
) -> None:
    """The search goes on from where all drives were replayed, and from a slow command in place of the soft controller."""
    file, drives = tmp_path / "base.toml", []
    file.write_text("[vehicle]\nwheelbase = 0.4\n")
    for seed in range(3):
        recording, _ = log(6.0, 1e-3, seed)  # with twice the noise, searches of drives that differ by 1e-12 m part
        told = recording.channel("command").replace(labels=("speed", "turn"), units=("m/s", "rad/s"))
        drives.append(recording.replace(name=f"drive_{seed}", channels={**recording.channels, "command": told}))
    found = {
        e.name: e.value for e in prepare(file, drives).calibrate(Options(cross_validate=False, lacking=False)).estimates
    }
    assert found["speed_gain"] == pytest.approx(ROBOT["speed_gain"], rel=0.1)
    assert found["braking_limit"] == pytest.approx(ROBOT["braking_limit"], rel=0.1)
    assert [found["speed_lag"], found["speed_delay"]] == pytest.approx([0.0, ROBOT["speed_delay"]], abs=0.02)
