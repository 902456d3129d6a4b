# SPDX-License-Identifier: Apache-2.0
"""Start states are known but for their noise: estimates know that, and what is off is corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.instant import at_instant
from trueup.loop.descent import Fit
from trueup.loop.fit import STAGES, fit
from trueup.loop.horizon import cut_for_search
from trueup.loop.problem import Problem
from trueup.loop.shoot import Starts
from trueup.loop.stages import Run
from trueup.loop.uncertainty import unit_covariance
from trueup.loop.watch import Watch
from trueup.loop.windows import in_windows, smooth_length, window_length
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
SPACE = ParameterSpace((Parameter("speed", "m/s", 1.0, 0.0, 2.0),))
TIME = np.arange(0.0, 4.0, 0.02)
SIGMA = 0.01


def start_of(trial: Trial) -> float:
    """Where it began by its samples, corrected."""
    begun = at_instant(trial.initial["position"], None, trial.start).value[0]
    return float(begun + trial.corrections.get("position", np.zeros((2, 1)))[0, 0])


@dataclass
class Runner:
    """Runs straight on from where the first sample says that it starts."""

    parameters = SPACE
    step = 0.02

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        return [
            Rollout(t, {"position": (start_of(t) + values * t.observed["position"].time)[..., None]}, {})
            for t in trials
        ]


class Stumbler(Runner):
    """Runs straight on, but a step further away if it begins beyond the edge at 0."""

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        done = Runner().rollout(trials, values, controllers)
        edges = [3.0 * SIGMA * (start_of(t) > 0.0) for t in trials]
        return [replace(r, channels={"position": r.channels["position"] + e}) for r, e in zip(done, edges, strict=True)]


class ByNoise:
    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), SIGMA)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        ((channel, seen),) = simulated.channels.items()
        time = simulated.trial.observed[channel].time
        return ((seen - measured_at(real, channel, ("x",), time)) / SIGMA).reshape(len(seen), -1)


def run(rng: np.random.Generator, runner: Runner | None = None) -> Problem:
    """One run at the speed 1 m/s from 0, measured with noise."""
    measured = TIME[:, None] + SIGMA * rng.standard_normal((len(TIME), 1))
    recording = Recording("run", {"position": Channel("position", ("x",), "m", TIME, measured)})
    return Problem(runner or Runner(), [recording], ByNoise())  # type: ignore[arg-type]


def solved(problem: Problem) -> Fit:
    """The optimum of a problem that is linear in the speed."""
    pair = problem.residuals(np.array([[0.5], [1.5]]))
    slopes = (pair[1] - pair[0])[:, None] * 2.0
    unit = 0.25 - float(slopes[:, 0] @ pair[0] / np.sum(slopes**2))
    residual = problem.residuals(SPACE.from_unit(np.array([[unit]])))[0]
    return Fit(SPACE, np.array([unit]), residual, slopes, np.ones(len(residual)), "")


def test_an_estimate_that_hangs_on_the_start_is_as_unsure_as_repeated_runs_scatter() -> None:
    plain, better, told = [], [], []
    for seed in range(40):
        problem = run(np.random.default_rng(seed))
        starts = Starts.as_measured(problem, SPACE.nominal)
        assert starts.handles == (("position", 0, 0),)
        plain.append(solved(problem).unit[0])
        shot = starts.eliminated_from(problem, SPACE.nominal)
        fit = solved(shot)
        better.append(fit.unit[0])
        told.append(unit_covariance(shot, fit)[0, 0])
    assert np.sqrt(np.mean(told)) == pytest.approx(np.std(better), rel=0.35)
    assert np.std(better) < 0.7 * np.std(plain)


def test_where_a_start_is_at_an_edge_estimates_are_as_unsure_as_what_lies_beyond_it() -> None:
    off = {True: [], False: []}
    for seed in range(40):
        problem = run(np.random.default_rng(seed), Stumbler())
        starts = Starts.as_measured(problem, SPACE.nominal)
        for bent, found in off.items():
            shot = starts.eliminated_from(problem, SPACE.nominal, bent=bent)
            fit = solved(shot)
            found.append((fit.unit[0] - 0.5) / np.sqrt(unit_covariance(shot, fit)[0, 0]))
    assert np.sqrt(np.mean(np.square(off[True]))) < 1.5 < np.sqrt(np.mean(np.square(off[False])))


def test_a_start_that_was_measured_badly_is_corrected() -> None:
    problem = run(np.random.default_rng(0))
    first = problem.trials[0].initial["position"]
    off = np.array(first.values)
    off[0] += 6.0 * SIGMA
    wrong = problem.replayed_by([replace(problem.trials[0], initial={"position": first.replace(values=off)})], [0])
    starts, shot = Starts.as_measured(wrong, SPACE.nominal), wrong
    for _ in range(2):  # as long as nothing is explained, all residuals count for less
        shot = starts.eliminated_from(shot, SPACE.nominal)
        starts, surprise = starts.corrected(shot, SPACE.nominal)
        assert surprise < 1e-6  # it is linear: slopes foretell it
    after = starts.eliminated_from(shot, SPACE.nominal).plain_residuals(SPACE.nominal)
    assert np.mean(after**2) == pytest.approx(1.0, abs=0.3)
    np.testing.assert_allclose(starts.amounts, -6.0, atol=2.5)


@dataclass(frozen=True)
class Pendulum:
    """Falls away from where it starts, or returns there: x'' = rate |rate| x."""

    rate: float
    parameters = SPACE
    step = 0.02

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        return [Rollout(t, {"position": self.path(t)[None, :, None]}, {}) for t in trials]

    def path(self, trial: Trial) -> Array:
        """(T,) from the measured start at rest."""
        place, pace = trial.corrections.get("position", np.zeros((2, 1)))[:, 0]
        time = np.emath.sqrt(self.rate * abs(self.rate)) * (trial.observed["position"].time - trial.start)
        with np.errstate(invalid="ignore"):
            led = np.where(time == 0.0, 0.0, np.sinh(time) / (time + (time == 0.0)))
        return np.real(place * np.cosh(time) + pace * (trial.observed["position"].time - trial.start) * led)


@pytest.mark.parametrize("rate", [2.0, 5.0, -5.0, 0.0])
def test_windows_are_as_short_as_errors_grow_and_stable_robots_keep_whole_recordings(rate: float) -> None:
    rng = np.random.default_rng(0)
    channel = Channel("position", ("x",), "m", TIME, SIGMA * rng.standard_normal((len(TIME), 1)))
    command = Channel("command", ("x",), "m", TIME, np.zeros((len(TIME), 1)))
    problem = Problem(Pendulum(rate), [Recording("stands", {"position": channel, "command": command})], ByNoise())  # type: ignore[arg-type]
    length = window_length(problem, SPACE.nominal)
    if rate <= 0.0:
        assert length == np.inf
        return
    assert length < 1.5 * np.log(5.0) / rate  # shorter where the start's speed is little known
    assert rate < 5.0 or length == pytest.approx(np.log(5.0) / rate, rel=0.5)
    cut = in_windows(problem, length)
    assert len(cut.trials) == round(TIME[-1] / length)
    assert sum(len(t.observed["position"].time) for t in cut.trials) == len(TIME)
    np.testing.assert_array_equal(np.concatenate([t.observed["position"].time for t in cut.trials]), TIME)


@dataclass(frozen=True)
class Toppling(Pendulum):
    """A pendulum that is unstable from `since` s on only: in one window of many."""

    since: float = np.inf

    def path(self, trial: Trial) -> Array:
        return Pendulum(self.rate if trial.start >= self.since else 0.0).path(trial)


@pytest.mark.parametrize("swings", [False, True])
def test_windows_end_where_one_of_many_grows_beyond_all_others(swings: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Least squares count squares; but what a touch of the ground parts comes together again."""
    monkeypatch.setattr("trueup.loop.windows.swinging", lambda problem: swings)
    channel = Channel("position", ("x",), "m", TIME, SIGMA * np.random.default_rng(0).standard_normal((len(TIME), 1)))
    command = Channel("command", ("x",), "m", TIME, np.zeros((len(TIME), 1)))
    robot = Toppling(8.0, since=0.7 * TIME[-1])
    problem = Problem(robot, [Recording("stands", {"position": channel, "command": command})], ByNoise())  # type: ignore[arg-type]
    assert (window_length(problem, SPACE.nominal) < 0.9) == swings  # 0.99 s are looked at


