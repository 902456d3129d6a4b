# SPDX-License-Identifier: Apache-2.0
"""Vehicles as a family: a file and drives into a simulator and back, judged by how far predictions go astray."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Estimate, Prediction
from trueup.engines.family import Family, Fit, Request
from trueup.engines.vehicle.commands import in_another_unit, rolling, with_commands
from trueup.engines.vehicle.judging import Ahead
from trueup.engines.vehicle.localisation import with_noise
from trueup.engines.vehicle.look import Look
from trueup.engines.vehicle.noisy_starts import astray, begun_with_noise, by_both, confirmed
from trueup.engines.vehicle.prediction import horizons_for, moved, prediction_errors, spoken
from trueup.engines.vehicle.quantities import LASTING
from trueup.engines.vehicle.remainder import errors_go_with
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.engines.vehicle.share import shared
from trueup.engines.vehicle.vehicle import HORIZONS, PURSUED, Vehicle
from trueup.engines.vehicle.vehicle_file import read_vehicle, write_vehicle
from trueup.errors import ParameterError, RecordingError
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.tracking.cleaned import heading_senses
from trueup.tracking.heading import told_by
from trueup.tracking.past import begun_at
from trueup.tracking.place import tells_place
from trueup.tracking.wheels import tells_way
from trueup.tracking.windows import noise_of
from trueup.trial import Trial

UNDERSTEER = "understeer"
"""Of cars in calm curves: it is small beside the play of a steering, and yet moves what a command of steering is worth."""

FRONT = (
    "speeds are commanded of the steered wheel, as of a tricycle: the unsteered axle is slower, by the cosine of the angle "
    "(driven = 'front'; say driven = 'rear' in the file if not)"
)


class Vehicles(Family):
    """Cars driven by throttle and steering, whose pose was tracked; a model is a TOML file (`read_vehicle`)."""

    suffix = ".toml"
    describes = "another car's TOML file"
    compares = "none of position (x, y), heading or a quaternion (qx, qy, qz, qw), speed and yaw_rate"

    def load(self, path: Path) -> tuple[Path, Vehicle]:
        """The file and the car in it. Raises ModelError."""
        return path, read_vehicle(path)

    def reads(self, recording: Recording) -> Collection[str]:
        """See Family: what the heading is taken from has that name where it was recorded, a place may be on earth."""
        place = {c.name for n, c in recording.channels.items() if n == "position" and tells_place(c)}
        return {"speed", "yaw_rate", *place, *tells_way(recording), *(channel.name for channel in told_by(recording))}

    def simulator(
        self,
        model: tuple[Path, Vehicle],
        training: Sequence[Recording],
        replayed: Sequence[Recording],
        request: Request,
    ) -> tuple[VehicleSimulator, tuple[str, ...]]:
        """See Family. With parameters, the search starts from a first look at `training`."""
        path, car = model
        for option, given in (("beyond-mjcf", request.beyond_mjcf), ("step", request.step is not None)):
            if given:
                raise ParameterError(f"--{option} is for MJCF and URDF models; a car is simulated at a step of its own")
        if request.parameters is not None:
            raise ParameterError(
                f"{request.parameters}: a car has no parameters file; its own values are in [vehicle.values]"
            )
        car = replace(car, headings=heading_senses([*training, *replayed]))
        if request.propose:
            return _with_parameters(car, training)
        car, notes = with_commands(car, [*training, *replayed])
        if not car.values:
            notes = (
                *notes, f"{path} holds no [vehicle.values]: it is judged as a usual small car; `trueup calibrate {path} "
                "DRIVES` finds its own",
            )  # fmt: skip
        return VehicleSimulator(car), notes

    def following(self, simulator: VehicleSimulator, recordings: Sequence[Recording]) -> VehicleSimulator:
        """See Family: in which sense headings grow, as these show it together, else as those before did."""
        car = simulator.vehicle
        return simulator.with_vehicle(replace(car, headings={**car.headings, **heading_senses(recordings)}))

    def calibrate(
        self, simulator: VehicleSimulator, training: Sequence[Recording], held_out: Sequence[Recording], fit: Fit
    ) -> Calibration:
        """Calibrated by how far predictions go astray, from each of `lasting` unless the file says these, and from a wheel
        that turns slowly where a look shows one; what predicts its own drives best stays.

        Raises what `fit` raises, and RecordingError for drives without pose or command.
        """
        drives, others = ([simulator.prepared(r) for r in rs] for rs in (training, held_out))
        part, seen, said = shared(simulator, drives)
        exact, noisy = _searched(part, seen, others if part is simulator else (), fit)
        found, other = sorted((noisy, exact), key=lambda c: astray(simulator, c.values, drives))
        if part is not simulator:
            found = confirmed(simulator, found, found is not exact, drives, others, fit)
        horizons = horizons_for(simulator, [*drives, *others], HORIZONS)
        shown = (
            spoken(simulator, found.values, rs, which, horizons) for which, rs in (("", drives), (" held out", others))
        )
        lacks, left = errors_go_with(simulator, found.values, [*drives, *others], max(horizons))
        valued = {e.name: e.value for e in found.estimates}
        notes = (
            *said,
            *found.notes,
            *(said for tell in (rolling, in_another_unit) for said in tell(simulator.vehicle, valued)),
            *(sentence for each in shown for sentence in each),
            *left,
        )
        estimates = slow_in_one_way(by_both(found.estimates, other.estimates, simulator.parameters))
        estimates = making_up(estimates) if lacks else estimates
        done = replace(found, estimates=estimates, notes=notes, warnings=(*said_once(found.warnings), *lacks))
        return with_noise(done, noise_of(drives), simulator.vehicle.values)

    def known_before(self, simulator: VehicleSimulator) -> bool:
        """See Family: a car that is told shares of an unknown most drives like none until it is calibrated."""
        return bool(simulator.vehicle.values) or simulator.vehicle.in_si

    def judged(self, simulator: VehicleSimulator, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
        """See Family: without what the tracker mistook for the car."""
        return tuple(simulator.prepared(r) for r in recordings)

    def predictions(
        self, simulator: VehicleSimulator, against: VehicleSimulator | None, recordings: Sequence[Recording]
    ) -> tuple[tuple[Prediction, ...], tuple[str, ...]]:
        """See Family. Raises RecordingError for drives without pose or command, or too short."""
        horizons = horizons_for(simulator, [simulator.prepared(r) for r in recordings], HORIZONS)
        each = {r.name: _predicted(simulator, against, r, horizons) for r in recordings}
        found = tuple(p for p in each.values() if p is not None)
        short = [name for name, p in each.items() if p is None]
        said = f"no place where the car drives and is tracked for {min(horizons):g} s on end"
        if not found:
            raise RecordingError(f"{', '.join(short)}: {said}")
        notes = [f"left out, {said}: {', '.join(short)}"] if short else []
        taken = [w for r in recordings for w in simulator.prepared(r).provenance.get("warnings", "").split("\n") if w]
        return found, tuple(dict.fromkeys((*notes, *taken)))

    def write(
        self, simulator: VehicleSimulator, calibration: Calibration, model: Path, parameters: Path
    ) -> tuple[str, ...]:
        """Writes the car's file; there is nothing that it cannot say. Raises OutputError."""
        values = {e.name: e.value for e in calibration.estimates}
        notes = {
            e.name: f"{e.low:.4g} ... {e.high:.4g}, {e.verdict}" if e.fitted else e.verdict
            for e in calibration.estimates
        }
        write_vehicle(replace(simulator.vehicle, values=values), model, notes)
        return ()

    def kinds(self, simulator: VehicleSimulator) -> tuple[tuple[str, str, int], ...]:
        """See Family."""
        return tuple((p.name, "car", 1) for p in simulator.parameters.parameters if not p.frozen)


