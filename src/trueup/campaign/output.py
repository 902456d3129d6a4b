# SPDX-License-Identifier: Apache-2.0
"""The folder of one calibration: never overwrites another's results, keeps the state to go on from, names its files."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trueup.calibration import Calibration, Replay, pooled_rmse
from trueup.errors import OutputError
from trueup.formats.aside import kept_state, write_aside
from trueup.formats.plain import write_json
from trueup.recording import Recording

_STATE, _OUTCOME = "state.json", "calibration.json"
_LAYOUT = 2  # of what the state holds; one of another layout is not gone on from
_FILES = (_OUTCOME, "parameters.toml", "report.html", "replay.svg")


@dataclass(frozen=True)
class Output:
    """Where the results of a calibration go. `resume` is the state that an interrupted run of the same left, if any."""

    folder: Path
    fingerprint: str
    model_file: Path
    resume: Mapping[str, Any] | None = None
    note: str = ""
    """Why this folder, where it is not simply the one that was asked for."""

    @classmethod
    def open(cls, folder: Path, model: Path, fingerprint: str, *, suffix: str = ".xml", force: bool = False) -> Output:
        """The folder, or the first of folder-2, folder-3 ... that holds no other results; `force` takes it as it is.

        `suffix` is that of the calibrated model's file. A folder that another process writes to is passed by. Raises
        OutputError where it cannot be made, where the calibrated model would overwrite the one given, and where another
        process writes to what is to be taken by `force`.
        """
        name, busy = f"{model.stem}{suffix}", False
        for at in numbered(folder):
            if (at / name).resolve() == model.resolve():
                if force:
                    raise OutputError(f"{at / name} is the model that was given; name another folder with --out")
                continue
            state = kept_state(at / _STATE)
            ours = state is not None and state.get("fingerprint") == fingerprint and not force
            if not (ours or force or not any((at / f).exists() for f in (*_FILES, _STATE, name))):
                continue
            if not _claimed(create_folder(at)):
                if force:
                    raise OutputError(f"{at}: another process writes its results there; name another folder with --out")
                busy = busy or at == folder
                continue
            if ours and state is not None:
                return cls(at, fingerprint, at / name, state.get("search"), f"going on from {at / _STATE}")
            why = "is written to by another process" if busy else "holds other results"
            note = f"{folder} {why}, so these go to {at}" if at != folder else ""
            return cls(at, fingerprint, at / name, None, note)
        raise _all_taken(folder)

    @property
    def state_file(self) -> Path:
        """Where the state of an unfinished search is."""
        return self.folder / _STATE

    @property
    def outcome_file(self) -> Path:
        """The plain numbers of a finished calibration."""
        return self.folder / _OUTCOME

    def save(self, state: Mapping[str, Any]) -> None:
        """Keeps the state of the search, written aside and renamed. Raises OutputError."""
        text = json.dumps({"fingerprint": self.fingerprint, "search": _plain(state)})
        write_aside(text, self.state_file)

    def discard(self) -> None:
        """Removes the folder where nothing is in it."""
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def finish(self, calibration: Calibration) -> None:
        """Writes the plain numbers; the state is no longer needed. Raises OutputError."""
        write_json(summary_numbers(calibration), self.outcome_file)
        self.state_file.unlink(missing_ok=True)


def is_empty(folder: Path) -> bool:
    """Whether nothing is in a folder, or it is not there."""
    return not folder.exists() or not any(folder.iterdir())


def free_folder(folder: Path, free: Callable[[Path], bool] = is_empty) -> Path:
    """The folder, or the first of folder-2, folder-3 ... that is `free` to write results to, and to which no other process
    writes; made. Raises OutputError.
    """
    for at in numbered(folder):
        if free(at) and _claimed(create_folder(at)):
            return at
    raise _all_taken(folder)


_CLAIMS: dict[tuple[int, int], int] = {}
"""Folders that this process writes to, by device and number, and what they are held by until it ends."""


def _claimed(folder: Path) -> bool:
    """Whether a folder that is there is this process's to write to from now on: two that began at once would take it for
    empty, and each would replace what the other has found. A lock that ends with the process leaves nothing behind.
    """
    try:
        held = os.open(folder, os.O_RDONLY)
    except OSError:
        return True  # what is wrong with it is said where it is written to
    status = os.fstat(held)
    key = (status.st_dev, status.st_ino)
    if key in _CLAIMS:
        os.close(held)
        return True
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        return False
    except OSError:  # a file system without locks
        os.close(held)
        return True
    _CLAIMS[key] = held
    return True


def numbered(folder: Path) -> Iterator[Path]:
    """The folder, folder-2, folder-3 ... up to 999; run-2, run-3 ... in the one that we are in."""
    yield folder
    whole = folder.resolve()
    for number in range(2, 1000):
        yield folder.with_name(f"{folder.name}-{number}") if folder.name else whole / f"run-{number}"


def _all_taken(folder: Path) -> OutputError:
    return OutputError(f"{folder} and 998 folders like it hold results; name another with --out")


def create_folder(folder: Path) -> Path:
    """The folder, which is there from now on. Raises OutputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"folder {folder} cannot be made ({error.strerror or error})") from None
    return folder


def fingerprint(
    model: Path, parameters: Path | None, recordings: Sequence[Recording], choices: Mapping[str, Any]
) -> str:
    """What a calibration depends on, as one hash: model file, parameters file, recordings, choices."""
    digest = hashlib.sha256(json.dumps({**choices, "state": _LAYOUT}, sort_keys=True).encode())
    for file in (model, parameters):
        digest.update(file.read_bytes() if file is not None else b"-")
    for recording in recordings:
        digest.update(recording.name.encode())
        for part in recording.content():
            digest.update(part)
    return digest.hexdigest()


def summary_numbers(calibration: Calibration) -> dict[str, Any]:
    """The outcome as plain numbers and texts, for scripts: SI units, NaN where there is no number."""
    return {
        "model": calibration.model_name,
        "parameters": [vars(e) for e in calibration.estimates],
        "covariance": calibration.covariance.tolist(),
        "replays": [_replay(r) for r in calibration.replays],
        "cross_validation": [vars(c) for c in calibration.cross_validation],
        "unidentified": list(calibration.unidentified),
        "warnings": list(calibration.warnings),
        "notes": list(calibration.notes),
        "lacking": calibration.lacking,
        "trace": [vars(p) for p in calibration.trace],
        "seconds": calibration.seconds,
        "cpu_seconds": calibration.cpu_seconds,
        "evaluations": calibration.evaluations,
    }


def _replay(replay: Replay) -> dict[str, Any]:
    return {
        "recording": replay.recording,
        "held_out": replay.held_out,
        "channel": replay.channel,
        "unit": replay.unit,
        "labels": list(replay.labels),
        "rmse_before": replay.rmse_before().tolist(),
        "rmse_after": replay.rmse_after().tolist(),
        "pooled_rmse_before": pooled_rmse([replay], after=False),
        "pooled_rmse_after": pooled_rmse([replay], after=True),
        "noise": replay.noise.tolist(),
    }


def _plain(value: Any) -> Any:
    """Arrays as lists."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