class FromThere(Runner):
    """Runs straight on from where each window begins."""

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        paths = [start_of(t) + values * (t.observed["position"].time - t.start) for t in trials]
        return [Rollout(t, {"position": path[..., None]}, {}) for t, path in zip(trials, paths, strict=True)]


def skilled(unit: str, speed: float, turn: float = 0.0) -> float:
    """How long windows are of a run at 1 m/s, or a swing of `turn` rad/s, replayed straight on at a `speed`."""
    place = np.sin(turn * TIME) / turn if turn else TIME
    noise = 0.1 * SIGMA * np.random.default_rng(0).standard_normal(len(TIME))
    channels = {"position": Channel("position", ("x",), "m", TIME, (place + noise)[:, None]),
                "command": Channel("command", ("x",), unit, TIME, np.zeros((len(TIME), 1)))}  # fmt: skip
    return window_length(Problem(FromThere(), [Recording("run", channels)], ByNoise()), np.array([speed]))  # type: ignore[arg-type]


def test_windows_end_where_torques_lead_further_astray_than_standing_still() -> None:
    assert skilled("N m", 1.5) == np.inf
    assert skilled("N m", 2.2) < 0.2
    assert skilled("m", 2.2) == np.inf  # servos are pulled back
    assert 0.1 < skilled("N m", 1.0, turn=5.0) < 0.3  # of a swing of 1.3 s