def lasting(car: Vehicle) -> list[Mapping[str, float]]:
    """Values of `LASTING` from which a car is searched: as cars on a floor mostly are, and one that does what its model does,
    at the speed that this carries on. Where a drive holds nothing unexplained but the tracker's noise, dynamics that are
    searched with the first are bent to that, and to the lag of the last samples where the speed changes.
    """
    usual = {name: car.quantity(name).start for name in LASTING}
    return [usual, {**dict.fromkeys(LASTING, 0.0), "speed_kept": 1.0}]


def _searched(
    simulator: VehicleSimulator, drives: Sequence[Recording], others: Sequence[Recording], fit: Fit
) -> tuple[Calibration, Calibration]:
    """Calibrations by starts of predictions that are taken to be exact, and known but for their noise."""
    space, far = simulator.parameters, max(HORIZONS)
    if set(LASTING) <= set(space.names) and any(
        len(begun_at(simulator.past(Trial.of(d, simulator.observable(d))), far, 1.0)) for d in drives
    ):
        own, said = simulator.vehicle.values, set(LASTING) <= set(simulator.vehicle.values)
        begun: list[Mapping[str, float]] = [own] if said else lasting(simulator.vehicle)
        spaces = [space.freeze(LASTING, {n: at[n] for n in LASTING}) for at in begun]
        search = partial(fit, discrepancy=Ahead(simulator, drives), cross_validate=False)
        starts = [simulator.with_parameters(s) for s in spaces]
        every = [search(s, drives, others, again=k > 0) for k, s in enumerate(starts)]
        found = with_shares(simulator, every, drives, others, search, begun)
    else:
        found = fit(simulator, drives, others, discrepancy=Ahead(simulator, drives), cross_validate=False)
    return found, begun_with_noise(simulator, found, drives, others, fit)


