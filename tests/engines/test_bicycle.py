# SPDX-License-Identifier: Apache-2.0
"""The bicycle: circles, delays and limits as physics has them, and calibration that recovers hidden values."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.kinds import bicycle, drives
from trueup.controllers.stanley import Stanley, StanleySettings
from trueup.discrepancies.rigid import RigidlyAligned
from trueup.ends import Arrived, Left
from trueup.engines.vehicle import BETAS, BicycleSimulator, Vehicle, vehicle_space
from trueup.engines.vehicle.vehicle import DRIVES, PURSUED
from trueup.errors import ModelError, ParameterError, RecordingError, UnknownNameError
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import DESCENT
from trueup.paths.courses import hairpin
from trueup.recording import Channel, Recording
from trueup.tasks.follow_path import FollowPath
from trueup.testing import check_simulator
from trueup.tracking.windows import windows
from trueup.trial import Observed, Trial
from trueup.verdicts import judged

BARE = Vehicle("bare", wheelbase=0.55, max_steering=0.698)


def played(speed: object, steering: object, duration: float = 8.0, start: float = 0.5) -> Trial:
    """A trial under recorded commands (numbers or arrays at 50 Hz), already moving at `start` m/s."""
    time = np.arange(round(duration * 50) + 1) / 50.0
    command = np.stack(np.broadcast_arrays(np.asarray(speed, float), np.asarray(steering, float), time)[:2], axis=1)
    labels = {"position": ("x", "y"), "heading": ("heading",), "speed": ("speed",), "yaw_rate": ("yaw_rate",)}
    units = {"position": "m", "heading": "rad", "speed": "m/s", "yaw_rate": "rad/s"}
    zero = np.zeros(1)
    return Trial(
        "played", 0.0, duration, Channel("command", ("speed", "steering"), "", time, command),
        {name: Observed(label, units[name], time) for name, label in labels.items()},
        initial={"position": Channel("position", ("x", "y"), "m", zero, np.zeros((1, 2))),
                 "heading": Channel("heading", ("heading",), "rad", zero, np.zeros((1, 1))),
                 "speed": Channel("speed", ("speed",), "m/s", zero, np.array([[start]]))},
    )  # fmt: skip


def run(trial: Trial, names: tuple[str, ...] = (), *values: float, step: float = 0.02) -> dict[str, np.ndarray]:
    simulator = BicycleSimulator(BARE, vehicle_space(BARE, names), step=step)
    (rollout,) = simulator.rollout([trial], np.array([values]))
    return {name: channel[0] for name, channel in rollout.channels.items()}


def test_constant_steering_drives_an_exact_circle() -> None:
    found = run(played(0.5, 0.3))
    radius = 0.55 / np.tan(0.3)
    np.testing.assert_allclose(np.hypot(found["position"][:, 0], found["position"][:, 1] - radius), radius, atol=1e-12)
    assert found["heading"][-1, 0] == pytest.approx(0.5 * 8.0 / radius)


def test_delays_are_pure_and_linear_between_ticks() -> None:
    time = np.arange(401) / 50.0
    wave = 0.3 * np.sin(1.5 * time)
    late = run(played(0.5, wave), ("steering_delay",), 0.35)["yaw_rate"][30:, 0]
    at = time[30:] - 0.02 - 0.35  # a step shows what was commanded at its beginning
    np.testing.assert_allclose(late, 0.5 * np.tan(0.3 * np.sin(1.5 * at)) / 0.55, atol=2e-4)
    faster = 0.5 + 0.2 * np.sin(1.5 * time)
    speed = run(played(faster, 0.0), ("speed_delay",), 0.2)["speed"][30:, 0]
    np.testing.assert_allclose(speed, 0.5 + 0.2 * np.sin(1.5 * (time[30:] - 0.22)), atol=2e-4)


def test_limits_of_table_ii_are_kept() -> None:
    jump = np.where(np.arange(401) > 100, 0.6, 0.0)
    found = run(played(0.2 + jump, jump), BETAS, 0.0, 0.0, 0.4, 0.7, 0.9)
    rate = np.diff(found["yaw_rate"][:, 0]) * 50.0
    assert rate.max() == pytest.approx(0.9)
    assert found["yaw_rate"].max() == pytest.approx(0.7)
    assert (np.diff(found["speed"][:, 0]) * 50.0).max() == pytest.approx(0.4)


def test_lags_slack_scales_and_understeer_do_what_their_names_say() -> None:
    jump = np.where(np.arange(401) > 50, 0.3, 0.0)
    late = run(played(0.5, jump), ("steering_lag",), 0.4)["yaw_rate"][:, 0]
    steady = 0.5 * np.tan(0.3) / 0.55
    assert late[51 + 20] == pytest.approx(0.5 * np.tan(0.3 * (1 - np.exp(-1.0))) / 0.55, rel=0.06)
    assert late[-1] == pytest.approx(steady, rel=1e-3)
    wave = 0.3 * np.sin(np.arange(401) / 50.0)
    slack = run(played(0.5, wave), ("steering_slack",), 0.1)["yaw_rate"][:, 0]
    assert slack.max() == pytest.approx(0.5 * np.tan(0.25) / 0.55, rel=1e-3)
    assert run(played(0.5, 0.3), ("understeer",), 0.4)["yaw_rate"][-1, 0] == pytest.approx(steady / 1.1)
    assert run(played(0.5, 0.3), ("wheel_scale",), 0.9)["yaw_rate"][-1, 0] == pytest.approx(0.9 * steady)
    turned = run(played(0.5, 0.3), ("steering_scale", "steering_offset"), 0.8, 0.02)["yaw_rate"][-1, 0]
    assert turned == pytest.approx(0.5 * np.tan(0.26) / 0.55)


def test_halving_the_step_halves_the_error() -> None:
    time = np.arange(401) / 50.0
    trial = played(0.5 + 0.2 * np.sin(time), 0.4 * np.sin(1.7 * time))
    names, values = ("steering_lag", "speed_lag"), (0.2, 0.2)
    exact = run(trial, names, *values, step=0.0005)["position"][-1]
    errors = [np.abs(run(trial, names, *values, step=h)["position"][-1] - exact).max() for h in (0.02, 0.01)]
    assert errors[1] < 0.6 * errors[0] < 0.03


def test_what_a_controller_commanded_replays_the_same_drive() -> None:
    task = FollowPath([hairpin((0.6,))])
    simulator = BicycleSimulator(BARE, vehicle_space(BARE, ("steering_delay", "speed_delay")))
    (driven,) = simulator.rollout(task.trials, np.array([[0.31, 0.17, 1.0, 1.0, 1.0]]), task.controllers)
    fine = np.arange(round(task.trials[0].duration * 50)) / 50.0
    everything = Trial(
        "all", 0.0, task.trials[0].duration, None,
        {"command": Observed(("speed", "steering"), "", fine), "position": Observed(("x", "y"), "m", fine)},
        task.trials[0].initial, references=task.trials[0].references,
    )  # fmt: skip
    (seen,) = simulator.rollout([everything], np.array([[0.31, 0.17, 1.0, 1.0, 1.0]]), task.controllers)
    again = Trial(
        "again", 0.0, everything.duration, Channel("command", ("speed", "steering"), "", fine, seen.channels["command"][0]),
        {"position": everything.observed["position"]}, everything.initial,
    )  # fmt: skip
    (replayed,) = simulator.rollout([again], np.array([[0.31, 0.17]]))
    np.testing.assert_allclose(replayed.channels["position"], seen.channels["position"], atol=1e-9)
    assert driven.failures == {}


def test_the_compiled_controller_drives_as_the_one_in_numpy() -> None:
    task = FollowPath([hairpin()], names=("k1", "k2", "k3", "softening", "heading_gain", "yaw_damping", "lead"))
    names = (*BETAS, "steering_lag", "steering_slack", "position_noise", "heading_noise", "localisation_latency")
    model = [0.12, 0.2, 0.5, 1.2, 3.0, 0.1, 0.02, 0.005, 0.004, 0.05]
    gains = [[1.0, 1.0, 1.0, 0.2, 1.0, 0.0, 0.0], [2.0, 1.5, 1.2, 0.3, 0.9, 0.1, 0.2]]
    values = np.array([model + g for g in gains])
    both = [
        BicycleSimulator(BARE, vehicle_space(BARE, names), compiled=c).rollout(task.trials, values, task.controllers)[0]
        for c in (True, False)
    ]
    for name in both[0].channels:
        np.testing.assert_allclose(both[0].channels[name], both[1].channels[name], atol=1e-9, err_msg=name)


def test_a_drive_ends_where_it_arrives_or_leaves_its_area() -> None:
    """A row with hardly any steering leaves the hairpin; the other arrives, and drives as it would without ends."""
    task = FollowPath([hairpin((0.6,))], names=("k2", "heading_gain"))
    (trial,) = task.trials
    x, y = task.paths[0].points[int(0.9 * len(task.paths[0].points))]
    low, high = task.paths[0].points.min(axis=0) - 1.0, task.paths[0].points.max(axis=0) + 1.0
    area = {"x": (low[0], high[0]), "y": (low[1], high[1])}
    ends = (Left("position", area), Arrived("position", {"x": x, "y": y}, 0.6))
    simulator = BicycleSimulator(BARE, vehicle_space(BARE, ()))
    gains = np.array([[1.0, 1.0], [0.05, 0.2]])
    (whole,) = simulator.rollout([trial], gains, task.controllers)
    (ended,) = simulator.rollout([replace(trial, ends=ends)], gains, task.controllers)
    assert {row: end.name for row, end in ended.ends.items()} == {0: "arrived", 1: "left the area"}
    assert ended.failures == {}
    assert ended.ends[0].at < trial.duration
    for name, channel in ended.channels.items():
        lasted = ended.lasted(name)
        np.testing.assert_allclose(channel[lasted], whole.channels[name][lasted], atol=1e-9)
        assert np.isnan(channel[~lasted]).all()
    last = ended.channels["position"][0][ended.lasted("position")[0]][-1]
    assert np.hypot(*(last - [x, y])) == pytest.approx(0.6, abs=0.05)
    assert task.score([ended])[0] < task.score([ended])[1]
    with pytest.raises(ModelError, match="'bare, under recorded commands' does not support ends"):
        simulator.rollout([replace(played(0.5, 0.3), ends=ends)], np.zeros((1, 0)))


def wandering(names: tuple[str, ...], values: list[float], seed: int, noise: float = 0.003) -> Recording:
    """A drive under commands that show everything, measured with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(3001) / 50.0
    steering = 0.45 * np.sin(0.9 * time) + 0.2 * np.sign(np.sin(0.37 * time))
    speed = 0.55 + 0.25 * np.sign(np.sin(0.21 * time)) + 0.1 * np.sin(1.1 * time)
    trial = played(speed, steering, 60.0, 0.8)
    simulator = BicycleSimulator(BARE, vehicle_space(BARE, names))
    truth = simulator.rollout([trial], np.array([values]))[0].recording()
    noisy = {
        n: c if n == "command" else c.replace(values=c.values + noise * rng.standard_normal(c.values.shape))
        for n, c in truth.channels.items()
    }
    return Recording(f"drive {seed}", noisy)


