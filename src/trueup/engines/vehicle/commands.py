# SPDX-License-Identifier: Apache-2.0
"""A car's commands: shares of throttle and steering in whatever numbers a log writes them, or speeds and angles in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.engines.vehicle.look import Look
from trueup.engines.vehicle.vehicle import DRIVES, PURSUED, TURNED, Vehicle
from trueup.errors import CalibrationError, RecordingError
from trueup.recording import Channel, Recording
from trueup.rounding import PRINTED, ROUNDED
from trueup.tracking.cleaned import cleaned
from trueup.tracking.commands import COMMAND, MOST, driven_by, told_to_turn, turned_on_the_spot

_ASIDE = 0.25  # share of the full steering: a car that drives straight on so far from zero counts from elsewhere
_PULSES = (500.0, 2500.0)  # us: of a servo's signal, whose middle is at 1500 and whose end 500 beside it


def with_commands(car: Vehicle, recordings: Sequence[Recording]) -> tuple[Vehicle, tuple[str, ...]]:
    """The car with `middle` and `full` of its commands as all the recordings suggest, and notes; as it is where it says.

    Steering that turns the car to the right as it grows gets a full command below zero. Raises RecordingError for
    recordings without pose or command.
    """
    if car.full is not None or not recordings:
        return car, ()
    car = _told_by(car, recordings)
    commands = [driven_by(r, car.steered_over) for r in recordings]
    spins = max(turned_on_the_spot(r) for r in recordings) if car.drive != TURNED else 0.0
    sized = [car.pursues and all(c.unit_of(label) for c in commands) for label in COMMAND]
    found = [(0.0, 1.0) if si else _middle_and_full(commands, label) for si, label in zip(sized, COMMAND, strict=True)]
    middle, full = (found[0][0], found[1][0]), (found[0][1], found[1][1])
    notes = [
        f"{label}: {f:g} {f'beside {m:g} ' if m else ''}counts as the full command"
        for label, m, f in zip(COMMAND, middle, full, strict=True)
        if (m, f) != (0.0, 1.0)
    ]
    if spins > 0.0:
        notes.append(
            "commanded by speed and turn rate, taken as a car of this wheelbase: turning on the spot, "
            f"{100.0 * spins:.2g} % of a drive, is not simulated"
        )
    scaled = replace(car, middle=middle, full=full, in_si=all(sized))
    drives = [cleaned(r, car.enabled_by, middle, full, car.steered_over) for r in recordings]
    straight = Look.at(drives).straight_on()
    if abs(straight) > _ASIDE and not sized[1]:
        off = np.concatenate([c.column("steering") for c in commands]) - (middle[1] + full[1] * straight)
        scaled = replace(car, middle=(middle[0], middle[1] + full[1] * straight), full=(full[0], _rounded(off)))
        notes.append(f"steering: the car drives straight on at {scaled.middle[1]:.3g}, which counts as its middle")
        drives = [cleaned(r, car.enabled_by, scaled.middle, scaled.full, car.steered_over) for r in recordings]
    try:
        Look.at(drives).starts(scaled)
    except CalibrationError:
        scaled = replace(scaled, full=(full[0], -(scaled.full or full)[1]))
        notes.append("steering: grows to the right, taken as its opposite")
    return (scaled, tuple(notes)) if notes or car.pursues else (car, ())


def _told_by(car: Vehicle, recordings: Sequence[Recording]) -> Vehicle:
    """The car, where its file does not say what drives it as all logs do: a speed, with a turn rate or steering."""
    if car.declared or not all("m/s" in driven_by(r, car.wheelbase).units for r in recordings):
        return car
    drive = TURNED if all(told_to_turn(r) for r in recordings) else PURSUED
    return replace(car, drive=drive) if set(car.values) <= {q.name for q in DRIVES[drive]} else car


def _middle_and_full(commands: Sequence[Channel], label: str) -> tuple[float, float]:
    """What stands for zero and for one: 1500 and 500 of pulses, 0 and the next of 1, 2, 5, 10 ... of other numbers.

    Raises RecordingError where no command is a number.
    """
    values = np.concatenate([c.column(label) for c in commands])
    values = values[np.isfinite(values)]
    if not len(values):
        raise RecordingError(f"no recording holds a number for {label}")
    moved = values[values != 0.0]  # zero: nothing sent yet
    if len(moved) and _PULSES[0] <= moved.min() and moved.max() <= _PULSES[1]:
        return float(np.mean(_PULSES)), 500.0
    return 0.0, _rounded(values) if float(np.abs(values).max()) > MOST else 1.0


def _rounded(values: Array) -> float:
    """The next of 1, 2, 5, 10 ... of the largest value."""
    largest = max(float(np.nanmax(np.abs(values))), PRINTED)
    ten = 10.0 ** np.floor(np.log10(largest))
    return float(next(n * ten for n in (1.0, 2.0, 5.0, 10.0) if n * ten >= largest * (1.0 - ROUNDED)))
