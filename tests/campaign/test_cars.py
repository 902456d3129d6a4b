# SPDX-License-Identifier: Apache-2.0
"""A path follower is tuned in a car's own file, from logs to gains that work on the car.

The car is one that only these tests know: late, slow steering with a dead zone, understeer and a slow drive; it has none of
trueup's equations.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.campaign.campaign import Campaign
from trueup.campaign.cars import simulator_of
from trueup.campaign.events import Calibrated, Chosen, Event, Scored
from trueup.campaign.folder import Folder
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.kinds import follow_path, in_windows, mujoco
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.controllers.controller import Observation
from trueup.controllers.stanley import Stanley, StanleySettings
from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.commands import in_another_unit
from trueup.engines.vehicle.judging import Ahead
from trueup.engines.vehicle.vehicle import PURSUED, Vehicle
from trueup.engines.vehicle.vehicle_file import read_vehicle, write_vehicle
from trueup.errors import PlanError
from trueup.formats import read
from trueup.loop.fit import STAGES, fit
from trueup.loop.problem import Problem
from trueup.loop.watch import Watch
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

WHEELBASE, MOST, NOISE, DEAD, DELAY = 0.33, 0.4, 0.004, 0.03, 0.2  # m, rad, m and rad, rad, s
SETTINGS = StanleySettings(wheelbase=WHEELBASE, max_steering=MOST, max_speed=2.0, edges=(0.8, 1.4))
GAIN, UNDERSTEER, LATE, RATE, ROLLED, PERIOD, STEP = 0.92, 0.035, 0.06, 2.2, 0.1, 0.02, 0.005
HEAD = "t,cmd_speed_mps,cmd_steering_rad,x_m,y_m,heading_rad,speed_mps"

Law = Callable[[float, Array, float, float], tuple[float, float]]
"""(time, pose (3,), speed, turn rate) -> speed in m/s and steering in rad."""


def driven(law: Law, start: Sequence[float], seconds: float, rng: np.random.Generator) -> Array:
    """(T, 7) what its logger writes, in the order of HEAD."""
    x, y, heading = start
    speed = turn = lagged = wheel = 0.0
    orders: list[tuple[float, float]] = []
    rows = []
    parts = round(PERIOD / STEP)
    for n in range(round(seconds / PERIOD)):
        pose = np.array([x, y, heading]) + NOISE * rng.standard_normal(3)
        orders.append(law(n * PERIOD, pose, speed, turn))
        rows.append((n * PERIOD, *orders[-1], *pose, speed))
        for k in range(parts):
            old = math.floor(n + k / parts - DELAY / PERIOD + 1e-9)
            asked = orders[old][1] if old >= 0 else 0.0
            lagged += STEP / LATE * (math.copysign(max(abs(asked) - DEAD, 0.0), asked) - lagged)
            wheel += min(max(lagged - wheel, -RATE * STEP), RATE * STEP)
            speed += STEP * min(max((orders[max(n - 3, 0)][0] - speed) / 0.35, -3.0), 2.0)
            curvature = math.tan(GAIN * wheel + 0.012) / (WHEELBASE + UNDERSTEER * speed * speed)
            turn += min(STEP * speed / ROLLED, 1.0) * (speed * curvature - turn)
            heading += STEP * turn
            x, y = x + STEP * speed * math.cos(heading), y + STEP * speed * math.sin(heading)
    return np.array(rows)


def by_hand(path: Path, seed: int, seconds: float) -> None:
    """A drive over the floor as its logger writes it."""
    rng = np.random.default_rng(seed)
    speeds, angles = rng.uniform(0.8, 2.2, 40), rng.uniform(-0.35, 0.35, 40)

    def law(time: float, *_: object) -> tuple[float, float]:
        return (float(speeds[int(time / 4.0)]) if time > 0.6 else 0.0), float(angles[int(time / 1.3)])

    rows = driven(law, (0.0, 0.0, 0.0), seconds, rng)
    np.savetxt(path, rows, delimiter=",", header=HEAD, comments="", fmt="%.5f")


class Car:
    """It as a campaign's robot, steered by Stanley's law with the gains of each trial."""

    repeatable = True

    def perform(self, trial: Trial) -> list[Recording]:
        gains = np.array([list(trial.settings.values())])
        follower = Stanley(gains, SETTINGS, names=tuple(trial.settings))

        def law(time: float, pose: Array, speed: float, turn: float) -> tuple[float, float]:
            look = Observation(time, pose[None], np.array([[speed, turn]]), {}, trial)
            if time == 0.0:
                follower.reset(look)
            wanted, steering = follower.command(look)[0].tolist()
            return wanted, steering

        start = (*trial.initial["position"].values[0], *trial.initial["heading"].values[0])
        rows = driven(law, start, trial.duration + 2.0 * PERIOD, np.random.default_rng(len(trial.name)))
        time, columns = rows[:, 0], {"command": ("speed", "steering"), "position": ("x", "y"), "heading": ("heading",)}
        channels, first = {}, 1
        for name, labels in {**columns, "speed": ("speed",)}.items():
            channels[name] = Channel(name, labels, "", time, rows[:, first : first + len(labels)])
            first += len(labels)
        return [Recording(trial.name, channels)]


PLAN = """
[robot]
type = "floor_car:Car"
[simulator]
type = "vehicle"
model = "car.toml"
max_steering = 0.4
[task]
type = "follow-path"
paths = ["path.csv"]
gains = ["k1", "k2", "k3", "lead"]
max_speed = 2.0
edges = [0.8, 1.4]
[calibrate]
CALIBRATE
[optimize]
evaluations = 80
samples = 4
risk = 0.3
trust = 1.0
[transfer]
candidates = 1
incumbent = false
confirm = false
[stop]
rounds = 1
"""
DECLARED = f"""
[vehicle]
wheelbase = {WHEELBASE}
drive = "speed"
[vehicle.values]
pose_at = 0.0
steering_lag = {LATE}
steering_slack = 0.0
relaxation = {ROLLED}
curve_loss = 0.0
speed_delay = 0.06
speed_lag = 0.0
acceleration_limit = 2.0
braking_limit = 3.0
push_lasts = 0.0  # without these three it is searched once more
trim_lasts = 0.0
speed_kept = 1.0
"""
TOLD = (
    "steering_delay", "steering_rate_limit", "steering_dead", "steering_left", "steering_right", "steering_offset",
    "understeer", "speed_gain",
)  # fmt: skip
FITTED = f"recordings = ['d1.csv', 'd2.csv', 'd3.csv']\nparameters = {list(TOLD)}"


def tuned(folder: Path, calibrate: str) -> tuple[Event, ...]:
    """The events of a campaign with these lines in [calibrate]."""
    folder.mkdir()
    shutil.copy(Path(__file__), folder / "floor_car.py")
    for seed in (1, 2, 3):
        by_hand(folder / f"d{seed}.csv", seed, 18.0)
    around = np.linspace(0.0, 2.0 * np.pi, 300)
    eight = np.stack([4.0 * np.sin(around), 1.6 * np.sin(2.0 * around), 1.2 + 0.6 * np.cos(2.0 * around)], axis=1)
    np.savetxt(folder / "path.csv", eight, delimiter=",", header="x,y,speed", comments="")
    (folder / "car.toml").write_text(DECLARED)
    (folder / "campaign.toml").write_text(PLAN.replace("CALIBRATE", calibrate))
    begun = Folder.begin(read_plan(folder / "campaign.toml"), folder / "out", None)
    with Journal(begun.path) as journal:
        parts = parts_of(begun.file, begun.path, lambda line: None)
        Campaign(begun.file.plan, begun.checksum, "0", parts, journal).run()
    return read_journal(begun.path)


def scores(events: tuple[Event, ...]) -> dict[str, float]:
    """By step what the car scored."""
    return {e.step: e.scores[0] for e in events if isinstance(e, Scored)}


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibrated") / "plan"
    tuned(folder, FITTED)
    return folder


def test_gains_tuned_in_a_calibrated_car_work_on_the_car_and_those_of_the_declared_one_do_not(
    calibrated: Path, tmp_path: Path
) -> None:
    events = read_journal(calibrated / "out")
    by_logs, by_file = scores(events), scores(tuned(tmp_path / "declared", 'method = "none"'))
    assert by_logs["transfer"] < 0.4 * by_logs["experiment"]
    assert by_logs["transfer"] < 0.6 * by_file["transfer"]
    chosen = next(e for e in events if isinstance(e, Chosen))
    assert chosen.predicted[0] == pytest.approx(by_logs["transfer"], rel=0.25)
    assert any(isinstance(e, Calibrated) for e in events)


def test_a_calibrated_cars_file_holds_what_a_controller_meets(calibrated: Path, tmp_path: Path) -> None:
    file = calibrated / "out" / "round-1" / "calibrated.toml"
    car = read_vehicle(file)
    assert car.values["position_noise"] == pytest.approx(NOISE, rel=0.2)
    assert car.values["heading_noise"] == pytest.approx(NOISE, rel=0.2)
    assert car.values["steering_dead"] == pytest.approx(DEAD, abs=0.01)
    quiet = replace(car, values={**car.values, "position_noise": 0.0, "heading_noise": 0.0})
    write_vehicle(quiet, tmp_path / "quiet.toml")
    score, steering = by_file(file, calibrated)
    _, calm = by_file(tmp_path / "quiet.toml", calibrated)
    first = read_journal(calibrated / "out")
    logged = read([next((calibrated / "out" / "recordings").glob("trial-001*.parquet"))])[0]
    real = shaking(logged.channel("command").column("steering"))
    assert score == pytest.approx(scores(first)["experiment"], rel=0.1)
    assert shaking(steering) == pytest.approx(real, rel=0.15)
    assert shaking(calm) < 0.3 * real


@pytest.mark.parametrize("begun", [40.0])
def test_a_limit_is_found_from_one_that_is_never_met(tmp_path: Path, begun: float) -> None:
    for seed in (1, 2, 3):
        by_hand(tmp_path / f"d{seed}.csv", seed, 18.0)
    (tmp_path / "car.toml").write_text(DECLARED)
    drives = read(sorted(tmp_path.glob("*.csv")))
    ready = simulator_of(tmp_path / "car.toml", lambda line: None, drives, max_steering=MOST).only(TOLD)
    car = ready.simulator
    assert isinstance(car, VehicleSimulator)
    near = {"steering_delay": DELAY, "steering_rate_limit": begun, "steering_dead": DEAD, "understeer": UNDERSTEER}
    own = ParameterSpace(tuple(p.replace(optional="") for p in car.parameters.parameters))
    start = np.array([near.get(p.name, p.nominal) for p in own.parameters])
    recordings = [car.prepared(r) for r in ready.recordings]
    problem = Problem(car, recordings, Ahead(car, recordings), ("position", "heading"))
    stages = [s for s in STAGES if s.name in ("all, full step", "profiles")]
    found = fit(problem, own, start, Watch(), stages=stages)
    assert found.values[own.index("steering_rate_limit")] == pytest.approx(RATE, rel=0.2)


def by_file(file: Path, folder: Path) -> tuple[float, Array]:
    """What the task scores in a file's car with the gains of today, and (T,) what was steered, in rad."""
    simulator = simulator_of(file, lambda line: None, as_it_is=True, max_steering=MOST).simulator
    task = follow_path(("path.csv",), simulator, folder, lambda line: None, max_speed=2.0, edges=(0.8, 1.4), rate=50.0)
    done = simulator.rollout(task.trials, task.parameters.nominal[None], task.controllers)
    return float(task.score(done)[0]), done[0].channels["command"][0, :, 1]


