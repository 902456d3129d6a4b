# SPDX-License-Identifier: Apache-2.0
"""Optuna trials into an SQLite file that optuna-dashboard opens: in bulk, since a transaction a trial costs seconds."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path

import optuna
import sqlalchemy.exc
from optuna.distributions import distribution_to_json
from optuna.trial import FrozenTrial

from trueup.errors import CalibrationError, OutputError


def append(path: Path, study: str, finished: Sequence[FrozenTrial], saved: int) -> int:
    """Adds the trials after the first `saved` to the study in `path`, creating either; returns how many are there now.

    A study of that name may be there from a search that was interrupted; trials that it has are not written twice.
    Raises CalibrationError where it holds other trials, and OutputError where the file cannot be written.
    """
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}")
    try:
        storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
        there = optuna.create_study(study_name=study, storage=storage, load_if_exists=True)
        if saved == 0:
            saved = _common(path, there, finished)
        try:
            _insert(path, study, finished, saved)
        except sqlite3.Error:  # another layout of tables than that of Optuna 4 and 5
            there.add_trials(finished[saved:])
    except (sqlalchemy.exc.SQLAlchemyError, optuna.exceptions.StorageInternalError, OSError) as error:
        raise OutputError(f"{path}: the study cannot be written ({str(error).splitlines()[0]})") from None
    finally:
        _close(locals().get("storage"))
    return len(finished)


def _close(storage: optuna.storages.RDBStorage | None) -> None:
    if storage is not None:
        storage.remove_session()
        storage.engine.dispose()


def _common(path: Path, there: optuna.Study, finished: Sequence[FrozenTrial]) -> int:
    old = there.get_trials(deepcopy=False)
    same = [(a.params, a.state, a.values) == (b.params, b.state, b.values) for a, b in zip(old, finished, strict=False)]
    if len(old) > len(finished) or not all(same):
        raise CalibrationError(
            f"{path} holds a study '{there.study_name}' with other trials; name another file or study"
        )
    return len(old)


def _insert(path: Path, study: str, finished: Sequence[FrozenTrial], saved: int) -> None:
    with sqlite3.connect(path) as base:
        (study_id,) = base.execute("SELECT study_id FROM studies WHERE study_name = ?", (study,)).fetchone()
        for number, trial in enumerate(finished[saved:], start=saved):
            row = (number, study_id, trial.state.name, trial.datetime_start, trial.datetime_complete)
            trial_id = base.execute(
                "INSERT INTO trials (number, study_id, state, datetime_start, datetime_complete) VALUES (?, ?, ?, ?, ?)",
                [str(cell) if i > 2 else cell for i, cell in enumerate(row)],
            ).lastrowid
            base.executemany(
                "INSERT INTO trial_params (trial_id, param_name, param_value, distribution_json) VALUES (?, ?, ?, ?)",
                [
                    (trial_id, name, value, distribution_to_json(trial.distributions[name]))
                    for name, value in trial.params.items()
                ],
            )
            base.executemany(
                "INSERT INTO trial_values (trial_id, objective, value, value_type) VALUES (?, ?, ?, 'FINITE')",
                [(trial_id, k, value) for k, value in enumerate(trial.values or ())],
            )