@pytest.mark.parametrize("seed", range(3))
def test_calibration_recovers_the_five_betas(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = [
        rng.uniform(0.05, 0.4),
        rng.uniform(0.05, 0.4),
        rng.uniform(0.3, 0.6),
        rng.uniform(0.45, 0.6),
        rng.uniform(0.6, 1),
    ]
    pieces = windows(wandering(BETAS, truth, seed), 8.0)
    channels = ("position", "heading", "speed", "yaw_rate")
    found = calibrate(
        BicycleSimulator(BARE, vehicle_space(BARE, BETAS)), pieces,
        options=Options(channels=channels, cross_validate=False, stages=DESCENT),
        discrepancy=RigidlyAligned.estimated(pieces, channels),
    )  # fmt: skip
    np.testing.assert_allclose(found.values, truth, rtol=0.03, atol=0.01)


def test_a_limit_that_a_drive_never_meets_is_no_limit_of_the_simulator_in_which_gains_are_searched() -> None:
    time, names = np.arange(1501) / 50.0, ("steering_delay", "steering_rate_limit", "acceleration_limit")
    gentle = played(0.6 + 0.1 * np.sin(0.4 * time), 0.3 * np.sin(0.6 * time), 30.0, 0.6)
    simulator = BicycleSimulator(BARE, vehicle_space(BARE, names))
    truth = simulator.rollout([gentle], np.array([[0.2, 1e3, 1e3]]))[0].recording()
    noise = np.random.default_rng(0)
    noisy = {
        n: c if n == "command" else c.replace(values=c.values + 0.003 * noise.standard_normal(c.values.shape))
        for n, c in truth.channels.items()
    }
    pieces = windows(Recording("gentle", noisy), 6.0)
    measure = RigidlyAligned.estimated(pieces, ("position", "heading"))
    found = calibrate(
        simulator, pieces, options=Options(cross_validate=False, lacking=False, stages=DESCENT), discrepancy=measure
    )
    delay, *limits = found.estimates
    assert delay.value == pytest.approx(0.2, abs=0.02)
    assert [(e.value, e.absent) for e in limits] == [(1e3, True), (1e3, True)]


def test_it_keeps_the_contract_of_a_simulator() -> None:
    check_simulator(BicycleSimulator(BARE, vehicle_space(BARE, BETAS)), wandering((), [], 0))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'steering_delay'"):
        vehicle_space(BARE, ("stering_delay",))
    with pytest.raises(UnknownNameError, match="quantity 'mass'"):
        Vehicle("heavy", 0.5, 0.5, {"mass": 3.0})
    with pytest.raises(ParameterError, match="wheelbase is -1"):
        Vehicle("inside out", -1.0, 0.5)
    odd = played(0.5, 0.0)
    odd.observed["torque"] = Observed(("front",), "N m", np.zeros(1))  # type: ignore[index]
    with pytest.raises(ModelError, match="no channel 'torque'"):
        BicycleSimulator(BARE).rollout([odd], np.zeros((1, 0)))
    silent = FollowPath([hairpin((0.5,))]).trials
    with pytest.raises(RecordingError, match="no command, and no controller"):
        BicycleSimulator(BARE).rollout(silent, np.zeros((1, 0)))
    with pytest.raises(RecordingError, match="no reference 'path'"):
        BicycleSimulator(BARE).rollout([played(0.5, 0.0)], np.ones((1, 3)), lambda v: Stanley(v, StanleySettings()))


def test_every_quantity_that_is_absent_changes_nothing() -> None:
    trial = played(0.5, 0.3 * np.sin(np.arange(401) / 30.0))
    plain = run(trial)
    for q in DRIVES["speed"]:
        alone = Vehicle("one", 0.55, 0.698, {q.name: q.absent})
        (rollout,) = BicycleSimulator(alone).rollout([trial], np.zeros((1, 0)))
        np.testing.assert_array_equal(rollout.channels["position"][0], plain["position"])


def test_the_table_of_quantities_in_the_docs_is_complete() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "vehicles.md"
    rows = re.findall(
        r"^\| `(\w+)` \| (\S+) \| (\S+) \.\.\. (\S+) \| ([^|]+) \|$", page.read_text("utf-8"), re.MULTILINE
    )
    known = [(q.name, q.unit or "-", f"{q.lower:g}", f"{q.upper:g}", q.about) for q in DRIVES["speed"]]
    assert rows == known


def test_wheels_that_take_long_from_side_to_side_are_where_all_that_was_commanded_has_brought_them() -> None:
    """Steering at 0.2 rad/s is told from delay, lag and play in windows that begin while it is on its way."""
    rng = np.random.default_rng(1)
    time = np.arange(3001) / 50.0
    steering = np.repeat(rng.uniform(-0.8, 0.8, 21), 150)[: len(time)]
    truth = {"steering_delay": 0.1, "steering_lag": 0.35, "steering_rate_limit": 0.2}
    (done,) = BicycleSimulator(Vehicle("truck", 1.4, 0.9, truth), step=0.01).rollout(
        [played(0.8 + 0.3 * np.sin(0.4 * time), steering, duration=60.0, start=0.8)], np.zeros((1, 0))
    )
    noise = {"position": 0.01, "heading": 0.003, "speed": 0.005, "yaw_rate": 0.01, "command": 0.0}
    drive = done.recording()
    drive = drive.replace(channels={
        n: c.replace(values=c.values + rng.normal(0.0, noise[n], c.values.shape)) for n, c in drive.channels.items()
    })  # fmt: skip
    found = drives([drive], bicycle(1.4, 0.9, parameters=(*truth, "steering_slack")))
    assert found.trace[-1].rmse < 0.0105
    estimates = {e.name: e for e in found.estimates}
    assert estimates["steering_rate_limit"].value == pytest.approx(0.2, rel=0.05)
    for name, value in truth.items():
        assert estimates[name].low < value < estimates[name].high, name


@pytest.mark.parametrize("name", ["steering_slack", "speed_lag", "steering_lag", "curve_loss"])
def test_a_lag_or_a_play_of_zero_is_none_rather_than_a_bound_to_widen(name: str) -> None:
    """Play of a steering "wants to go beyond its lower bound: widen it" was said of what cannot be less than none."""
    space = Vehicle("car", 0.3, drive=PURSUED).space()
    verdict = judged(space.parameters[space.index(name)], 0.0, 0.01, 0.0, 0.0, 0.01)
    assert (verdict.word, verdict.note) == ("at bound", f"none is seen ({name} at its lower bound)")
