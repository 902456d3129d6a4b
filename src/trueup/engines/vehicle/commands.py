# SPDX-License-Identifier: Apache-2.0
"""A car's commands: shares of throttle and steering in whatever numbers a log writes them, or speeds and angles in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from trueup.arrays import Array
from trueup.engines.vehicle.look import Look
from trueup.engines.vehicle.vehicle import DRIVES, PURSUED, TURNED, Vehicle
from trueup.errors import CalibrationError, RecordingError
from trueup.inspection.relations import nearest
from trueup.instant import usual_step
from trueup.recording import Channel, Recording
from trueup.rounding import PRINTED, ROUNDED
from trueup.tracking.cleaned import cleaned
from trueup.tracking.commands import COMMAND, driven_by, told_to_turn, turned_on_the_spot
from trueup.tracking.past import Past
from trueup.tracking.wheels import Wheels, as_driven, told_duties
from trueup.trial import Trial
from trueup.units import AS_FAR, PULSE_FULL, PULSE_MIDDLE, are_pulses, size_of, to_si

_ASIDE = 0.25  # share of the full steering: a car that drives straight on so far from zero counts from elsewhere
_WHEEL_UNITS = {u: u for u in ("m/s", "cm/s", "mm/s", "rad/s", "deg/s", "rpm", "rev/s")} | {"counts a second": ""}
"""In which wheels are told a speed, as it is said: the unit."""
_OTHER_SPEEDS = ("km/h", "mph", "cm/s", "mm/s")
"""In which logs have speeds beside m/s."""


def with_commands(car: Vehicle, recordings: Sequence[Recording]) -> tuple[Vehicle, tuple[str, ...]]:
    """The car with `middle` and `full` of its commands as all the recordings suggest, and notes; as it is where it says.

    Steering that turns the car to the right as it grows gets a full command below zero. Raises RecordingError for
    recordings without pose or command.
    """
    duties = any(told_duties(r) for r in recordings)
    recordings = recordings if car.wheels is None else [as_driven(r, car.wheels) for r in recordings]
    if car.full is not None or not recordings:
        return car, ()
    car = _told_by(car, recordings)
    commands = [driven_by(r, car.steered_over) for r in recordings]
    spins = max(turned_on_the_spot(r) for r in recordings) if car.drive != TURNED else 0.0
    sized = [car.pursues and all(c.unit_of(label) for c in commands) for label in COMMAND]
    if car.wheels is not None and not any((*sized, duties)) and (unit := _unit_of_wheels(car, car.wheels, recordings)):
        way = _way(car.wheels, unit)
        full = (1.0 / way, car.wheels.track / way)
        note = f"commands of the wheels: taken as {unit} by the way driven; say so in the mapping if they are anything else"
        return replace(car, middle=(0.0, 0.0), full=full, in_si=True), (note,)
    middle, full = _middles_and_fulls(car, commands, sized)
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
    read = partial(cleaned, enabled_by=car.enabled_by, wheelbase=car.steered_over, headings=car.headings)
    drives = [read(r, middle=middle, full=full) for r in recordings]
    straight = Look.at(drives).straight_on()
    if abs(straight) > _ASIDE and not sized[1]:
        off = np.concatenate([c.column("steering") for c in commands]) - (middle[1] + full[1] * straight)
        scaled = replace(car, middle=(middle[0], middle[1] + full[1] * straight), full=(full[0], _rounded(off)))
        notes.append(f"steering: the car drives straight on at {scaled.middle[1]:.3g}, which counts as its middle")
        drives = [read(r, middle=scaled.middle, full=scaled.full) for r in recordings]
    try:
        Look.at(drives).starts(scaled)
    except CalibrationError:
        scaled = replace(scaled, full=(full[0], -(scaled.full or full)[1]))
        notes.append("steering: grows to the right, taken as its opposite")
    return (scaled, tuple(notes)) if notes or car.pursues else (car, ())


def rolling(car: Vehicle, values: Mapping[str, float]) -> tuple[str, ...]:
    """What calibrated gains of speed and turn rate mean for two wheels; nothing where their commands are no speeds."""
    if car.wheels is None or not car.in_si:
        return ()
    further, turn = values["speed_scale"], 0.5 * (values["turn_left"] + values["turn_right"])
    radius = f" (as with a radius of {further * car.wheels.radius:.4g} m)" if car.wheels.radius else ""
    return (
        f"two driven wheels: they roll {further:.3f} of the way that they are told{radius}, and turn the robot as "
        f"if they were {car.wheels.track * further / turn:.4g} m apart (track in the file: {car.wheels.track:.4g} m)",
    )


def in_another_unit(car: Vehicle, values: Mapping[str, float]) -> tuple[str, ...]:
    """That a car goes as far for a commanded 1 m/s as for one of another unit; nothing where it does not."""
    scale = values.get("speed_scale", 1.0)
    unit = nearest(scale, {u: size_of(u) for u in _OTHER_SPEEDS}) if car.drive == PURSUED and car.in_metres else ""
    if not unit:
        return ()
    return (
        f"speed_scale is {scale:.4g}: the commanded speeds were taken for m/s and look like {unit}. Say so in the mapping's "
        f'[channels.command], units = ["{unit}", "rad"] (or deg), before a path follower is tuned in this car in m/s',
    )


def _unit_of_wheels(car: Vehicle, wheels: Wheels, recordings: Sequence[Recording]) -> str:
    """The unit of wheels' commands that fits how far the robot went; '' for none."""
    told = driven = 0.0
    for recording in recordings:
        clean = cleaned(recording, full=(1.0, 1.0), wheelbase=0.0, headings=car.headings)
        past = Past.of(Trial.of(clean, ["position", "heading"]), usual_step(clean.channel("position").time), COMMAND)
        told += float(np.abs(past.commands[past.known, 0]).sum())
        driven += float(np.abs(past.seen[past.known, 3]).sum())
    ways = {u: _way(wheels, u) for u in _WHEEL_UNITS}
    off = {u: abs(np.log(driven / told / way)) for u, way in ways.items() if way > 0.0 and told > 0.0 < driven}
    best = min(off, key=lambda u: off[u], default="")
    return best if best and off[best] < np.log(AS_FAR) else ""


