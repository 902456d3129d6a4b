# SPDX-License-Identifier: Apache-2.0
"""Arms, hands and legs as a family: MJCF and URDF files, simulated by MuJoCo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.articulated.declaration_file import read_declarations, read_gains
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.gains import Gains
from trueup.articulated.inertial import with_inertial_units
from trueup.articulated.model import servos
from trueup.articulated.pose import ORIENTATION, POSITION
from trueup.calibration import Calibration
from trueup.engines.family import Family, Note, Request, Suited
from trueup.engines.mujoco.attributes import is_position_servo
from trueup.engines.mujoco.base import check_base, floating, free_joint, held
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.commanded_units import with_commands_told
from trueup.engines.mujoco.setup.drives import (
    by_the_only_joint,
    check_joints,
    driven,
    parted_at_pauses,
    suited,
    torques_as_commands,
    uncommanded,
    undriven,
)
from trueup.engines.mujoco.setup.efforts import with_efforts
from trueup.engines.mujoco.setup.floor import reach_of
from trueup.engines.mujoco.setup.footing import on_the_floor, without_lifts
from trueup.engines.mujoco.setup.footsteps import legs_of, reckoned
from trueup.engines.mujoco.setup.gravity import compensated
from trueup.engines.mujoco.setup.mounting import mounted_otherwise
from trueup.engines.mujoco.setup.overlaps import passable
from trueup.engines.mujoco.setup.proposal import moving_joints, propose
from trueup.engines.mujoco.setup.reached import unstopped
from trueup.engines.mujoco.setup.scales import of_slides, ways, with_units
from trueup.engines.mujoco.setup.senses import turned_otherwise
from trueup.engines.mujoco.setup.states import with_states_parted
from trueup.engines.mujoco.setup.still import with_still_joints
from trueup.engines.mujoco.setup.tendons import of_several_joints, with_joints_told
from trueup.engines.mujoco.setup.torques_given import torques_given
from trueup.engines.mujoco.setup.whole_body import as_wrong_as_may_be, whole_body_lines
from trueup.engines.mujoco.wiring import is_speed_servo
from trueup.engines.mujoco.writing.notes import about_load, about_masses, about_sensors, about_step, usage_of
from trueup.engines.mujoco.writing.parameter_files import write_parameter_files
from trueup.engines.mujoco.writing.write import write_model
from trueup.engines.simulator import Simulator
from trueup.inspection.alignment import stamped_late
from trueup.inspection.diagnosis import Diagnosis, all_edited, edited
from trueup.inspection.feedforward import with_feedforward
from trueup.inspection.floor import stopped_by_floor
from trueup.inspection.joint_names import named_as
from trueup.inspection.ranges import beyond_ranges, check_slid
from trueup.inspection.released import without_released
from trueup.inspection.scattered import gathered
from trueup.inspection.sensors import in_other_units, with_sensors
from trueup.inspection.settings import GAINS, at_other_voltages, with_steady_gains
from trueup.inspection.sliding import sliding
from trueup.inspection.spikes import without_lone_spikes
from trueup.inspection.stops import stopped_at
from trueup.inspection.strangers import without_strangers
from trueup.inspection.turns import without_wraps
from trueup.inspection.unfit import no_lengths
from trueup.inspection.unfollowed import beside_commands
from trueup.inspection.zeros import zeros_off
from trueup.recording import Recording
from trueup.trial import ENABLED

_CHANGES = (
    ("base", floating), ("base", held), ("servos", driven), ("gravity", compensated), ("overlaps", passable),
    ("ranges", unstopped), ("still", with_still_joints),
)  # fmt: skip
DIAGNOSES = (
    "tendons", "names", "strangers", "spikes", "commands", "torques", "sensors", "turns", "gains", "feedforward", "heights",
    "feet", "pauses", "released", "lifts", *dict.fromkeys(name for name, _ in _CHANGES), "floor", "stops", "zero", "clock",
    "disturbed",
)  # fmt: skip
"""What is looked for in recordings and models, and may be refused."""


class Articulated(Family):
    """Robots of joints and links; a model is an MJCF or URDF file."""

    describes = "another MJCF or URDF file"
    compares = "no joint and no sensor of the model by its name, labels and unit"
    diagnoses = DIAGNOSES

    def load(self, path: Path) -> Model:
        """The model in a file. Raises ModelError."""
        return load(path)

    def drives(self, model: Model) -> Mapping[str, str]:
        """See Family."""
        return model.counted()

    def others(self, model: Model) -> tuple[str, ...]:
        """See Family."""
        return of_several_joints(model)

    def sensors(self, model: Model) -> Mapping[str, str]:
        """See Family."""
        return model.sensors()

    def in_units(self, model: Model, recordings: Sequence[Recording], *, guessed: bool = False) -> Sequence[Recording]:
        """See Family: metres where a joint slides."""
        named, _ = named_as(with_joints_told(model, recordings)[0], model.counted(), self.others(model))
        named, _ = by_the_only_joint(with_inertial_units(named)[0] if guessed else named, model.scalar_joints())
        return named if no_lengths(ways(model), named) else of_slides(model, with_units(model, named)[0])[0]

    def reads(self, recording: Recording) -> Collection[str]:
        """See Family: settings of servos, and whether they were on."""
        return {ENABLED, *(word for words in GAINS.values() for word in words)}

    def doubts(self, model: Model, recordings: Sequence[Recording]) -> tuple[str, ...]:
        """See Family: positions beyond what the model allows or far beside commands, what turns the other way, units."""
        if unsaid := no_lengths(ways(model), recordings):
            return (unsaid,)
        recordings, told = with_inertial_units(recordings)
        units = (*told, *in_other_units(model.sensors(), recordings))
        beyond = beyond_ranges(ways(model), recordings, in_degrees=model.is_mjcf)
        turned = (*sliding(legs_of(model), recordings), *turned_otherwise(model, recordings))
        return (*beyond, *units, *mounted_otherwise(model, recordings), *turned, *beside_commands(recordings),
                *at_other_voltages(recordings))  # fmt: skip

    def suited(
        self, model: Model, training: Sequence[Recording], held_out: Sequence[Recording] = (), refuse: Collection[str] = ()
    ) -> Suited:  # fmt: skip
        """See Family: joints by the model's names, commands that its drives take."""
        drives, others = model.counted(), self.others(model)
        known = {*drives, *drives.values(), *others}
        as_named = (
            ("names", lambda r: with_states_parted(model, r)), ("names", lambda r: gathered(r, known)),
            ("spikes", without_lone_spikes), ("tendons", lambda r: with_joints_told(model, r)),
            ("names", lambda r: named_as(r, drives, others)), ("strangers", lambda r: without_strangers(r, drives, others)),
            ("gains", with_steady_gains), ("feedforward", with_feedforward),
        )  # fmt: skip
        named, renamed = all_edited([*training, *held_out], as_named, refuse)
        taken, changed = suited(model, named)
        as_the_model_takes_them = (
            ("commands", lambda rs: with_commands_told(model, rs, refuse)),
            ("torques", lambda rs: torques_as_commands(model, rs)), ("torques", lambda rs: with_efforts(model, rs)),
            ("sensors", lambda rs: with_sensors(model.sensors(), rs)),
            ("turns", lambda rs: without_wraps(ways(model), drives, rs)), ("heights", lambda rs: on_the_floor(model, rs)),
            ("feet", lambda rs: reckoned(model, rs)),
        )  # fmt: skip
        taken, edits = all_edited(taken, as_the_model_takes_them, refuse)
        if "ranges" not in refuse:
            check_slid(ways(model), taken)
        fitted, pauses = _in_parts(model, taken[: len(training)], refuse)
        judged, others_pauses = _in_parts(model, taken[len(training) :], refuse)
        notes = (*renamed, *changed, *edits, *self.doubts(model, taken), *pauses, *others_pauses)
        return Suited(tuple(fitted), tuple(judged), notes)

    def simulator(
        self, model: Model, training: Sequence[Recording], replayed: Sequence[Recording], request: Request
    ) -> tuple[Any, tuple[Note, ...]]:
        """See Family. A model without actuators gets servos or motors for the joints that the recordings command."""
        everything = (*training, *replayed)
        check_joints(model, everything)
        loaded, found, given, drives, guessed = model.notes, [], model, None, False
        for name, change in _CHANGES:
            changed = change(model, everything)
            if changed is not model:
                found.append(Diagnosis(name, changed.notes[-1]).unless(request.refuse))
                if found[-1].refused:
                    continue
                guessed |= change is driven and not _servos(changed) <= _servos(model)
                model = changed
                if change is driven and given.is_mjcf:
                    drives = change(given, everything)
                elif not given.is_mjcf and change in (floating, driven, passable):
                    given = changed  # what becomes an MJCF has them
        model = replace(model, given=given, driven=drives, guessed=guessed)
        silent = undriven(model, everything, refused="torques" in request.refuse) + uncommanded(model, everything)
        notes: tuple[Note, ...] = (*loaded, *found, *silent, *check_base(model, everything))
        lines, proposed = _lines(model, training, request)
        declared = request.parameters is not None
        names = {"recording": tuple(r.name for r in everything),
                 "channel": tuple(dict.fromkeys(c for r in everything for c in r.channels))}  # fmt: skip
        known = {**model.settings(), **read_gains(request.parameters)}
        gains, named = Gains.named_by(everything, known, {} if model.guessed else _stiffness(model))
        step = request.step or model.own_step
        simulator, more = self.engine_simulator(model, lines, names, gains, step, declared=declared)
        return simulator, (*notes, *proposed, *named, *more)

    def engine_simulator(
        self, model: Model, lines: Sequence[Declaration], names: Mapping[str, Sequence[str]], gains: Gains, step: float,
        *, declared: bool,
    ) -> tuple[Any, tuple[Note, ...]]:  # fmt: skip
        """The engine's simulator of a model with these lines, `declared` by a file or proposed, and notes."""
        space, quantities = declare(model, lines, names)
        return MujocoSimulator(model, space, quantities, gains=gains, step=step), ()

    def following(self, simulator: Any, recordings: Sequence[Recording]) -> Any:
        """See Family: the settings of servos that they name."""
        if not isinstance(simulator, MujocoSimulator):
            return simulator
        return simulator.with_gains(Gains.named_by(recordings, simulator.gains.given_for)[0])

    def torques(self, simulator: Any, recordings: Sequence[Recording]) -> tuple[Any, Sequence[Recording]]:
        """See Family: what motors give when they are commanded."""
        return torques_given(self.file_of(simulator), recordings)

    def for_whole_runs(self, simulator: Any) -> Simulator:
        """See Family."""
        model = self.file_of(simulator)
        if free_joint(model.compiled) < 0:
            return simulator
        lines, names = whole_body_lines(model), {"channel": (POSITION, ORIENTATION)}
        other, _ = self.engine_simulator(model, lines, names, simulator.gains, simulator.step, declared=False)
        return other.with_parameters(as_wrong_as_may_be(model, other.parameters, other.quantities))

    def file_of(self, simulator: Any) -> Model:
        """The model that a simulator was made of, as MuJoCo reads it."""
        return simulator.model

    def write(self, simulator: Any, calibration: Calibration, model: Path, parameters: Path) -> tuple[str, ...]:
        """Writes the calibrated MJCF and the parameters files; notes on what the MJCF cannot say."""
        told = write_parameter_files(simulator, calibration, parameters)
        return (*told, *write_model(simulator, calibration.values, model))

    def known_before(self, simulator: MujocoSimulator) -> bool:
        """See Family."""
        return not simulator.model.guessed

    def usage(self, simulator: MujocoSimulator, calibration: Calibration, model: Path) -> tuple[str, ...]:
        """See Family."""
        return usage_of(simulator, calibration.values, model)

    def kinds(self, simulator: MujocoSimulator) -> tuple[tuple[str, str, int], ...]:
        """See Family."""
        free = [a for a, p in zip(simulator.quantities, simulator.parameters.parameters, strict=True) if not p.frozen]
        counts = Counter((a.kind, a.quantity.family) for a in free)
        return tuple((name, family, count) for (name, family), count in counts.items())

    def advice(self, simulator: MujocoSimulator, calibration: Calibration | None = None) -> tuple[str, ...]:
        """See Family: another step than the model's before a calibration, friction with load after it."""
        if calibration is None:
            return about_step(simulator)
        return tuple(n for about in (about_sensors, about_load, about_masses) for n in about(simulator, calibration))


