# SPDX-License-Identifier: Apache-2.0
"""What a simulator lacks, found by search in it: added to commands (a delta action) or to joints, it replays the robot.

T. He et al., "ASAP: aligning simulation and real-world physics for learning agile humanoid whole-body skills" (2025), learn
a delta action by reinforcement. Here each recording is replayed with an addition in each frame, which is improved until the
simulated joints go where the robot's went: iterative learning control (D. Bristow, M. Tharayil, A. Alleyne, IEEE Control
Systems 26(3), 2006), each time by the least squares of a response that the simulator itself shows. What was added is then
learned as a function of state and command.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from trueup.arrays import Array, Mask
from trueup.controllers.controller import Controller, Observation
from trueup.engines.simulator import Commanded, Forced, Simulator
from trueup.errors import GroundingError, counted
from trueup.evidence import evidence
from trueup.grounding.comparison import MOST, cross_validated, folds_by_run
from trueup.grounding.frames import instants_of, measured_at
from trueup.grounding.grounded import playing
from trueup.grounding.grounding import Grounding
from trueup.grounding.learners import LEARNERS
from trueup.grounding.rows import Rows, rows_of
from trueup.grounding.views import fitted
from trueup.recording import Recording
from trueup.rounding import SAME_INSTANT, TINY
from trueup.trial import Observed, Trial

_MEMORY = 0.3  # s after which a joint has answered to what was added


def with_residual(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array, *, torque: bool = False,
    seed: int = 0,
) -> Grounding:  # fmt: skip
    """The grounding with what `simulator` lacks to replay `recordings`, as an addition to commands or as torque on joints.

    `values` (n,) of the simulator's parameters. It is learned by a line, or by the learner that the grounding was learned
    by where that foretells runs left out surely better (`evidence`). Raises GroundingError where every replay fails.
    """
    inverted = inverse_replay(grounding, simulator, recordings, values, torque=torque, seed=seed)
    rows = _rows(grounding, recordings, inverted)
    rng, view = np.random.default_rng(seed), grounding.about.get("view", "own")
    names = dict.fromkeys(("linear", grounding.about.get("learner", "linear")))
    folds, scores = folds_by_run(rows), {}
    for name in names:
        told = cross_validated(LEARNERS[name], rows, folds, view, seed=seed, chained=False, moves=False)
        if told is not None:
            scores[name] = told.by_fold
    learner = next((n for n in scores if evidence(scores["linear"], scores[n]).holds), "linear")
    model = fitted(LEARNERS[learner], rows.thinned(MOST), rng, view, moves=False)
    error = np.sqrt(np.mean(inverted.after**2) / max(float(np.mean(inverted.before**2)), TINY))
    about = {**grounding.about, "residual": "torque" if torque else "command", "residual learner": learner,
             "residual replay": f"{error:.3f} of the error without it, on the recordings it was found on"}  # fmt: skip
    return dataclasses.replace(grounding, residual=model, torque=torque, inverse=None, weights=(0.0, 1.0), about=about)


@dataclass(frozen=True, eq=False)
class Inverted:
    """What was added in each frame of each recording, and how far the simulated joints then were from the robot's."""

    added: tuple[Array, ...]
    """(N, k) each, in the commands' unit or in N m."""
    before: Array
    """(recordings,) root mean squared error without it, in the joints' unit."""
    after: Array


def inverse_replay(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array, *, torque: bool = False,
    seed: int = 0,
) -> Inverted:  # fmt: skip
    """Additions with which the simulator replays recordings. Raises GroundingError where it replays none to its end."""
    rounds = 8  # of improvement; each counts only where it replays better
    if torque and not isinstance(simulator, Forced):
        raise GroundingError(
            f"simulator '{simulator.name}' has no joints that can be pushed on: no residual torque here"
        )
    replay = _Replay(grounding, simulator, recordings, values, torque)
    added = [np.zeros_like(real) for real in replay.real]
    plain = replay.run(added)
    if not any(s is not None for s in plain):
        raise GroundingError(f"'{simulator.name}' replays none of {counted(len(recordings), 'recording')} to its end")
    errors = [None if s is None else real - s for real, s in zip(replay.real, plain, strict=True)]
    before = np.array([np.nan if e is None else _root(e) for e in errors])
    reach = _roots(errors)
    response = replay.response(plain, reach, np.random.default_rng(seed))
    after, steps = np.array(before), np.ones(len(added))
    for _ in range(rounds):
        tried = [
            a if e is None else a + step * response.answer(e, a, replay.noise / reach)
            for a, e, step in zip(added, errors, steps, strict=True)
        ]
        for k, s in enumerate(replay.run(tried)):
            error = np.inf if s is None else _root(replay.real[k] - s)
            if s is None or not error < after[k]:
                steps[k] *= 0.5
                continue
            added[k], after[k], errors[k] = tried[k], error, replay.real[k] - s
    return Inverted(tuple(added), before, after)