def _way(wheels: Wheels, unit: str) -> float:
    """m/s for one of a `unit` of wheels' speeds; 0 where that is not known."""
    si, factor, _ = to_si(_WHEEL_UNITS[unit])
    return factor * wheels.way(si)


def _told_by(car: Vehicle, recordings: Sequence[Recording]) -> Vehicle:
    """The car, where its file does not say what drives it as all logs do: a speed, with a turn rate or steering."""
    if car.declared or not all("m/s" in driven_by(r, car.wheelbase).units for r in recordings):
        return car
    drive = TURNED if all(told_to_turn(r) for r in recordings) else PURSUED
    return replace(car, drive=drive) if set(car.values) <= {q.name for q in DRIVES[drive]} else car


def _middles_and_fulls(
    car: Vehicle, commands: Sequence[Channel], sized: Sequence[bool]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of both commands; of two wheels, which both are made of, the full one is the same."""
    drive, steering = (
        (0.0, 1.0) if si else _middle_and_full(commands, label) for si, label in zip(sized, COMMAND, strict=True)
    )
    full = (drive[1], steering[1])
    return (drive[0], steering[0]), (max(full), max(full)) if car.wheels is not None and not any(sized) else full


def _middle_and_full(commands: Sequence[Channel], label: str) -> tuple[float, float]:
    """What stands for zero and for one: 1500 and 500 of pulses, 0 and the next of 1, 2, 5, 10 ... of other numbers.

    Raises RecordingError where no command is a number.
    """
    values = np.concatenate([c.column(label) for c in commands])
    values = values[np.isfinite(values)]
    if not len(values):
        raise RecordingError(f"no recording holds a number for {label}")
    if are_pulses(values):
        return PULSE_MIDDLE, PULSE_FULL
    return 0.0, _rounded(values) if float(np.abs(values).max()) > AS_FAR else 1.0


def _rounded(values: Array) -> float:
    """The next of 1, 2, 5, 10 ... of the largest value."""
    largest = max(float(np.nanmax(np.abs(values))), PRINTED)
    ten = 10.0 ** np.floor(np.log10(largest))
    return float(next(n * ten for n in (1.0, 2.0, 5.0, 10.0) if n * ten >= largest * (1.0 - ROUNDED)))