def _stiffness(model: Model) -> dict[str, float]:
    """The gains of a file's servos, as `Gains.given_for` names them."""
    driven = {actuator: joint for joint, actuator in model.drives().items()}
    shipped = {(q, servo): model.get(f"actuator.{q}", servo)[0] for servo in servos(model) for q in GAINS}
    return {f"{q}.{driven.get(servo, servo)}": float(value) for (q, servo), value in shipped.items()}


def _servos(model: Model) -> set[tuple[int, str]]:
    m, kinds = model.compiled, {"position": is_position_servo, "speed": is_speed_servo}
    return {(i, kind) for i in range(m.nactuator) for kind, is_one in kinds.items() if is_one(m, i)}


def _lines(model: Model, training: Sequence[Recording], request: Request) -> tuple[list[Declaration], list[Diagnosis]]:
    """What is calibrated: as a file declares it, or as recordings propose it, with what they show for it."""
    if request.parameters is not None:
        return read_declarations(request.parameters), []
    if not request.propose:
        return [], []
    # A base that is free in the file may have stood on the robot's feet: what stopped these is no table.
    stands = model.given is not None and free_joint(model.given.compiled) >= 0
    reach, refuse = None if stands else reach_of(model), request.refuse
    seen = (None if reach is None else stopped_by_floor(reach, training),
            zeros_off(training, moving_joints(model, training)))  # fmt: skip
    found = {d.name: d.unless(refuse) for d in (*seen, stamped_late(request.clocks)) if d is not None}
    height = found["floor"].numbers["height"] if "floor" in found and not found["floor"].refused else None
    ranges = {joint: way.range or (-np.inf, np.inf) for joint, way in ways(model).items()}
    # Nor are they hard stops: legs of a robot that stands are stopped by what it weighs, and by one another.
    if free_joint(model.compiled) < 0 and "floor" not in found and (stops := stopped_at(training, ranges)) is not None:
        found["stops"] = stops.unless(refuse)
    stopped = {} if "stops" not in found or found["stops"].refused else found["stops"].numbers
    lines = propose(model, training, {} if "clock" in refuse else request.clocks, height, request.beyond_mjcf, stopped)
    return [line for line in lines if line.quantity != "zero" or "zero" not in refuse], list(found.values())


def _in_parts(
    model: Model, recordings: Sequence[Recording], refuse: Collection[str]
) -> tuple[list[Recording], list[Diagnosis]]:
    """Recordings without what cannot be replayed: where nothing was logged, the drives had let go, the robot was held up."""
    parts, pauses = edited(recordings, "pauses", refuse, parted_at_pauses)
    parts, released = edited(parts, "released", refuse, without_released)
    parts, lifts = edited(parts, "lifts", refuse, lambda rs: without_lifts(model, rs))
    return parts, [*pauses, *released, *lifts]
