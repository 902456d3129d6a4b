# SPDX-License-Identifier: Apache-2.0
"""Cars judged as they are: how far their predictions of recorded drives go astray, two cars side by side if wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Replay
from trueup.errors import ModelError, RecordingError
from trueup.recording import Recording

if TYPE_CHECKING:
    from trueup.simulators.car import CarSimulator

Array = NDArray[np.float64]

HORIZONS = (1.0, 3.0)
"""How far ahead predictions are judged, in s."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """One drive: predictions begun every quarter of a second, from what was measured until then, under its commands alone."""

    recording: str
    errors: Array
    """(S, len(HORIZONS)) distance of the predicted position from the tracked one, in m."""
    against: Array | None
    """The same of the other car."""
    moved: float
    """How far the car went within the longest horizon, in m, in the mean."""
    replays: tuple[Replay, ...]
    """Position and heading, predicted anew again and again; `before` is the other car's, or the same where there is none."""


def predictions(
    model: Path, recordings: Sequence[Recording], against: Path | None = None
) -> tuple[tuple[Predicted, ...], tuple[str, ...]]:
    """Every drive predicted by a car's file as it is, and by another one; and notes.

    Raises ModelError for a file that is no car, RecordingError for drives without pose or command, or too short.
    """
    car, notes = as_it_is(model, recordings)
    other, more = as_it_is(against, recordings) if against else (None, ())
    judged = {r.name: _predicted(car, other, r) for r in recordings}
    found = tuple(p for p in judged.values() if p is not None)
    short = [name for name, p in judged.items() if p is None]
    said = f"no place where the car drives and is tracked for {max(HORIZONS):g} s on end, after {max(HORIZONS):g} s of past"
    if not found:
        raise RecordingError(f"{', '.join(short)}: {said}")
    if short:
        more = (*more, f"left out, {said}: {', '.join(short)}")
    taken = [w for r in recordings for w in car.prepared(r).provenance.get("warnings", "").split("\n") if w]
    return found, tuple(dict.fromkeys((*notes, *more, *taken)))


def said_once(warnings: Sequence[str]) -> tuple[str, ...]:
    """Warnings "'name': text" that say the same of several drives, as one that names the first of them."""
    groups: dict[str, list[str]] = {}
    for warning in warnings:
        name, _, text = warning.partition("': ")
        groups.setdefault(text if text and name.startswith("'") else warning, []).append(warning)
    return tuple(
        same[0] if len(same) == 1 else same[0].replace("': ", f"' and {len(same) - 1} more: ", 1)
        for same in groups.values()
    )


def as_it_is(model: Path, recordings: Sequence[Recording]) -> tuple[CarSimulator, tuple[str, ...]]:
    """The simulator of a car's file, nothing fitted; what a full command is may be told from the recordings."""
    from trueup.simulators.car import CarSimulator
    from trueup.simulators.car.car_file import read_car
    from trueup.simulators.car.commands import with_commands

    if model.suffix.lower() != ".toml":
        raise ModelError(f"{model}: a car is compared with another car's TOML file")
    car, notes = with_commands(read_car(model), recordings)
    if not car.values:
        notes = (*notes, f"{model} holds no [vehicle.values]: it is judged as a usual small car; `trueup calibrate {model} "
                 "DRIVES` finds its own")  # fmt: skip
    return CarSimulator(car), notes


def _predicted(car: CarSimulator, other: CarSimulator | None, recording: Recording) -> Predicted | None:
    """None where the drive holds nothing that could be predicted."""
    from trueup.loop.replay import replays
    from trueup.simulators.car.judging import Ahead
    from trueup.simulators.car.prediction import moved, prediction_errors

    clean, nothing = car.prepared(recording), np.zeros(0)
    errors = prediction_errors(car, nothing, clean, HORIZONS)
    if not len(errors):
        return None
    shown = replays(car, nothing, [], [clean], Ahead(car, [clean]), channels=["position", "heading"], against=other)
    return Predicted(
        recording.name, errors,
        None if other is None else prediction_errors(other, nothing, other.prepared(recording), HORIZONS),
        moved(car, clean, max(HORIZONS)), tuple(replace(r, noise=np.zeros(0)) for r in shown),
    )  # fmt: skip
