# SPDX-License-Identifier: Apache-2.0
"""A car's hidden parameters come back from logs with two clocks and a tracker that loses it; predictions never look ahead."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup import formats
from trueup.calibration import Estimate
from trueup.cli import main
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.family import Vehicles, lasting, with_shares
from trueup.engines.vehicle.kernels import ANGLE, SPEED, STATE, WHEEL, motor_push, on_tyres, steered
from trueup.engines.vehicle.look import Look
from trueup.engines.vehicle.prediction import horizons_for, prediction_errors
from trueup.engines.vehicle.quantities import LASTING
from trueup.engines.vehicle.vehicle_file import read_vehicle, write_vehicle
from trueup.errors import CalibrationError, ModelError, RecordingError, UnknownNameError
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.limits import is_limit
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.tracking.cleaned import cleaned
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

HIDDEN = {
    "steering_delay": 0.04, "steering_lag": 0.06, "steering_slack": 0.06, "steering_left": 0.45, "steering_right": 0.52,
    "steering_falloff": 0.1, "steering_offset": 0.03, "relaxation": 0.08, "understeer": 0.004, "grip": 150.0,
    "friction_limit": 7.0,
    "throttle_delay": 0.05, "throttle_lag": 0.1, "throttle_dead": 0.06, "drive": 14.0, "drive_fade": 0.08,
    "friction": 1.0, "speed_loss": 0.9, "curve_loss": 0.15, "pose_at": 0.75, "pose_turn": 0.02,
}  # fmt: skip
TRUTH = Vehicle("hidden", 0.2, drive="throttle", values=HIDDEN)
SEARCHED_ONCE = "[vehicle.values]\npush_lasts = 0.0\ntrim_lasts = 0.0\nspeed_kept = 0.0\n"
"""What lasts beyond the model is told in a car's file, and so a search begins there alone."""
GUESS = Vehicle("guessed", 0.2, drive="throttle")