@dataclass(frozen=True, eq=False)
class Response:
    """How each joint answers to what is added to its own command or torque, as a pulse response."""

    pulse: Array
    """(m, k): of a joint n frames after one in which 1 was added, from the next frame on."""
    unknown: Array
    """(k,) share of the answers that it does not explain."""

    @classmethod
    def estimated(
        cls, noise: Sequence[Array], plain: Sequence[Array | None], noisy: Sequence[Array | None], memory: int
    ) -> Response:
        """By least squares from replays with noise added, new in each frame and to each joint, and without."""
        pairs = [(n, b - a) for n, a, b in zip(noise, plain, noisy, strict=True) if a is not None and b is not None]
        if not pairs:
            raise GroundingError("every replay with noise added broke off: nothing says how the simulator answers")
        pulse, unknown = [], []
        for j in range(noise[0].shape[1]):
            A = np.concatenate([_lagged(n[:, j], memory) for n, _ in pairs])
            d = np.concatenate([moved[:, j] for _, moved in pairs])
            g, *_ = np.linalg.lstsq(A, d, rcond=None)
            pulse.append(g)
            unknown.append(_root(d - A @ g) / max(_root(d), TINY))
        return cls(np.stack(pulse, axis=1), np.array(unknown))

    def answer(self, error: Array, added: Array, noise: Array) -> Array:
        """(N, k) what to add besides `added` against `error` (N, k), by least squares: no more than removes it at rest where
        the response is not known, and in all no more than what the measurement's `noise` (k,), a share of the first errors,
        lets one know.
        """
        out = np.empty_like(error)
        for j, g in enumerate(self.pulse.T):
            G = sparse.csc_array(toeplitz_of(g, len(error)))
            step, whole = ((share[j] * g.sum()) ** 2 for share in (self.unknown, noise))
            A = sparse.csc_array(G.T @ G + (step + whole + TINY) * sparse.eye_array(len(error)))
            out[:, j] = np.asarray(spsolve(A, G.T @ error[:, j] - whole * added[:, j]))
        return out


class _Replay:
    """Recordings of a robot, replayed with something added in each frame."""

    def __init__(
        self, grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array, torque: bool
    ) -> None:
        self._inputs, self._simulator, self._torque = grounding.inputs, simulator, torque
        self._values = np.atleast_2d(values)
        labels = self._inputs.commands
        self._trials: list[Trial] = []
        self._measured: list[Mask] = []
        self.real: list[Array] = []
        for recording in recordings:
            trial, instants = Trial.of(recording, ["position"]), instants_of(recording, self._inputs.period)
            observed = {"position": Observed(labels, self._inputs.unit, instants)}
            self._trials.append(dataclasses.replace(trial, observed=observed))
            real = measured_at(recording.channel("position").select(labels), instants, self._inputs.period)
            self._measured.append(np.isfinite(real))
            self.real.append(np.nan_to_num(real))
        rows = rows_of(recordings, self._inputs)
        self.noise = rows.noise
        self._scale = self._strength() if torque else _changes(rows)

    def run(self, added: Sequence[Array]) -> list[Array | None]:
        """(N, k) simulated joints of each recording, 0 as in `real` where nothing was measured; None where it failed."""
        trials = [self._trial(t, a) for t, a in zip(self._trials, added, strict=True)]
        done = self._simulator.rollout(trials, self._values)
        seen = [None if o.failures else o.channels["position"][0] for o in done]
        return [s if s is None else np.where(known, s, 0.0) for s, known in zip(seen, self._measured, strict=True)]

    def response(self, plain: Sequence[Array | None], reach: Array, rng: np.random.Generator) -> Response:
        """The response to noise that moves joints by about as much as is to be removed, `reach` (k,): found in two passes."""
        memory, scale = max(round(_MEMORY / self._inputs.period), 1), self._scale
        noise, noisy = self._noisy(scale, rng)
        moved = _roots([None if a is None or b is None else b - a for a, b in zip(plain, noisy, strict=True)])
        noise, noisy = self._noisy(scale * reach / np.maximum(moved, TINY), rng)
        return Response.estimated(noise, plain, noisy, memory)

    def _noisy(self, scale: Array, rng: np.random.Generator) -> tuple[list[Array], list[Array | None]]:
        noise = [scale * rng.standard_normal(real.shape) for real in self.real]
        return noise, self.run(noise)

    def _trial(self, trial: Trial, added: Array) -> Trial:
        frame = self._inputs.period
        inner = playing(self._simulator, trial, frame)
        own = trial.command.labels if trial.command is not None else ()
        columns = self._simulator.commanded if isinstance(self._simulator, Commanded) else own

        def adding_controller(values: Array) -> Controller:
            return _Adding(inner(values), added, frame, self._inputs.commands, columns, self._torque)

        return dataclasses.replace(trial, controller=adding_controller)

    def _strength(self) -> Array:
        """(k,) N m: a tenth of what the simulator's own drives give in the replays."""
        labels = self._inputs.commands
        trials = [
            dataclasses.replace(t, observed={"torque": Observed(labels, "N m", t.observed["position"].time)})
            for t in self._trials
        ]
        done = [o.channels["torque"][0] for o in self._simulator.rollout(trials, self._values) if not o.failures]
        return 0.1 * np.sqrt(np.mean([np.mean(x**2, axis=0) for x in done], axis=0)) if done else np.ones(len(labels))


