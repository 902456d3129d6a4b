# SPDX-License-Identifier: Apache-2.0
"""Cars as a family: a file and drives into a simulator and back, judged by how far predictions go astray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration, Prediction
from trueup.engines.car.car import QUANTITIES, Car, car_space
from trueup.engines.car.car_file import read_car, write_car
from trueup.engines.car.commands import with_commands
from trueup.engines.car.judging import Ahead
from trueup.engines.car.look import LATE, braked, first_look, unseen
from trueup.engines.car.prediction import foretold, lasting, moved, prediction_errors, spoken
from trueup.engines.car.rollout import CarSimulator
from trueup.engines.car.servo import servo_look
from trueup.engines.car.training import begun_apart, counted_once
from trueup.engines.family import Family, Fit, Request
from trueup.errors import ParameterError, RecordingError
from trueup.recording import Recording

Array = NDArray[np.float64]

HORIZONS = (1.0, 3.0)
"""How far ahead predictions are judged, in s."""


class Cars(Family):
    """Cars driven by throttle and steering, whose pose was tracked; a model is a TOML file (`read_car`)."""

    suffix = ".toml"
    describes = "another car's TOML file"

    def load(self, path: Path) -> tuple[Path, Car]:
        """The file and the car in it. Raises ModelError."""
        return path, read_car(path)

    def simulator(
        self, model: tuple[Path, Car], training: Sequence[Recording], replayed: Sequence[Recording], request: Request
    ) -> tuple[CarSimulator, tuple[str, ...]]:
        """See Family. With parameters, the search starts from a first look at `training`."""
        path, car = model
        for option, given in (("beyond-mjcf", request.beyond_mjcf), ("step", request.step is not None)):
            if given:
                raise ParameterError(f"--{option} is for MJCF and URDF models; a car is simulated at a step of its own")
        if request.parameters is not None:
            raise ParameterError(
                f"{request.parameters}: a car has no parameters file; its own values are in [vehicle.values]"
            )
        if request.propose:
            return _with_parameters(car, training)
        car, notes = with_commands(car, [*training, *replayed])
        if not car.values:
            notes = (
                *notes, f"{path} holds no [vehicle.values]: it is judged as a usual small car; `trueup calibrate {path} "
                "DRIVES` finds its own",
            )  # fmt: skip
        return CarSimulator(car), notes

    def calibrate(
        self, simulator: CarSimulator, training: Sequence[Recording], held_out: Sequence[Recording], fit: Fit
    ) -> Calibration:
        """Calibrated by how far predictions go astray; twice where what a car is like at the start of a drive lasts.

        Raises what `fit` raises, and RecordingError for drives without pose or command.
        """
        drives, others = ([simulator.prepared(r) for r in rs] for rs in (training, held_out))

        def fitted(car: CarSimulator, *, again: bool) -> Calibration:
            return fit(car, begun_apart(drives, car.horizon), others, discrepancy=Ahead(car, drives),
                       cross_validate=False, again=again)  # fmt: skip

        found = fitted(simulator, again=False)
        shares = lasting(simulator, found.values, drives)
        if shares:
            again = fitted(simulator.starting(shares), again=True)
            if foretold(simulator, again.values, drives) < foretold(simulator, found.values, drives):
                simulator, found = simulator.starting(shares), again
        once = counted_once(found, drives)
        said = (*once.notes, *spoken(simulator, once.values, [*drives, *others]))
        return replace(once, notes=said, warnings=said_once(once.warnings))

    def judged(self, simulator: CarSimulator, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
        """See Family: without what the tracker mistook for the car."""
        return tuple(simulator.prepared(r) for r in recordings)

    def predictions(
        self, simulator: CarSimulator, against: CarSimulator | None, recordings: Sequence[Recording]
    ) -> tuple[tuple[Prediction, ...], tuple[str, ...]]:
        """See Family. Raises RecordingError for drives without pose or command, or too short."""
        each = {r.name: _predicted(simulator, against, r) for r in recordings}
        found = tuple(p for p in each.values() if p is not None)
        short = [name for name, p in each.items() if p is None]
        longest = f"{max(HORIZONS):g} s"
        said = f"no place where the car drives and is tracked for {longest} on end, after {longest} of past"
        if not found:
            raise RecordingError(f"{', '.join(short)}: {said}")
        notes = [f"left out, {said}: {', '.join(short)}"] if short else []
        taken = [w for r in recordings for w in simulator.prepared(r).provenance.get("warnings", "").split("\n") if w]
        return found, tuple(dict.fromkeys((*notes, *taken)))

    def write(
        self, simulator: CarSimulator, calibration: Calibration, model: Path, parameters: Path
    ) -> tuple[str, ...]:
        """Writes the car's file; there is nothing that it cannot say. Raises OutputError."""
        values = {e.name: e.value for e in calibration.estimates}
        notes = {
            e.name: f"{e.low:.4g} ... {e.high:.4g}, {e.verdict}" if e.fitted else e.verdict
            for e in calibration.estimates
        }
        write_car(replace(simulator.car, values=values), model, notes)
        return ()

    def kinds(self, simulator: CarSimulator) -> tuple[tuple[str, str, int], ...]:
        """See Family."""
        return tuple((p.name, "car", 1) for p in simulator.parameters.parameters if not p.frozen)


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


def _predicted(car: CarSimulator, other: CarSimulator | None, recording: Recording) -> Prediction | None:
    """None where the drive holds nothing that could be predicted."""
    clean, nothing = car.prepared(recording), np.zeros(0)
    errors = prediction_errors(car, nothing, clean, HORIZONS)
    if not len(errors):
        return None
    against = None if other is None else prediction_errors(other, nothing, other.prepared(recording), HORIZONS)
    return Prediction(recording.name, HORIZONS, errors, against, moved(car, clean, max(HORIZONS)))


def _with_parameters(car: Car, recordings: Sequence[Recording]) -> tuple[CarSimulator, tuple[str, ...]]:
    """The simulator, started from a first look at `recordings`, and notes."""
    car, taken = with_commands(car, recordings)
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
