# SPDX-License-Identifier: Apache-2.0
"""A toy for campaigns: a cart on a line that is to follow a target, its simulator, and a robot of another structure.

The simulator is a first-order lag; the robot has a second lag, a dead band and noise. Named by `module:attribute` from
the plans of the tests, as a user's own classes are, and quick to import.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration, Estimate, Replay
from trueup.controllers.controller import ControllerFactory, Observation
from trueup.engines.simulator import Rollout
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Observed, Reference, Trial

Array = NDArray[np.float64]

STEP, DURATION = 0.04, 4.0
TIME = np.asarray(np.arange(round(DURATION / STEP) + 1) * STEP, dtype=np.float64)
TARGETS = {"steps": np.sign(np.sin(TIME)), "ramps": np.abs((0.4 * TIME) % 2.0 - 1.0)}


class Gains:
    """Commands from two gains: proportional and feed-forward. Rows are (b, 2)."""

    period = STEP

    def __init__(self, values: Array) -> None:
        self._p, self._ff = values[:, -2], values[:, -1]
        self._target = TARGETS["steps"]

    def reset(self, observation: Observation) -> None:
        """Learns nothing but which target to follow."""

    def towards(self, name: str) -> Gains:
        self._target = TARGETS[name]
        return self

    def command(self, observation: Observation) -> Array:
        wanted = self._target[min(len(self._target) - 1, round(observation.time / STEP))]
        return (self._ff * wanted + self._p * (wanted - observation.position[:, 0]))[:, None]


class Follow:
    """The task: root mean square distance from the target, with a price on what is commanded."""

    name = "follow"

    def __init__(self, targets: Sequence[str] = ("steps",), price: float = 0.02) -> None:
        self._price = price
        self.parameters = ParameterSpace((
            Parameter("proportional", "1", 1.0, 0.1, 30.0, scale="log"),
            Parameter("feed forward", "1", 0.5, 0.0, 3.0),
        ))  # fmt: skip
        observed = {"position": Observed(("x",), "m", TIME), "command": Observed(("x",), "m/s", TIME)}
        self.trials = tuple(
            Trial(name, 0.0, DURATION, None, observed,
                  references={"target": Reference(("t", "x"), ("s", "m"), np.stack([TIME, TARGETS[name]], axis=1))})
            for name in targets
        )  # fmt: skip

    def controllers(self, values: Array) -> Gains:
        return Gains(values)

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        parts = []
        for rollout in rollouts:
            error = rollout.channels["position"][:, :, 0] - TARGETS[_target(rollout.trial)]
            effort = rollout.channels["command"][:, :, 0]
            parts.append(np.sqrt(np.mean(error**2, axis=1)) + self._price * np.sqrt(np.mean(effort**2, axis=1)))
        return np.mean(parts, axis=0)


class Lag:
    """The simulator: dx/dt = gain * u - drag * x."""

    name = "lag"

    def __init__(self, step: float = STEP, parameters: bool = True) -> None:
        self.step = step
        declared = (Parameter("gain", "1", 1.0, 0.2, 3.0), Parameter("drag", "1/s", 0.2, 0.0, 2.0))
        self.parameters = ParameterSpace(declared if parameters else ())

    def at_step(self, step: float) -> Lag:
        return Lag(step, len(self.parameters) > 0)

    def shipped(self) -> Lag:
        return Lag(self.step, parameters=False)

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        n = len(self.parameters)
        gain, drag = (values[:, 0], values[:, 1]) if n else (np.full(len(values), 1.0), np.full(len(values), 0.2))
        done = []
        for trial in trials:
            controller = controllers(values[:, n:]).towards(_target(trial)) if controllers else None  # type: ignore[attr-defined]
            command = _commands(trial)
            x = np.zeros(len(values))
            found = {
                "position": np.zeros((len(values), len(TIME), 1)),
                "command": np.zeros((len(values), len(TIME), 1)),
            }
            for k, t in enumerate(TIME):
                found["position"][:, k, 0] = x
                u = controller.command(_seen(t, x))[:, 0] if controller else np.full(len(x), command[k])
                found["command"][:, k, 0] = u
                x = x + STEP * (gain * u - drag * x)
            picked = {name: _at(found[name], o.time - trial.start) for name, o in trial.observed.items()}
            done.append(Rollout(trial, picked, {}))
        return done


class Cart:
    """The robot: a second lag, a dead band, noise; what it does depends on the trial's name and settings alone.

    With `folder` it is a machine of its own that remembers its jobs by their names: a performance is a file that appears
    there in one step, and asked again for the same trial it hands out what it has. A second performance of a trial would
    be an error. `forgetful`: it remembers nothing, as most drivers of hardware do; each performance is a line in a file.
    """

    def __init__(
        self, folder: Path | None = None, forgetful: bool = False, noise: float = 0.005, slow: float = 0.08
    ) -> None:
        self._folder, self._forgetful, self._noise, self._slow = folder, forgetful, noise, slow

    @property
    def repeatable(self) -> bool:
        return not self._forgetful

    def perform(self, trial: Trial) -> list[Recording]:
        if self._folder is not None:
            self._folder.mkdir(exist_ok=True)
            self._remember(trial)
        return [self._run(trial, k) for k in range(trial.repeats)]

    def _remember(self, trial: Trial) -> None:
        folder = self._folder or Path()
        if self._forgetful:
            with (folder / "performed.txt").open("a") as file:
                file.write(trial.name + "\n")
            return
        if (folder / trial.name).exists():
            return
        aside = folder / f".{trial.name}.{os.getpid()}"
        aside.write_text(repr(dict(trial.settings)))
        os.link(aside, folder / trial.name)  # fails where it exists

    def _run(self, trial: Trial, repeat: int) -> Recording:
        rng = np.random.default_rng([zlib.crc32(trial.name.encode()), repeat])
        gains = Gains(np.array([[trial.settings["proportional"], trial.settings["feed forward"]]])).towards(
            _target(trial)
        )
        x = moving = 0.0
        position, command = np.zeros(len(TIME)), np.zeros(len(TIME))
        for k, t in enumerate(TIME):
            position[k] = x + self._noise * rng.standard_normal()
            u = float(gains.command(_seen(t, position[k : k + 1]))[0, 0])
            command[k] = u
            sent = np.sign(u) * max(0.0, abs(u) - 0.03)
            moving += STEP * (1.4 * sent - moving) / self._slow
            x += STEP * (moving - 0.5 * x)
        channels = {
            "command": Channel("command", ("x",), "m/s", TIME, command[:, None]),
            "position": Channel("position", ("x",), "m", TIME, position[:, None]),
        }
        name = trial.name if trial.repeats == 1 else f"{trial.name}-{repeat + 1}"
        return Recording(name, channels, {"source": "toy"})


class Nearby:
    """A search without imports of its own: normal steps about the best so far, smaller with each generation."""

    def __init__(self, start: Array, *, seed: int, generation: int = 8, generations: int = 5) -> None:
        self._rng = np.random.default_rng(seed)
        self._best, self._loss = np.asarray(start, dtype=np.float64), np.inf
        self._size, self._left, self._all = generation, generations, generations

    def ask(self) -> Array:
        width = 0.3 * 0.6 ** (self._all - self._left)
        return np.clip(self._best + width * self._rng.standard_normal((self._size, len(self._best))), 0.0, 1.0)

    def tell(self, candidates: Array, losses: Array) -> None:
        self._left -= 1
        k = int(np.nanargmin(losses))
        if losses[k] < self._loss:
            self._best, self._loss = candidates[k], float(losses[k])

    @property
    def done(self) -> str:
        return "" if self._left else "all generations are done"

    @property
    def best(self) -> tuple[Array, float]:
        return self._best, self._loss

    def state(self) -> dict[str, object]:
        return {}


def regression(
    simulator: Lag, recordings: Sequence[Recording], held_out: Sequence[Recording], progress: Callable[..., None]
) -> Calibration:
    """A calibration by linear regression, x' = gain u - drag x, so that a test of the journal need not wait for a fit."""
    rows, targets = [], []
    for r in recordings:
        x, u = r.channel("position").values[:, 0], r.channel("command").values[:, 0]
        smooth = np.convolve(x, np.ones(5) / 5, mode="valid")
        rows.append(np.stack([u[2:-3], -smooth[:-1]], axis=1))
        targets.append(np.diff(smooth) / STEP)
    a, b = np.concatenate(rows), np.concatenate(targets)
    values, *_ = np.linalg.lstsq(a, b, rcond=None)
    values = np.clip(values, [0.2, 0.0], [3.0, 2.0])
    covariance = np.linalg.inv(a.T @ a) * float(np.mean((a @ values - b) ** 2))
    estimates = tuple(
        Estimate(p.name, p.unit, p.nominal, float(v), float(v - s), float(v + s), p.lower, p.upper, True, "identified")
        for p, v, s in zip(simulator.parameters.parameters, values, 2 * np.sqrt(np.diag(covariance)), strict=True)
    )
    replays = []
    for r in recordings:
        trial = Trial.of(r, ("position",))
        before = simulator.shipped().rollout([trial], np.zeros((1, 0)))[0].channels["position"][0]
        after = simulator.rollout([trial], values[None])[0].channels["position"][0]
        replays.append(
            Replay(r.name, False, "position", ("x",), "m", r.time, r.channel("position").values, before, after)
        )
    return Calibration("lag", estimates, tuple(replays), (), covariance)


def _target(trial: Trial) -> str:
    reference = trial.references.get("target")
    if reference is None:
        return "steps"
    return next(name for name, values in TARGETS.items() if np.array_equal(values, reference.values[:, 1]))


def _commands(trial: Trial) -> Array:
    channel = trial.command
    return np.zeros(len(TIME)) if channel is None else channel.at(TIME + trial.start, hold=True)[:, 0]


def _seen(time: float, x: Array) -> Observation:
    return Observation(float(time), x[:, None], np.zeros((len(x), 1)), {})


def _at(values: Array, times: Array) -> Array:
    return values[:, np.clip(np.round(times / STEP).astype(int), 0, len(TIME) - 1)]


__all__ = ["Cart", "Follow", "Lag", "Nearby", "regression"]


class Arrive(Follow):
    """The same task, which is done where the cart is near its target at the end."""

    def succeeded(self, rollouts: Sequence[Rollout]) -> NDArray[np.bool_]:
        away = [np.abs(r.channels["position"][:, -1, 0] - TARGETS[_target(r.trial)][-1]) for r in rollouts]
        return np.max(away, axis=0) < 0.25