class _Adding:
    """A Controller that adds so much in each frame to the commands of another one, or pushes on the joints."""

    def __init__(
        self, inner: Controller, added: Array, frame: float, joints: Sequence[str], columns: Sequence[str], torque: bool
    ) -> None:
        self._inner, self._added, self._frame = inner, added, frame
        self._columns = [list(columns).index(j) for j in joints]
        self.period, self.forced, self.torque = inner.period, tuple(joints) if torque else (), added[:1]

    def reset(self, observation: Observation) -> None:
        """See Controller."""
        self._inner.reset(observation)

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        out = np.array(self._inner.command(observation), dtype=np.float64)
        frame = min(int((observation.time + SAME_INSTANT) / self._frame), len(self._added) - 1)
        if self.forced:
            self.torque = self._added[[frame]]
        else:
            out[:, self._columns] += self._added[frame]
        return out


def _rows(grounding: Grounding, recordings: Sequence[Recording], inverted: Inverted) -> Rows:
    """The robot's states and commands, each with what was added there."""
    rows = rows_of(recordings, grounding.inputs)
    Y = np.stack([inverted.added[r][n] for r, n in zip(rows.run, rows.frame, strict=True)])
    replayed = np.isfinite(inverted.after)[rows.run]
    rows = dataclasses.replace(rows, Y=Y, spread=np.maximum(Y[replayed].std(axis=0), TINY), noise=np.zeros(Y.shape[1]))
    return rows.where(replayed)


def _changes(rows: Rows) -> Array:
    """(k,) how much commands change from one frame to the next."""
    asked = rows.X[:, rows.inputs.command_columns]
    follows = (np.diff(rows.run) == 0) & (np.diff(rows.frame) == 1)
    return np.sqrt(np.mean(np.diff(asked, axis=0)[follows] ** 2, axis=0))


def toeplitz_of(pulse: Array, count: int) -> sparse.dia_array:
    """(count, count): from what is added in each frame to how a joint answers in each."""
    band = np.repeat(pulse[: count - 1, None], count, axis=1)
    return sparse.dia_array((band, -1 - np.arange(len(band))), shape=(count, count))


def _lagged(x: Array, memory: int) -> Array:
    """(N, memory) a signal one, two, ... frames before; nothing came before it began."""
    padded = np.concatenate([np.zeros(memory), x[:-1]])
    return np.stack([padded[memory - 1 - i : memory - 1 - i + len(x)] for i in range(memory)], axis=1)


def _roots(errors: Sequence[Array | None]) -> Array:
    """(k,) root mean squares of errors (N, k) of several replays."""
    return np.sqrt(np.mean([np.mean(e**2, axis=0) for e in errors if e is not None], axis=0))


def _root(wrong: Array) -> float:
    return float(np.sqrt(np.mean(wrong**2)))