def driven(
    seed: int, seconds: float = 50.0, *, noise: float = 5e-4, slower: float = 1.0, truth: Vehicle = TRUTH
) -> Recording:
    """A drive of the hidden car from rest, commanded at 10 Hz, tracked at 100 Hz: one clock, no outliers."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(0.0, seconds, 0.1)
    throttle = np.repeat(slower * rng.uniform(0.22, 0.4, len(ticks) // 20 + 1), 20)[: len(ticks)] * (ticks > 1.5)
    swing = np.cumsum(rng.normal(0.0, 0.15, len(ticks))) * 0.4
    steering = np.clip(np.sin(2 * np.pi * 0.25 * ticks + swing) * rng.uniform(0.3, 1.0, len(ticks)), -1, 1)
    command = Channel("command", ("throttle", "steering"), "", ticks, np.stack([throttle, steering], axis=1))
    time = np.arange(1.0, seconds, 0.01)
    still = np.arange(0.0, 1.3, 0.01)
    start = {
        "position": Channel("position", ("x", "y"), "m", still, np.zeros((len(still), 2))),
        "heading": Channel("heading", ("heading",), "rad", still, np.zeros(len(still))),
    }
    observed = {
        "position": Observed(("x", "y"), "m", time),
        "heading": Observed(("heading",), "rad", time),
        "speed": Observed(("speed",), "m/s", time[::10]),
    }
    trial = Trial("truth", 1.0, seconds - 1.0, command, observed, start)
    (rollout,) = VehicleSimulator(truth, horizon=1e3).rollout([trial], np.zeros((1, 0)))
    run = rollout.recording().replace(name=f"drive_{seed}")
    noisy = {n: c.replace(values=c.values + rng.normal(0.0, noise, c.values.shape)) for n, c in run.channels.items()}
    return run.replace(channels={**noisy, "command": run.channel("command")})


def pull(values: Mapping[str, float], throttle: float, speed: float) -> float:
    """Acceleration in m/s^2 on a straight; its terms can be traded against one another, their sum cannot."""
    motor = values["drive"] * (throttle - values["throttle_dead"]) * (1.0 - values["drive_fade"] * speed)
    return motor - values["friction"] - values["speed_loss"] * speed


def written(recording: Recording, path: Path, lost: tuple[float, float] = (20.0, 26.0)) -> Path:
    """As the car's computer logs it: a row for each pose, the on-board signals held, on a clock of their own.

    While `lost` (s) the tracker shows something that stands elsewhere.
    """
    pose = recording.channel("position")
    heading = recording.channel("heading").values[:, 0]
    ticks = recording.channel("speed").time
    command = recording.channel("command").at(ticks, hold=True)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["elapsed time sensors", "throttle", "steering", "vel encoder", "vicon time", "vicon x", "vicon y",
                       "vicon yaw"])  # fmt: skip
        for k, t in enumerate(pose.time):
            j = int(np.searchsorted(ticks, t + 1e-9, side="right")) - 1
            away = lost[0] < t < lost[1]
            where = (-5.0 + 1e-4 * k % 3, -0.8, 0.3) if away else (*pose.values[k], np.angle(np.exp(1j * heading[k])))
            rows.writerow([500.0 + ticks[j], *command[j], recording.channel("speed").values[j, 0], 1.7e9 + t, *where])
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("car")
    (folder / "car.toml").write_text(f'[vehicle]\nname = "guessed"\nwheelbase = 0.2\n{SEARCHED_ONCE}')
    return [written(driven(seed), folder / f"drive_{seed}.csv") for seed in (1, 2)]


@pytest.fixture(scope="module")
def drive() -> Recording:
    return driven(3, 30.0)


def test_hidden_parameters_come_back_from_logs_with_two_clocks_and_outliers(logs: list[Path]) -> None:
    recordings = [formats.read([log])[0] for log in logs]
    ready = prepare(logs[0].with_name("car.toml"), recordings[:1], recordings[1:])
    simulator, found = ready.simulator, ready.calibrate(Options(stages=DESCENT, cross_validate=False, lacking=False))
    assert isinstance(simulator, VehicleSimulator)
    values = {e.name: e.value for e in found.estimates}
    for name, within in (("steering_left", 0.1), ("steering_right", 0.1), ("friction_limit", 0.1), ("curve_loss", 0.2)):
        assert values[name] == pytest.approx(HIDDEN[name], rel=within), name
    for throttle, speed in ((0.25, 0.8), (0.25, 1.4), (0.35, 0.8), (0.35, 2.0)):
        assert pull(values, throttle, speed) == pytest.approx(pull(HIDDEN, throttle, speed), rel=0.15, abs=0.2)
    assert values["steering_slack"] == pytest.approx(0.06, abs=0.02)
    assert values["steering_offset"] == pytest.approx(0.03, abs=0.01)
    # The log's first row comes up to 10 ms after the sample: the clocks are known no better.
    # What tyres take up with the way rolled is a lag, too, at about 1.7 m/s.
    late, hidden = (v["steering_delay"] + v["steering_lag"] + v["relaxation"] / 1.7 for v in (values, HIDDEN))
    assert late == pytest.approx(hidden, abs=0.02)
    errors = prediction_errors(simulator, found.values, simulator.prepared(recordings[1]))
    assert len(errors) > 80
    assert (errors.mean(axis=0) < [0.03, 0.10]).all()
    assert any("3 s ahead" in note for note in found.notes)
    assert {r.recording for r in found.replays} == {"drive_1", "drive_2"}, "cuts of a drive are not drives"


def test_what_the_tracker_mistook_for_the_car_is_left_out(logs: list[Path]) -> None:
    recording = formats.read([logs[0]])[0]
    for given in (recording, recording.without("speed")):
        position = cleaned(given).channel("position")
        gone = position.time[np.isnan(position.values[:, 0])]
        assert gone.min() == pytest.approx(19.0, abs=0.05)  # the recording's clock begins with its first sample, at 1 s
        assert gone.max() == pytest.approx(25.0, abs=0.05)
        assert len(gone) == pytest.approx(600, abs=5)


def test_a_drive_that_is_too_short_to_be_predicted_has_no_errors(drive: Recording) -> None:
    brief = cleaned(drive.slice(drive.start + 5.0, drive.start + 5.6))
    assert prediction_errors(VehicleSimulator(TRUTH), np.zeros(0), brief).shape == (0, 2)


def test_a_drive_of_two_seconds_is_predicted_once_from_its_first_state(drive: Recording) -> None:
    brief = cleaned(drive.slice(drive.start + 5.0, drive.start + 7.0))
    simulator = VehicleSimulator(TRUTH)
    (one,) = prediction_errors(simulator, np.zeros(0), brief)
    assert one[0] < 0.1
    assert np.isnan(one[1])
    assert horizons_for(simulator, [brief, brief], (1.0, 3.0))[1] == pytest.approx(1.7, abs=0.06)
    assert horizons_for(simulator, [brief, drive], (1.0, 3.0)) == (1.0, 3.0)


def test_a_prediction_never_uses_what_was_measured_after_it_began(drive: Recording) -> None:
    simulator = VehicleSimulator(TRUTH)
    trial = Trial.of(drive, ["position", "heading"])
    cut = 10.0
    later = {
        name: c.replace(values=np.where((c.time > cut)[:, None], 7.0, c.values)) for name, c in trial.initial.items()
    }
    changed = replace(trial, initial=later)
    one, other = (simulator.rollout([t], np.zeros((1, 0)))[0].channels["position"][0] for t in (trial, changed))
    time = trial.observed["position"].time
    starts = trial.start + simulator.horizon * np.arange(40)
    ends = starts[np.searchsorted(starts, cut)]  # the stretch that the cut lies in began before it
    assert np.array_equal(one[time < ends - 0.02], other[time < ends - 0.02])
    assert not np.allclose(one[time > ends + 0.5], other[time > ends + 0.5])


def test_stretches_are_the_same_at_every_step(drive: Recording) -> None:
    trial = Trial.of(drive, ["position", "heading"])
    runs = [VehicleSimulator(TRUTH, step=step).rollout([trial], np.zeros((1, 0)))[0] for step in (0.005, 0.01)]
    fine, coarse = (run.channels["position"] for run in runs)
    assert np.abs(fine - coarse).mean() < 0.005
    assert np.abs(fine - coarse).max() < 0.1


@dataclass(frozen=True)
class Fitted:
    """What stands for a calibration: values, and nothing to say."""

    values: Array
    estimates: tuple[Estimate, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def test_a_car_is_also_searched_as_if_nothing_were_unexplained_and_the_better_one_stays() -> None:
    begun = []

    def fit(simulator: VehicleSimulator, drives: Any, others: Any, *, again: bool = False, **how: Any) -> Fitted:
        begun.append([float(simulator.parameters[n].nominal) for n in LASTING])
        return Fitted(simulator.parameters.nominal)

    def calibrated(car: Vehicle, noise: float) -> Array:
        begun.clear()
        simulator = VehicleSimulator(car, car.space())
        found = Vehicles().calibrate(simulator, [driven(4, 20.0, noise=noise)], [], fit)  # type: ignore[arg-type]
        return np.array([found.values[simulator.parameters.index(n)] for n in LASTING])

    # The dynamics are the truth's: with a noisy tracker, what seems unexplained is noise that does not last, and the speed is
    # the one that the model carries on.
    assert np.array_equal(calibrated(TRUTH, 4e-3), [0.0, 0.0, 1.0])
    assert {tuple(at) for at in begun} >= {tuple(at.values()) for at in lasting(TRUTH)}
    own = dict(zip(LASTING, (0.2, 0.3, 0.4), strict=True))
    assert np.array_equal(calibrated(replace(TRUTH, values={**HIDDEN, **own}), 5e-4), list(own.values()))
    assert {tuple(at) for at in begun} == {tuple(own.values())}


def test_a_search_ends_with_what_then_predicts_best_wherever_it_began() -> None:
    def searched(simulator: VehicleSimulator, drives: Any, others: Any, **how: Any) -> Fitted:
        return Fitted(simulator.parameters.nominal)

    drives = [driven(4, 20.0, noise=4e-3)]
    begun = lasting(TRUTH)
    simulator = VehicleSimulator(TRUTH, TRUTH.space().freeze(LASTING, begun[0]))
    first = Fitted(simulator.parameters.nominal)
    found = with_shares(simulator, [first], drives, [], searched, begun)  # type: ignore[arg-type]
    assert {n: found.values[simulator.parameters.index(n)] for n in LASTING} == begun[1]


def test_a_search_begins_where_the_speed_of_the_steering_shows() -> None:
    space, limit = GUESS.space(), GUESS.space().index("steering_rate_limit")
    rows = np.tile(space.nominal, (2, 1))
    rows[1, limit] *= 0.9
    time = np.arange(0.0, 6.0, 0.01)
    command = Channel(
        "command", ("throttle", "steering"), "", time, np.stack([0.2 + 0 * time, np.sign(np.sin(3 * time))], 1)
    )
    still = {"position": Channel("position", ("x", "y"), "m", time[:130], np.zeros((130, 2))),
             "heading": Channel("heading", ("heading",), "rad", time[:130], np.zeros((130, 1)))}  # fmt: skip
    trial = Trial("turns", 1.0, 4.0, command, {"heading": Observed(("heading",), "rad", time[130::10])}, still)
    (rollout,) = VehicleSimulator(GUESS, space, horizon=1e3).rollout([trial], rows)
    one, other = rollout.channels["heading"][:, :, 0]
    assert np.nanmax(np.abs(one - other)) > 1e-3, "a limit that is never met has no slope"


@pytest.mark.parametrize(("drive", "limits"), [
    ("speed", {"steering_rate_limit", "acceleration_limit", "yaw_rate_limit", "yaw_acceleration_limit", "friction_limit"}),
    ("throttle", {"steering_rate_limit"}),
    ("pursued speed", {"steering_rate_limit", "acceleration_limit", "braking_limit"}),
])  # fmt: skip
def test_limits_of_a_car_are_those_that_it_may_never_meet(drive: str, limits: set[str]) -> None:
    assert {p.name for p in Vehicle("car", 0.3, drive=drive).space().parameters if is_limit(p)} == limits


def test_a_log_that_begins_while_slow_wheels_turn_is_predicted_from_its_beginning() -> None:
    """No command of the log tells where its wheels are: how the car turns does."""
    slow = Vehicle("slow", 0.2, drive="throttle", values=HIDDEN | {"steering_rate_limit": 0.5, "steering_delay": 0.1})
    whole, simulator, errors = driven(3, truth=slow), VehicleSimulator(slow), []
    for begin in np.arange(8.0, 44.0, 3.0):
        log = whole.slice(begin, begin + 1.7)
        trial = Trial.of(log, ["position", "heading"])
        turned = simulator.past(trial)
        for past in (
            turned,
            replace(turned, log_begin=0 * turned.log_begin),
        ):  # or as if wheels were where the first command wants them
            simulator._pasts[trial] = past
            seen = simulator.rollout([trial], np.zeros((1, 0)))[0].channels["position"][0]
            errors.append(np.linalg.norm(seen - log.channel("position").values, axis=1).max())
    told, held = np.reshape(errors, (-1, 2)).T
    assert np.median(told) < 0.1 * np.median(held)
    assert told.max() < 0.15


def test_the_speed_at_the_beginning_of_a_log_is_not_that_of_a_car_that_stood_before(drive: Recording) -> None:
    for begin in np.arange(6.0, 26.0, 2.0):
        log = drive.slice(begin, begin + 3.0)
        past = VehicleSimulator(TRUTH).past(Trial.of(log, ["position", "heading"]))
        first, speed = int(np.argmax(past.known)), log.channel("speed")
        measured = np.interp(past.begin + past.step * first, speed.time, speed.values[:, 0])
        assert past.seen[first, 3] == pytest.approx(measured, rel=0.03)


def test_wheels_are_where_commands_that_came_before_the_car_was_seen_have_them() -> None:
    slow = Vehicle("slow", 0.2, drive="throttle", values=HIDDEN | {"steering_rate_limit": 0.5})
    log, simulator = driven(3, 30.0, truth=slow).slice(4.0, 14.0), VehicleSimulator(slow)
    position = log.channel("position")
    unseen = position.replace(values=np.where(position.time[:, None] < 10.0, np.nan, position.values))
    trial = Trial.of(log.with_channel(unseen), ["position", "heading"])
    past, errors = simulator.past(trial), []
    assert past.log_begin[1] - past.log_begin[0] > 5.0 / past.step
    for begin in (
        past.log_begin,
        0 * past.log_begin,
        past.log_begin[[1, 1, 2]],
    ):  # as it is, commanded ever since, not before
        simulator._pasts[trial] = replace(past, log_begin=begin)
        seen = simulator.rollout([trial], np.zeros((1, 0)))[0].channels["position"][0]
        first = (position.time > 10.0) & (position.time < 11.5)
        errors.append(np.linalg.norm(seen - position.values, axis=1)[first].max())
    assert errors[0] == errors[1] != errors[2]
    assert errors[0] < 0.1


def test_a_gap_in_the_tracking_changes_no_prediction_that_began_before_it(drive: Recording) -> None:
    car, trial = VehicleSimulator(TRUTH), Trial.of(drive, ["position"])
    time = trial.observed["position"].time
    begins = np.flatnonzero(np.diff(car.ahead(trial, time)) < 0.0) + 1
    lost = slice(begins[8] - 5, begins[8] + 20)  # what comes after it is longer ago than a prediction lasts
    channels = dict(drive.channels)
    for name in ("position", "heading"):
        c = channels[name]
        channels[name] = c.replace(time=np.delete(c.time, lost), values=np.delete(c.values, lost, axis=0))
    whole, cut = (
        car.rollout([Trial.of(r, ["position"])], np.zeros((1, 0)))[0].channels["position"][0]
        for r in (drive, drive.replace(channels=channels))
    )
    assert np.array_equal(cut[: lost.start], whole[: lost.start])


def test_the_truth_predicts_its_own_drives(drive: Recording) -> None:
    errors = prediction_errors(VehicleSimulator(TRUTH), np.zeros(0), drive)
    assert (errors.mean(axis=0) < [0.03, 0.06]).all()
    wrong = VehicleSimulator(replace(TRUTH, values={**HIDDEN, "steering_left": 0.35, "drive": 10.0}))
    assert (prediction_errors(wrong, np.zeros(0), drive).mean(axis=0) > 2.0 * errors.mean(axis=0)).all()


def test_a_first_look_comes_near(drive: Recording) -> None:
    found = Look.at([cleaned(drive)]).starts(GUESS)
    assert found["steering_left"] == pytest.approx(0.46, rel=0.2)
    assert found["drive"] == pytest.approx(12.0, rel=0.5)
    command = drive.channel("command")
    mirrored = drive.with_channel(command.replace(values=command.values * [1.0, -1.0]))
    with pytest.raises(CalibrationError, match="turn it to the right"):
        Look.at([cleaned(mirrored)]).starts(GUESS)


def test_a_car_on_soft_tyres_is_predicted_as_well_as_its_hidden_values_predict_it(tmp_path: Path) -> None:
    """Tyres that slip a little everywhere swing the tail out: held stiff, they moved the tracked point instead."""
    soft = Vehicle("soft", 0.2, drive="throttle", values={**HIDDEN, "grip": 45.0})
    (tmp_path / "car.toml").write_text(f"[vehicle]\nwheelbase = 0.2\n{SEARCHED_ONCE}")
    ready = prepare(tmp_path / "car.toml", [driven(11, 20.0, truth=soft)])
    simulator, found = ready.simulator, ready.calibrate(Options(stages=DESCENT, cross_validate=False, lacking=False))
    assert isinstance(simulator, VehicleSimulator)
    unseen = simulator.prepared(driven(12, 20.0, truth=soft))
    ours, theirs = (
        prediction_errors(s, v, unseen).mean(axis=0)
        for s, v in ((simulator, found.values), (VehicleSimulator(soft), np.zeros(0)))
    )
    assert (ours < 1.5 * theirs).all()
    values = {e.name: e.value for e in found.estimates}
    assert values["grip"] == pytest.approx(45.0, rel=0.2)
    assert values["pose_at"] == pytest.approx(HIDDEN["pose_at"], abs=0.075)


def test_tyres_are_not_judged_by_drives_that_never_slide(drive: Recording) -> None:
    assert Look.at([cleaned(drive)]).unseen() == {}
    slow = driven(4, 30.0, slower=0.62)
    calm = Look.at([cleaned(slow)]).unseen()
    assert set(calm) == {"understeer", "friction_limit", "grip"}
    assert "m/s^2 sideways" in calm["understeer"]


def test_a_motor_that_coasts_brakes_less_than_it_pulls_at_speed() -> None:
    row = TRUTH.row
    at = [motor_push(row, throttle, 2.0) for throttle in (0.0, 0.06, 0.36, -0.36)]
    assert at[:2] == [0.0, 0.0]
    assert at[2] == pytest.approx(14.0 * 0.3 * (1.0 - 0.16))
    assert at[3] == pytest.approx(-14.0 * 0.3)


def test_what_a_wheel_showed_just_before_is_expected_to_last_a_while(drive: Recording) -> None:
    """A steering that is off by a constant, which no parameter tells, costs less than it would by itself."""
    off = VehicleSimulator(replace(TRUTH, values={**HIDDEN, "steering_offset": HIDDEN["steering_offset"] + 0.08}))
    errors = prediction_errors(off, np.zeros(0), drive, (1.0,)).mean()
    moved = 0.5 * 0.45 * 0.08 / 0.2 * float(np.median(drive.channel("speed").values)) ** 2  # m after 1 s, by geometry
    assert errors < 0.8 * moved


def test_a_push_that_lasts_is_told_as_large_as_it_is_beneath_the_motors_own_voltage() -> None:
    """A car that rolls more easily than its model, by a constant: what the past showed of it makes up for nearly all."""
    values = {**HIDDEN, "drive_fade": 0.2, "push_lasts": 1.0}
    drives = driven(5, truth=replace(TRUTH, values=values))
    own, off, unaware = (
        prediction_errors(VehicleSimulator(replace(TRUTH, values={**values, **more})), np.zeros(0), drives).mean(
            axis=0
        )[1]
        for more in ({}, {"friction": 1.7}, {"friction": 1.7, "push_lasts": 0.0})
    )
    assert off - own < 0.2 * (unaware - own)


def test_a_new_wheel_angle_takes_effect_after_a_way_not_after_a_time() -> None:
    """Rolled as far, a slow and a faster car with the same tyres have turned as far towards the new angle's curve."""
    row = replace(TRUTH, values={**HIDDEN, "relaxation": 0.1, "understeer": 0.0, "friction_limit": 12.0}).row
    shares = []
    for speed in (0.3, 0.6):
        state = np.zeros(STATE)
        for _ in range(round(0.1 / speed / 1e-3)):
            state[[WHEEL, SPEED]] = 0.3, speed
            on_tyres(row, 1e-3, state)
        shares.append(state[ANGLE] / steered(row, 0.3))
    assert shares[0] == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    assert shares[1] == pytest.approx(shares[0], abs=0.01)


