# SPDX-License-Identifier: Apache-2.0
"""Optuna's samplers as a Search: TPE, Gaussian processes, CMA-ES; several candidates at once; SQLite for the dashboard.

T. Akiba et al., "Optuna: A Next-generation Hyperparameter Optimization Framework", KDD 2019.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import TrialState, create_trial

from trueup.arrays import Array
from trueup.errors import CalibrationError, MissingExtraError
from trueup.search.search import SearchState
from trueup.search.study_file import append

SAMPLERS = ("tpe", "gp", "cma")


class OptunaSearch:
    """Asks one of Optuna's samplers, `batch` candidates at a time, until `trials` of them are told.

    'tpe' is the tree-structured Parzen estimator (Optuna's default), 'gp' Gaussian processes (few, costly trials), 'cma'
    CMA-ES. The first candidate is `start`. `ask` may be called again before all is told: candidates under way count as
    bad ones near by (the constant liar), so that the next ones lie elsewhere. Failed evaluations (NaN) are told as such.

    Each trial draws from a generator of its own, seeded by `seed` and its number, so the state is what was asked and
    told. With `path` the study is written to an SQLite file when the search ends or on `save`, for optuna-dashboard.
    """

    def __init__(
        self, start: Array, *, seed: int, trials: int = 200, sampler: str = "tpe", batch: int = 1,
        path: str | Path | None = None, study: str = "trueup", labels: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        """Raises CalibrationError for an unknown sampler, MissingExtraError where 'gp' has no PyTorch."""
        if sampler not in SAMPLERS:
            raise CalibrationError(f"sampler '{sampler}' is unknown; samplers are: {', '.join(SAMPLERS)}")
        if sampler == "gp" and importlib.util.find_spec("torch") is None:
            raise MissingExtraError("Optuna's Gaussian-process sampler", "torch", "gp")
        self._start = np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)
        self._labels = tuple(labels) if labels is not None else tuple(f"x{i}" for i in range(len(self._start)))
        if len(set(self._labels)) != len(self._start):
            raise CalibrationError(f"{len(self._start)} parameters need as many different labels, not {self._labels}")
        self._box: dict[str, BaseDistribution] = {label: FloatDistribution(0.0, 1.0) for label in self._labels}
        self._sampler, self._seed, self._trials, self._batch = sampler, seed, trials, batch
        self._path, self._name = (None if path is None else Path(path)), study
        self._pending: dict[bytes, list[int]] = {}  # candidate -> the trials that try it
        self._events: list[dict[str, Any]] = []
        self._asked, self._told, self._saved = 0, 0, 0
        self._best, self._best_loss = self._start, np.inf
        with _quiet():
            self._study = optuna.create_study(study_name=study)

    def ask(self) -> Array:
        """(batch, n) in [0, 1]; fewer where the budget ends, (0, n) where all of it is under way."""
        count = max(0, min(self._batch, self._trials - self._asked))
        rows = np.array([self._sample() for _ in range(count)]).reshape(count, len(self._start))
        self._events.append({"asked": rows.tolist()})
        return rows

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses (b,) of candidates asked before, in any order. Raises CalibrationError for one never asked for."""
        rows, given = np.asarray(candidates, dtype=np.float64), np.asarray(losses, dtype=np.float64)
        numbers = []
        for row in rows:
            waiting = self._pending.get(row.tobytes())
            if not waiting:
                raise CalibrationError(f"candidate {row.tolist()} was never asked for, or was told before")
            numbers.append(waiting.pop(0))
        self._events.append({"numbers": numbers, "losses": [float(x) if np.isfinite(x) else None for x in given]})
        with _quiet():
            for number, row, loss in zip(numbers, rows, given, strict=True):
                self._tell(number, row, float(loss))
        if self.done:
            self.save()

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return f"all {self._trials} trials are told" if self._told >= self._trials else ""

    @property
    def best(self) -> tuple[Array, float]:
        """The best candidate told so far, and its loss; the start and inf where none was."""
        return self._best, self._best_loss

    @property
    def study(self) -> optuna.Study:
        """Optuna's own study, for its plots and importances."""
        return self._study

    def state(self) -> SearchState:
        """Every candidate asked for and every loss told, in order."""
        return {"sampler": self._sampler, "seed": self._seed, "labels": list(self._labels), "events": self._events}

    def resume(self, state: SearchState) -> None:
        """Goes on where `state` was taken. Raises CalibrationError where it belongs to another search."""
        mine = {"sampler": self._sampler, "seed": self._seed, "labels": list(self._labels)}
        for key, value in mine.items():
            if state[key] != value:
                raise CalibrationError(f"the saved search had {key} {state[key]}, not {value}; start in a new folder")
        for event in state["events"]:
            if "asked" in event:
                self._ask_again(np.array(event["asked"]).reshape(-1, len(self._start)))
            else:
                losses = [np.nan if loss is None else loss for loss in event["losses"]]
                trials = self._study.get_trials(deepcopy=False)
                rows = [[trials[n].params[label] for label in self._labels] for n in event["numbers"]]
                self.tell(np.array(rows), np.array(losses))

    def save(self) -> None:
        """Writes what was told since the last time into the SQLite file, if there is a path; see study_file."""
        if self._path is None:
            return
        with _quiet():
            finished = [t for t in self._study.get_trials(deepcopy=False) if t.state.is_finished()]
            self._saved = append(self._path, self._name, finished, self._saved)

    def _sample(self) -> list[float]:
        number, self._asked = self._asked, self._asked + 1
        if number == 0:
            return self._add(self._start.tolist())
        with _quiet():
            # A new sampler for each trial: what it draws depends on the history and the number alone.
            self._study.sampler = self._new_sampler(
                int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])
            )
            trial = self._study.ask(self._box)
        row = [float(trial.params[label]) for label in self._labels]
        self._pending.setdefault(np.array(row).tobytes(), []).append(trial.number)
        return row

    def _new_sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        if self._sampler == "tpe":
            return optuna.samplers.TPESampler(seed=seed)
        if self._sampler == "gp":
            return optuna.samplers.GPSampler(seed=seed)
        return optuna.samplers.CmaEsSampler(seed=seed % 2**31, n_startup_trials=1, warn_independent_sampling=False)

    def _add(self, row: list[float]) -> list[float]:
        """A running trial at a given candidate, without asking the sampler."""
        params = dict(zip(self._labels, row, strict=True))
        with _quiet():
            self._study.add_trial(create_trial(state=TrialState.RUNNING, params=params, distributions=self._box))
        self._pending.setdefault(np.array(row).tobytes(), []).append(len(self._study.get_trials(deepcopy=False)) - 1)
        return row

    def _ask_again(self, rows: Array) -> None:
        """CMA-ES keeps its state in its trials and has to draw them again; the others need only see the candidates."""
        for row in rows:
            if self._sampler == "cma":
                again = self._sample()
                if not np.array_equal(again, row):
                    raise CalibrationError("the saved search does not repeat (another version of Optuna?): start anew")
            else:
                self._asked += 1
                self._add(row.tolist())
        self._events.append({"asked": rows.tolist()})

    def _tell(self, number: int, row: Array, loss: float) -> None:
        self._told += 1
        if not np.isfinite(loss):
            self._study.tell(number, state=TrialState.FAIL)
            return
        self._study.tell(number, loss)
        if loss < self._best_loss:
            self._best, self._best_loss = np.array(row), loss


@contextmanager
def _quiet() -> Iterator[None]:
    """Optuna says nothing of its own; what the user had set is back afterwards."""
    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        yield
    finally:
        optuna.logging.set_verbosity(level)
