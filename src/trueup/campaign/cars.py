# SPDX-License-Identifier: Apache-2.0
"""A vehicle of a file, calibrated or not, as a campaign's simulator, with delays, dead zone and noise as in its drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.engines.family import family_of
from trueup.engines.simulator import Simulator
from trueup.errors import PlanError
from trueup.recording import Recording

if TYPE_CHECKING:
    from trueup.engines.vehicle import Vehicle
    from trueup.loop.prepare import Preparation


_UNITS = {"speed": "m/s", "steering": "rad"}
"""In which a path follower commands."""


def simulator_of(
    model: Path, say: Callable[[str], None], recordings: Sequence[Recording] = (), as_it_is: bool = False,
    max_steering: float | None = None,
) -> Preparation:  # fmt: skip
    """The vehicle of a TOML file, as `trueup calibrate` takes and writes it, ready for the plan's recordings.

    It starts at the file's values. What recordings tell is fitted anew with the campaign's own added, unless nothing is to be
    fitted (`as_it_is`); without recordings that begins after the first experiment. `max_steering` (rad) is what its steering
    is told at most, None: what it was told in `recordings`.
    Raises PlanError where there is no such file, or no `max_steering` can be had; ModelError, RecordingError.
    """
    from trueup.engines.vehicle.family import Vehicles
    from trueup.loop.prepare import prepare

    if not model.is_file():
        raise PlanError(
            f"[simulator], model: there is no file '{model}'; `trueup calibrate car.toml DRIVES --out fit` writes "
            "fit/car.toml, and a file with [vehicle] and wheelbase = 0.33 (m) will do too"
        )
    if not isinstance(family_of(model), Vehicles):
        raise PlanError(
            f"[simulator], model: '{model}' is no vehicle's TOML file; MJCF and URDF are simulated with type = \"mujoco\""
        )
    fitted = bool(recordings) and not as_it_is
    ready = _limited(prepare(model, recordings if fitted else (), propose=fitted), recordings, max_steering)
    for note in ready.notes:
        say(f"note: {note}")
    if fitted or as_it_is:
        return ready
    say(
        "[calibrate] names no recordings: what is fitted is proposed after the first experiment, whose drives then are all "
        "that is fitted; with those of `trueup calibrate` in recordings = [...] they would count too"
    )
    return replace(
        ready, later=lambda seen: _limited(prepare(model, _with_units(ready.simulator, seen)), seen, max_steering)
    )


def follower(simulator: Simulator) -> Vehicle:
    """The vehicle that a path follower of speeds and angles can drive in a simulator. Raises PlanError for any other."""
    from trueup.engines.vehicle import VehicleSimulator
    from trueup.engines.vehicle.vehicle import PURSUED

    whole = _whole(simulator)
    if not isinstance(whole, VehicleSimulator):
        raise PlanError(f"the task 'follow-path' needs the simulator 'vehicle' or 'bicycle', not '{simulator.name}'")
    car = whole.vehicle
    if not car.in_metres:
        told = f"counts of which {car.full} are the full command" if car.drive == PURSUED else f"by {car.drive}"
        if not car.declared:
            told += ' (drive = "speed" in its [vehicle] says otherwise, drives in [calibrate] tell it)'
        raise PlanError(
            f"the task 'follow-path' commands a speed in m/s and a steering angle in rad, but '{car.name}' is driven "
            f"{told}; log what your controller commands in m/s and rad and calibrate with that, or write a task of your own "
            "(docs/vehicles.md), whose controller commands as the logs do"
        )
    return car


def is_of_a_file(simulator: Simulator) -> bool:
    """Whether a simulator is a vehicle's that pursues what it is told, as files describe them."""
    from trueup.engines.vehicle import VehicleSimulator

    whole = _whole(simulator)
    return isinstance(whole, VehicleSimulator) and whole.vehicle.drive != "speed"


def _whole(simulator: Simulator) -> Simulator:
    """It with all its parameters."""
    from trueup.loop.restricted import Restricted

    return simulator.whole if isinstance(simulator, Restricted) else simulator


def _with_units(simulator: Simulator, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings of trials, whose commands are the speeds and angles that were asked for where nobody says a unit."""
    from trueup.engines.vehicle import VehicleSimulator

    if not isinstance(simulator, VehicleSimulator) or not simulator.vehicle.in_metres:
        return list(recordings)
    commands = [r.channel("command") for r in recordings]
    units = [tuple(c.unit_of(label) or _UNITS.get(label, "") for label in c.labels) for c in commands]
    return [r.with_channel(c.replace(units=u)) for r, c, u in zip(recordings, commands, units, strict=True)]


def _limited(ready: Preparation, recordings: Sequence[Recording], max_steering: float | None) -> Preparation:
    """With the most that its steering is told, where it takes an angle."""
    from trueup.engines.vehicle import VehicleSimulator

    simulator = ready.simulator
    if not isinstance(simulator, VehicleSimulator) or not simulator.vehicle.in_metres:
        return ready
    most = max_steering
    if most is None:
        seen = [simulator.prepared(r).channel("command").column("steering") for r in recordings]
        most = max((float(np.nanmax(np.abs(s))) for s in seen), default=None)
    if most is None:
        raise PlanError(
            f"[simulator]: how far may '{simulator.vehicle.name}' steer? Say max_steering = 0.4 (rad, to either side), or "
            "name drives in [calibrate] recordings, which show how far it was steered"
        )
    return replace(ready, simulator=simulator.with_vehicle(replace(simulator.vehicle, max_steering=most)))