def shaking(steering: Array) -> float:
    """How far steering (T,) goes from one command to the next at most times while it drives, in rad."""
    return float(np.median(np.abs(np.diff(steering[steering != 0.0], 2))))


def test_how_the_tracked_point_lies_changes_where_a_run_begins_not_where_it_is_tracked(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("x,y,speed\n0,0,1\n5,0,1\n")
    for at in (0.0, 0.8):
        file = tmp_path / f"{at}.toml"
        file.write_text(
            f'[vehicle]\nwheelbase = 0.33\ndrive = "speed"\n[vehicle.values]\npose_at = {at}\npose_left = 0.1\n'
        )
        simulator = simulator_of(file, lambda line: None, as_it_is=True, max_steering=0.4).simulator
        task = follow_path(("path.csv",), simulator, tmp_path, lambda line: None)
        run = simulator.rollout(task.trials, task.parameters.nominal[None], task.controllers)[0]
        start = task.trials[0].initial["position"].values[0]
        np.testing.assert_allclose(run.channels["position"][0, 0], start, atol=1e-9)
        assert task.score([run])[0] < 0.01  # its wheels are beside the path, its tracked point is on it


@pytest.mark.parametrize(("file", "said"), [
    ("", "does 'car' take|driven by throttle"),
    ('drive = "throttle"', "driven by throttle; log what"),
    ('drive = "turn"', "speed and turn rate"),
    ('drive = "speed"\nmiddle = [0, 0]\nfull = [300, 100]', "counts of which"),
])  # fmt: skip
def test_a_follower_of_speeds_and_angles_says_which_cars_it_cannot_drive(tmp_path: Path, file: str, said: str) -> None:
    (tmp_path / "car.toml").write_text(f"[vehicle]\nwheelbase = 0.33\n{file}\n")
    simulator = simulator_of(tmp_path / "car.toml", lambda line: None, as_it_is=True, max_steering=0.4).simulator
    with pytest.raises(PlanError, match=said):
        follow_path(("slalom",), simulator, tmp_path, lambda line: None)


@pytest.mark.parametrize(("scale", "unit"), [(0.28, "km/h"), (0.44, "mph"), (1.02, ""), (0.93, ""), (0.7, "")])
def test_speeds_in_another_unit_are_told_by_how_far_the_car_goes_for_them(scale: float, unit: str) -> None:
    said = in_another_unit(Vehicle("car", WHEELBASE, drive=PURSUED), {"speed_scale": scale})
    assert [f'units = ["{unit}"' in s for s in said] == [True] * bool(unit)


def test_what_is_missing_of_a_car_is_said_with_what_mends_it(tmp_path: Path) -> None:
    (tmp_path / "car.toml").write_text('[vehicle]\nwheelbase = 0.33\ndrive = "speed"\n')
    for name, asked in (("none.toml", "there is no file .*trueup calibrate"), ("car.toml", "max_steering = 0.4")):
        with pytest.raises(PlanError, match=asked):
            simulator_of(tmp_path / name, lambda line: None, as_it_is=True)
    ready = simulator_of(tmp_path / "car.toml", lambda line: None, as_it_is=True, max_steering=0.4)
    with pytest.raises(PlanError, match="'drives' fits the simulator 'bicycle'"):
        in_windows(6.0, ready.simulator)
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    with pytest.raises(PlanError, match='type = "mujoco"'):
        simulator_of(tmp_path / "arm.xml", lambda line: None)
    with pytest.raises(PlanError, match='type = "vehicle"'):
        mujoco(tmp_path / "car.toml", lambda line: None)
