# SPDX-License-Identifier: Apache-2.0
"""A car's file and drives into a simulator and back; cars judged as they are, two side by side if wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration, Replay
from trueup.errors import ModelError, ParameterError, RecordingError
from trueup.recording import Recording

if TYPE_CHECKING:
    from trueup.engines.car import CarSimulator
    from trueup.loop.calibrate import Options
    from trueup.loop.fit import Checkpoint, Progress

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
    from trueup.engines.car import CarSimulator
    from trueup.engines.car.car_file import read_car
    from trueup.engines.car.commands import with_commands

    if model.suffix.lower() != ".toml":
        raise ModelError(f"{model}: a car is compared with another car's TOML file")
    car, notes = with_commands(read_car(model), recordings)
    if not car.values:
        notes = (*notes, f"{model} holds no [vehicle.values]: it is judged as a usual small car; `trueup calibrate {model} "
                 "DRIVES` finds its own")  # fmt: skip
    return CarSimulator(car), notes


def _predicted(car: CarSimulator, other: CarSimulator | None, recording: Recording) -> Predicted | None:
    """None where the drive holds nothing that could be predicted."""
    from trueup.engines.car.judging import Ahead
    from trueup.engines.car.prediction import moved, prediction_errors
    from trueup.loop.replay import replays

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


class Told(TypedDict):
    """What goes through to `calibrate` as it is."""

    progress: Progress | None
    checkpoint: Checkpoint | None
    resume: dict[str, Any] | None


def car_for(
    path: Path, recordings: Sequence[Recording], parameters_file: str | Path | None
) -> tuple[CarSimulator, tuple[str, ...]]:
    """The simulator of a car's file, started from a first look at `recordings`, and notes.

    Raises ModelError and ParameterError.
    """
    from trueup.engines.car import QUANTITIES, CarSimulator, car_space
    from trueup.engines.car.car_file import read_car
    from trueup.engines.car.commands import with_commands
    from trueup.engines.car.look import LATE, braked, first_look, unseen
    from trueup.engines.car.servo import servo_look

    if parameters_file is not None:
        raise ParameterError(f"{parameters_file}: a car has no parameters file; its own values are in [vehicle.values]")
    car, taken = with_commands(read_car(path), recordings)
    plain = CarSimulator(car)
    drives = [plain.prepared(r) for r in recordings]
    calm = unseen(drives)
    servo = servo_look(drives)
    late = servo["steering_delay"] + servo["steering_lag"] if servo else LATE
    starts = {**first_look(car, drives, late), **servo}
    still = {
        *calm,
        *(() if braked(drives) else ("braking",)),
        *(() if "steering_rate" in starts else ("steering_rate",)),
    }
    steers = max((float(np.nanmax(np.abs(d.channel("command").column("steering")))) for d in drives), default=1.0)
    space = car_space(car, starts, [q.name for q in QUANTITIES if q.free and q.name not in still], steers)
    return CarSimulator(car, space), (*taken, *calm.values())


def calibrated_car(
    simulator: CarSimulator, training: Sequence[Recording], held_out: Sequence[Recording], options: Options, told: Told
) -> Calibration:
    """A car calibrated by how far its predictions go astray; twice where what it is like at the start of a drive lasts.

    Raises what `trueup.loop.calibrate` raises, and RecordingError for drives without pose or command.
    """
    from trueup.engines.car.judging import Ahead
    from trueup.engines.car.prediction import foretold, lasting, spoken
    from trueup.engines.car.training import begun_apart, counted_once
    from trueup.loop.calibrate import calibrate

    drives, others = ([simulator.prepared(r) for r in rs] for rs in (training, held_out))

    def fitted(car: CarSimulator, more: Told) -> Calibration:
        return calibrate(car, begun_apart(drives, car.horizon), others, discrepancy=Ahead(car, drives),
                         options=replace(options, cross_validate=False), **more)  # fmt: skip

    found = fitted(simulator, told)
    shares = lasting(simulator, found.values, drives)
    if shares:
        again = fitted(simulator.starting(shares), {"progress": told["progress"], "checkpoint": None, "resume": None})
        if foretold(simulator, again.values, drives) < foretold(simulator, found.values, drives):
            simulator, found = simulator.starting(shares), again
    once = counted_once(found, drives)
    said = (*once.notes, *spoken(simulator, once.values, [*drives, *others]))
    return replace(once, notes=said, warnings=said_once(once.warnings))


def write_calibrated_car(simulator: CarSimulator, calibration: Calibration, path: Path) -> tuple[str, ...]:
    """Writes the car's file; there is nothing that it cannot say. Raises OutputError."""
    from trueup.engines.car.car_file import write_car

    values = {e.name: e.value for e in calibration.estimates}
    notes = {
        e.name: f"{e.low:.4g} ... {e.high:.4g}, {e.verdict}" if e.fitted else e.verdict for e in calibration.estimates
    }
    write_car(replace(simulator.car, values=values), path, notes)
    return ()