def making_up(estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Estimates of a vehicle whose errors go with something that its simulator lacks: none is said to be its own.

    Their intervals are those of the values that predict best, whatever made the drives (H. White, Maximum likelihood
    estimation of misspecified models, Econometrica 50, 1982): what acts in each stretch alike shows in none left out.
    """
    note = "predicts best, but makes up for what the simulator lacks, too"
    return tuple(replace(e, verdict="effective", note=note) if e.verdict == "identified" else e for e in estimates)


def slow_in_one_way(estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Estimates of a car that pursues a speed, whose lag and gain are claimed together only.

    A speed that follows late is one of a slow command or of a soft controller. What tells them apart is the speed at the
    start of each prediction, and its noise is forgotten sooner by a stiff controller: unless that is eliminated, the fit
    prefers such a one whatever is true, and with it is as sure as the model is right.
    """
    slow = {e.name: e for e in estimates if e.name in ("speed_lag", "speed_gain") and e.fitted}
    if len(slow) < 2 or "identified" not in {e.verdict for e in slow.values()}:
        return tuple(estimates)
    late = slow["speed_lag"].value + 1.0 / slow["speed_gain"].value
    note = f"speed_lag and 1 / speed_gain stand for one another: together {late:.3g} s, which of the two is hardly told"
    return tuple(
        replace(e, verdict="effective", note=note) if e.name in slow and e.verdict == "identified" else e
        for e in estimates
    )


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


def _predicted(
    car: VehicleSimulator, other: VehicleSimulator | None, recording: Recording, horizons: tuple[float, ...]
) -> Prediction | None:
    """None where the drive holds nothing that could be predicted."""
    clean, nothing = car.prepared(recording), np.zeros(0)
    errors = prediction_errors(car, nothing, clean, horizons)
    if not len(errors):
        return None
    against = None if other is None else prediction_errors(other, nothing, other.prepared(recording), horizons)
    return Prediction(recording.name, horizons, errors, against, moved(car, clean, max(horizons)))


def _with_parameters(car: Vehicle, recordings: Sequence[Recording]) -> tuple[VehicleSimulator, tuple[str, ...]]:
    """The simulator, started from a first look at `recordings`, and notes."""
    car, taken = with_commands(car, recordings)
    plain = VehicleSimulator(car)
    drives = [plain.prepared(r) for r in recordings]
    look = Look.at(drives)
    if car.drive == PURSUED and car.in_si and not car.driven and look.driven_by_the_steered_wheel():
        car = replace(car, driven="front")
        plain = VehicleSimulator(car)
        drives = [plain.prepared(r) for r in recordings]
        look = Look.at(drives)
        taken = (*taken, FRONT)
    calm = {name: why for name, why in look.unseen().items() if name in car.names and car.quantity(name).free}
    steers = max((float(np.nanmax(np.abs(d.channel("command").column("steering")))) for d in drives), default=1.0)
    # Nobody evens out wheels that are told one by one; what is told as a share is a motor's voltage.
    own = () if car.wheels is None else ("veer", "wheel_dead") if car.told_shares else ("veer",)
    slips = [UNDERSTEER] if UNDERSTEER in calm and UNDERSTEER not in car.values else []
    free = [q.name for q in car.quantities if (q.free or q.name in own) and (q.name not in calm or q.name in slips)]
    space = _asked_about(car.space(free, look.starts(car), steers), slips)
    return VehicleSimulator(car, space), (*taken, *(why for name, why in calm.items() if name not in slips))


def _asked_about(space: ParameterSpace, names: Sequence[str]) -> ParameterSpace:
    """With parameters that are looked for where left-out drives are foretold better than with their usual values."""
    asked = (p.replace(optional=p.name, absent=p.nominal) if p.name in names else p for p in space.parameters)
    return ParameterSpace(tuple(asked))


def _only(names: Sequence[str], space: ParameterSpace, values: Array) -> ParameterSpace:
    """The space in which only `names` are free, around `values` (n,)."""
    kept = space.freeze([n for n in space.names if n not in names], dict(zip(space.names, values, strict=True)))
    return ParameterSpace(tuple(p.replace(frozen=p.name not in names) for p in kept.parameters))


def with_shares(
    simulator: VehicleSimulator, every: Sequence[Calibration], drives: Sequence[Recording], others: Sequence[Recording],
    search: Fit, begun: Sequence[Mapping[str, float]],
) -> Calibration:  # fmt: skip
    """Of a car's calibrations with its `LASTING` held the one that predicts its drives best, or a further one with those held
    that predict best of all: what they are where any search has `begun`, or where a search of them alone ends.
    """
    space, tried = simulator.parameters, []
    kept = np.isin(space.names, LASTING)
    for values in (c.values for c in every):
        alone = search(simulator.with_parameters(_only(LASTING, space, values)), drives, others, again=True).values
        tried += [values, alone, *(np.where(kept, [b.get(n, 0.0) for n in space.names], values) for b in begun)]
    best = min(tried, key=lambda v: astray(simulator, v, drives))
    more = []
    if not any(np.array_equal(best, c.values) for c in every):
        told = dict(zip(space.names, best.tolist(), strict=True))
        more = [search(simulator.with_parameters(space.freeze(LASTING, told)), drives, others, again=True)]
    return min((*every, *more), key=lambda c: astray(simulator, c.values, drives))