def test_a_switch_cuts_the_throttle(drive: Recording) -> None:
    command = drive.channel("command")
    off = Channel("safety_value", ("safety_value",), "", command.time, (command.time < 10.0).astype(float))
    cut = cleaned(drive.with_channel(off)).channel("command")
    assert not cut.column("throttle")[cut.time >= 10.0].any()
    assert np.array_equal(cut.column("steering"), command.column("steering"))
    with pytest.raises(RecordingError, match="no signal 'armed'"):
        cleaned(drive, "armed")


def test_a_drive_without_pose_says_what_is_missing(drive: Recording) -> None:
    with pytest.raises(RecordingError, match="has no channel 'position'; a car is calibrated on a tracked pose"):
        cleaned(drive.without("position").without("speed"))


def test_commands_in_percent_or_under_other_names_are_explained(drive: Recording) -> None:
    command = drive.channel("command")
    percent = drive.with_channel(command.replace(values=command.values * [100.0, 1.0]))
    with pytest.raises(
        RecordingError, match=r"throttle reaches 3\d.*-1 ... 1: say in the mapping's .* 0.01 for throttle"
    ):
        cleaned(percent)
    renamed = drive.with_channel(command.replace(labels=("gas", "steer")))
    with pytest.raises(RecordingError, match=r"found: gas, steer\. Name their"):
        cleaned(renamed)
    with pytest.raises(RecordingError, match=r"found: none among .*twist.*\[\"speed\", \"turn\"\]"):
        cleaned(renamed.without("command").with_channel(Channel("twist", ("x", "z"), "", command.time, command.values)))