@dataclass
class Bending(Runner):
    """Goes away the further the more its speed is: replays bend with that the more the longer they are."""

    rate: float = 10.0
    channel: str = "base_position"

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return (self.channel,)

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        times = [t.observed[self.channel].time - t.start for t in trials]
        return [
            Rollout(t, {self.channel: np.exp(self.rate * values * time)[..., None]}, {})
            for t, time in zip(trials, times, strict=True)
        ]


def bending(robot: Bending) -> Problem:
    """Four seconds of it."""
    away = Channel(robot.channel, ("x",), "m", TIME, np.exp(robot.rate * TIME)[:, None])
    command = Channel("command", ("x",), "m", TIME, np.zeros((len(TIME), 1)))
    return Problem(robot, [Recording("goes", {robot.channel: away, "command": command})], ByNoise())  # type: ignore[arg-type]


def smooth(robot: Bending) -> float:
    """How long windows of it may be for slopes to lead."""
    return smooth_length(bending(robot), SPACE.nominal, SPACE, seed=0)


def test_windows_of_a_free_base_end_where_replays_bend_with_parameters() -> None:
    bent = 2.0 * np.arctanh(0.5) / (10.0 * 0.06)  # s: then what stays is half of what turns, 0.06 m/s to either side
    assert bent / 3.0 < smooth(Bending()) < 1.1 * bent / 3.0
    assert smooth(Bending(rate=1.0)) == np.inf
    assert smooth(Bending(channel="position")) == np.inf  # a base that is not free
    cut, _, lasting, (said,) = cut_for_search(bending(Bending()), SPACE.nominal, SPACE, np.inf, seed=0)
    assert cut.windowed
    assert lasting == np.inf
    assert said.endswith("shown whole")


class Ball(Runner):
    """Gets ever faster between two walls at -1 and 1 m: noise at its start is two ways between them at the end."""

    def at_step(self, step: float) -> Ball:
        return self

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        return [
            Rollout(t, {"position": self.path(t.observed["position"].time, start_of(t), values)[..., None]}, {})
            for t in trials
        ]

    @staticmethod
    def path(time: Array, start: float, speed: Array) -> Array:
        """(b, T) m, as light would go between mirrors."""
        unfolded = start * np.exp(1.4 * time) + speed * time
        return np.abs((unfolded - 1.0) % 4.0 - 2.0) - 1.0


def _hit(seed: int = 1) -> Problem:
    """A ball of 1 m/s, measured with noise."""
    path = Ball.path(TIME, 0.3, np.ones((1, 1)))[0]
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(TIME))
    recording = Recording("run", {"position": Channel("position", ("x",), "m", TIME, (path + noise)[:, None])})
    return Problem(Ball(), [recording], ByNoise())  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(1, 4))
def test_what_walls_make_rugged_is_found_where_short_parts_lead_to_longer_ones(seed: int) -> None:
    found = fit(_hit(seed), SPACE, np.array([1.2]), Watch())
    assert found.values[0] == pytest.approx(1.0, abs=2e-3)


def test_where_short_parts_lead_astray_it_is_searched_from_where_whole_replays_have_led(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    until = STAGES[: [s.name for s in STAGES].index("multiple shooting")]
    led, asked = fit(hit := _hit(), SPACE, np.array([1.2]), Watch(), stages=until), []

    def astray(run: Run, starts: Starts) -> tuple[Starts, Array]:
        asked.append(starts)
        run.descent.move(np.array([0.9]))
        return starts, SPACE.from_unit(run.descent.point)

    monkeypatch.setattr("trueup.loop.shooting._by_horizon", astray)
    found = fit(hit, SPACE, np.array([1.2]), Watch())
    assert asked
    assert found.loss <= led.loss


class Thrown(Runner):
    """Runs straight on, but wherever it begins it ends up aside if it begins far from the way."""

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        done = []
        for t in trials:
            time, begun = t.observed["position"].time, start_of(t)
            aside = abs(begun - t.start) > 6.0 * SIGMA
            ran = values * time + (30.0 * SIGMA if aside else begun - t.start)
            done.append(Rollout(t, {"position": ran[..., None]}, {}))
        return done


def test_a_start_from_which_no_slope_leads_is_found_where_the_window_before_ends() -> None:
    whole = run(np.random.default_rng(2), Thrown())
    (recording,) = whole.recordings
    seen = recording.channel("position")
    kicked = seen.values + 12.0 * SIGMA * (np.abs(TIME - 2.0) < 0.1)[:, None]  # the marker slipped
    thrown = Problem(Thrown(), [recording.with_channel(seen.replace(values=kicked))], ByNoise())  # type: ignore[arg-type]
    problem = in_windows(thrown, 0.5)
    starts = Starts.every(problem)
    off = [start_of(t) - t.start for t in starts.trials()]
    assert np.max(off) > 9.0 * SIGMA
    corrected, _ = starts.corrected(starts.eliminated_from(problem, np.ones(1)), np.ones(1))
    assert max(abs(start_of(t) - t.start) for t in corrected.trials()) < 2.0 * SIGMA
    assert Starts.every(thrown).continued(thrown, np.ones(1)) is None