def test_a_drive_of_pose_and_commands_alone_will_do(drive: Recording) -> None:
    bare = drive.without("speed")
    simulator = VehicleSimulator(
        GUESS, GUESS.space(["steering_left", "steering_right"], Look.at([cleaned(bare)]).starts(GUESS))
    )
    assert len(prediction_errors(simulator, simulator.parameters.nominal, simulator.prepared(bare))) > 50


def test_a_car_file_keeps_every_value(tmp_path: Path) -> None:
    write_vehicle(TRUTH, tmp_path / "car.toml")
    assert read_vehicle(tmp_path / "car.toml") == TRUTH
    assert len(TRUTH.space()) == len(TRUTH.quantities)


def test_a_file_with_the_names_of_earlier_versions_is_read(tmp_path: Path) -> None:
    values = "[vehicle.values]\nsteering_play = 0.01\nsteering_rate = 3.0\ngrip = 180.0\n"
    (tmp_path / "car.toml").write_text("[vehicle]\nwheelbase = 0.2\n" + values)
    found = read_vehicle(tmp_path / "car.toml").values
    assert found == {"steering_slack": 0.02, "steering_rate_limit": 3.0, "grip": 180.0}, "play was half of the slack"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("wheelbase = 1", r"has no table \[vehicle\]"),
        ("[vehicle]\nname = 'a'", "'wheelbase' is missing"),
        ("[vehicle]\nwheelbase = 0.2\ncolour = 1", "unknown key 'colour'"),
        ("[vehicle]\nwheelbase = 'long'", "wheelbase = 'long': must be a number"),
        ("[vehicle]\nwheelbase = 0.2\n[vehicle.values]\ndrag = 1.0", "quantity 'drag' is not in vehicle 'car'"),
        ("[vehicle]\nwheelbase = 0.2\ndrive = 'pedals'", "drive = 'pedals': is not one of: throttle, speed"),
        ("[vehicle", "not valid TOML"),
    ],
)
def test_a_wrong_car_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "car.toml").write_text(text)
    with pytest.raises((ModelError, UnknownNameError), match=said):
        read_vehicle(tmp_path / "car.toml")


def test_a_car_is_calibrated_from_the_shell(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("car.toml").write_text("[vehicle]\nwheelbase = 0.2\n")  # what lasts beyond the model is searched, too
    for log in logs:  # 15 s are enough for the command
        Path(log.name).write_text("".join(log.read_text().splitlines(keepends=True)[:1500]))
    given = ["car.toml", *(log.name for log in logs), "--hold-out", "drive_2", "--search", "gradient"]
    code = main(["calibrate", *given, "--out", "fit"])
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "position, held out" in said.out
    fitted = read_vehicle("fit/car.toml")
    assert fitted.values["steering_right"] == pytest.approx(0.52, rel=0.1)
    assert Path("fit/report.html").is_file()


@pytest.mark.realdata
def test_a_real_car_is_predicted_on_a_drive_that_was_not_fitted(real_data: Path, tmp_path: Path) -> None:
    files = sorted((real_data / "jetracer").glob("[679]*/*.csv"))
    lasting = "push_lasts = 0.5\ntrim_lasts = 0.6\nspeed_kept = 0.0\n"
    (tmp_path / "car.toml").write_text(f"[vehicle]\nwheelbase = 0.1735\n[vehicle.values]\n{lasting}")
    recordings = [formats.read([file])[0] for file in files]
    ready = prepare(tmp_path / "car.toml", [r.slice(r.start, r.start + 45.0) for r in recordings[1:]])
    simulator, found = ready.simulator, ready.calibrate(Options(stages=DESCENT, cross_validate=False, lacking=False))
    assert isinstance(simulator, VehicleSimulator)
    errors = prediction_errors(simulator, found.values, simulator.prepared(recordings[0]))
    assert (errors.mean(axis=0) < [0.08, 0.25]).all()


def test_a_noisy_tracker_tells_the_speed_better_by_the_last_seconds_than_by_the_last_samples() -> None:
    drive = driven(6, noise=0.01)
    at_once, kept = (
        prediction_errors(
            VehicleSimulator(replace(TRUTH, values={**HIDDEN, "speed_kept": share})), np.zeros(0), drive
        ).mean(axis=0)
        for share in (0.0, 1.0)
    )
    assert (kept < 0.9 * at_once).all()
