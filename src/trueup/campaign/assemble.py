# SPDX-License-Identifier: Apache-2.0
"""Turns names into concrete things: a model file and recordings into a simulator, a calibration into its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trueup.calibration import Calibration, Replay, by_unit
from trueup.engines.simulator import Simulator
from trueup.errors import ParameterError, unknown_name
from trueup.recording import Recording

if TYPE_CHECKING:
    from trueup.campaign.cars import Told
    from trueup.engines.car import CarSimulator
    from trueup.engines.mujoco.clearance import MujocoClearance
    from trueup.engines.mujoco.model import Model
    from trueup.engines.mujoco.rollout import MujocoSimulator
    from trueup.engines.mujoco.setup.floor import Stopped
    from trueup.loop.calibrate import Options
    from trueup.loop.fit import Checkpoint, Progress


_UNEXPLAINED = 5.0  # noise units

STEP = 0.002
"""s: the step of MuJoCo models unless told otherwise."""


def simulator_for(
    model_path: str | Path,
    recordings: Sequence[Recording],
    parameters_file: str | Path | None = None,
    *,
    replayed: Sequence[Recording] = (),
    beyond_mjcf: bool = False,
    step: float | None = None,
) -> tuple[MujocoSimulator | CarSimulator, tuple[str, ...]]:
    """The simulator of a model file with parameters from a file, or proposed from what moves in `recordings`.

    `replayed` are recordings that will be replayed too, but propose nothing: only their clocks are looked at.
    `beyond_mjcf` proposes friction that MJCF has no place for too. `step` in s (None: `STEP`).
    A TOML file is a car (see `read_car`), whose search starts from a first look at `recordings`. A model without
    actuators gets position servos or motors for the joints that the recordings command; the notes say so, and what was
    lost on loading. Raises ModelError, ParameterError and UnknownNameError.
    """
    if Path(model_path).suffix.lower() == ".toml":
        from trueup.campaign.cars import car_for

        _check_of_cars(beyond_mjcf, step)
        return car_for(Path(model_path), recordings, parameters_file)
    from trueup.discrepancies.alignment import clock_errors
    from trueup.engines.mujoco.base import check_base
    from trueup.engines.mujoco.declaration_file import read_declarations, read_gains
    from trueup.engines.mujoco.declarations import declare
    from trueup.engines.mujoco.gains import Gains
    from trueup.engines.mujoco.rollout import MujocoSimulator
    from trueup.engines.mujoco.setup.drives import undriven
    from trueup.engines.mujoco.setup.floor import stopped_by_floor
    from trueup.engines.mujoco.setup.proposal import propose

    everything = (*recordings, *replayed)
    model = _model_for(model_path, everything)
    notes = (*model.notes, *undriven(model, everything), *check_base(model, everything))
    if parameters_file is not None:
        lines = read_declarations(parameters_file)
    else:
        floor = stopped_by_floor(model, recordings)
        lines = propose(model, recordings, clock_errors(everything), floor.height if floor else None, beyond_mjcf)
        notes = (*notes, *([_of_floor(floor)] if floor else []))
    names = {
        "recording": tuple(r.name for r in everything),
        "channel": tuple(dict.fromkeys(c for r in everything for c in r.channels)),
    }
    space, quantities = declare(model, lines, names)
    gains, named = Gains.named_by(everything, model.compiled, read_gains(parameters_file))
    return MujocoSimulator(model, space, quantities, gains=gains, step=step or STEP), (*notes, *named)


def _check_of_cars(beyond_mjcf: bool, step: float | None) -> None:
    for option in (*(["beyond-mjcf"] if beyond_mjcf else []), *(["step"] if step is not None else [])):
        raise ParameterError(f"--{option} is for MJCF and URDF models; a car is simulated at a step of its own")


def _model_for(path: str | Path, recordings: Sequence[Recording]) -> Model:
    """The model of a file as the recordings need it: its base free or held, drives, no contacts within, idle joints held."""
    from trueup.engines.mujoco.base import floating, held
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.setup.drives import driven
    from trueup.engines.mujoco.setup.overlaps import passable
    from trueup.engines.mujoco.setup.still import with_still_joints

    model = load(path)
    _check_joints(model, recordings)
    for change in (floating, held, driven, passable, with_still_joints):
        model = change(model, recordings)
    return model


def as_recorded(replays: Sequence[Replay], recordings: Sequence[Recording]) -> tuple[Replay, ...]:
    """Replays of the recordings as they were: one unit each, windows of a free base put together again."""
    from trueup.engines.mujoco.setup.windows import joined

    return joined(by_unit(replays, recordings))


def shipped_for(
    model_path: str | Path, recordings: Sequence[Recording], step: float | None = None
) -> tuple[Simulator, tuple[str, ...]]:
    """The simulator of a model file as it is, and notes on what was done to it. Raises what `simulator_for` raises."""
    from trueup.engines.mujoco.rollout import MujocoSimulator

    simulator, _ = simulator_for(model_path, recordings, step=step)
    return simulator.shipped(), simulator.model.notes if isinstance(simulator, MujocoSimulator) else ()


def calibrated(
    simulator: Simulator, training: Sequence[Recording], held_out: Sequence[Recording], options: Options, *,
    progress: Progress | None = None, checkpoint: Checkpoint | None = None, resume: dict[str, Any] | None = None,
) -> Calibration:  # fmt: skip
    """Calibrates a simulator in the way that suits it: a car's drives are cleaned, cut and judged ahead of
    time; friction that grows with the load is tried from the fit without it.

    Raises what `trueup.loop.calibrate` raises, and RecordingError for drives without pose or command.
    """
    from trueup.engines.car import CarSimulator
    from trueup.engines.mujoco.setup.proposal import LOAD
    from trueup.engines.mujoco.setup.windows import folded
    from trueup.loop.stepwise import calibrate_stepwise

    told: Told = {"progress": progress, "checkpoint": checkpoint, "resume": resume}
    if not isinstance(simulator, CarSimulator):
        done = calibrate_stepwise(simulator, training, held_out, LOAD, options, **told)
        every = [*training, *held_out]
        return replace(done, replays=as_recorded(done.replays, every), warnings=tuple(folded(done.warnings, every)))
    from trueup.campaign.cars import calibrated_car

    return calibrated_car(simulator, training, held_out, options, told)


def write_outcome(
    simulator: MujocoSimulator | CarSimulator, calibration: Calibration, model: Path, parameters: Path
) -> tuple[str, ...]:
    """Writes the calibrated MJCF and the parameters file; returns notes on what the MJCF cannot say.

    Raises OutputError and ModelError; older files are untouched then.
    """
    from trueup.engines.car import CarSimulator

    if isinstance(simulator, CarSimulator):
        from trueup.campaign.cars import write_calibrated_car

        return write_calibrated_car(simulator, calibration, model)
    from trueup.engines.mujoco.declaration_file import write_parameters
    from trueup.engines.mujoco.writing.write import write_model

    write_parameters(calibration, simulator.parameters, simulator.quantities, parameters, simulator.gains.given_for)
    return write_model(simulator, calibration.values, model)


def kinds_of(simulator: MujocoSimulator | CarSimulator) -> tuple[tuple[str, str, int], ...]:
    """(kind, family, number of elements) of the free parameters, in order: what a summary says of them."""
    from trueup.engines.car import CarSimulator

    if isinstance(simulator, CarSimulator):
        return tuple((p.name, "car", 1) for p in simulator.parameters.parameters if not p.frozen)
    from trueup.engines.mujoco.quantities import kind

    counts: dict[str, int] = {}
    for parameter, quantity in zip(simulator.parameters.parameters, simulator.quantities, strict=True):
        if not parameter.frozen:
            counts[quantity.kind] = counts.get(quantity.kind, 0) + 1
    return tuple((name, kind(name).family, count) for name, count in counts.items())


def about_step(simulator: Simulator) -> tuple[str, ...]:
    """A note where the model takes smaller steps than it is simulated at."""
    from trueup.engines.mujoco.rollout import MujocoSimulator

    own = float(simulator.model.compiled.opt.timestep) if isinstance(simulator, MujocoSimulator) else simulator.step
    if own > 0.99 * simulator.step:
        return ()
    return (
        f"the model steps by {1e3 * own:g} ms, here it is simulated at {1e3 * simulator.step:g} ms; with --step {own:g} the "
        f"values are those of its own step, for about {simulator.step / own:.1f} times the time",
    )


def about_load(simulator: Simulator, calibration: Calibration) -> tuple[str, ...]:
    """A note where servos stay far above the noise, and friction that grows with their load has not been tried."""
    from trueup.engines.mujoco.rollout import MujocoSimulator

    if not isinstance(simulator, MujocoSimulator):
        return ()
    kinds = {q.kind for q in simulator.quantities}
    seen = [r for r in calibration.training() if r.channel == "position"]
    if "kp" not in kinds or "friction_load" in kinds or not seen or not all(r.noise.all() for r in seen):
        return ()
    times = float(np.sqrt(np.nanmean([np.nanmean(((r.after - r.measured) / r.noise) ** 2) for r in seen])))
    if not times > _UNEXPLAINED:
        return ()
    return (
        f"the replay error stays at {times:.0f} times the noise. Small geared servos may have friction that grows with their "
        "load: --beyond-mjcf tries that too (in four times the time), and `trueup replay --parameters` replays it",
    )


def clearance_for(model_path: str | Path, joints: Sequence[str], floor: float | str | None = "auto") -> MujocoClearance:
    """What tells how far the parts of a model are from each other at postures of these joints. Raises ModelError."""
    from trueup.engines.mujoco.clearance import MujocoClearance
    from trueup.engines.mujoco.model import load

    return MujocoClearance.of(load(model_path), joints, floor=floor)


def recordings_for(
    model_path: str | Path, training: Sequence[Recording], held_out: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording], list[str]]:
    """Both as the model of a file can take them, and notes: joints by its names, commands that its drives take, a free
    base in windows (see `named_as`, `drives.suited`, `windows.begun_again`). Raises ModelError.
    """
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.setup.drives import suited
    from trueup.engines.mujoco.setup.windows import begun_again
    from trueup.formats.joint_names import named_as
    from trueup.formats.strangers import without_strangers

    model = load(model_path)
    drives = model.drives()
    others = [name for name in model.names("actuator") if name and name not in drives.values()]
    named, renamed = named_as([*training, *held_out], drives, others)
    named, strange = without_strangers(named, drives, others)
    taken, changed = suited(model, named)
    fitted, cut = begun_again(model, taken[: len(training)])
    judged, _ = begun_again(model, taken[len(training) :])
    return fitted, judged, [*renamed, *strange, *changed, *cut]


def in_units_of(model_path: str | Path, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with a model's names and units: metres where a joint slides. Raises ModelError."""
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.setup.scales import of_slides, with_units
    from trueup.formats.joint_names import named_as

    model = load(model_path)
    named, _ = named_as(recordings, model.drives())
    return of_slides(model, with_units(model, named)[0])[0]


def joints_of(model_path: str | Path) -> tuple[str, ...]:
    """Names of a model's hinge and slide joints. Raises ModelError."""
    from trueup.engines.mujoco.model import load

    return load(model_path).scalar_joints()


def drives_of(model_path: str | Path) -> dict[str, str]:
    """A model's joints and what drives them (see `Model.drives`). Raises ModelError."""
    from trueup.engines.mujoco.model import load

    return load(model_path).drives()


def _of_floor(floor: Stopped) -> str:
    return (
        f"the robot was stopped above where its commands would take it, about {100 * floor.height:.1f} cm high "
        f"({', '.join(floor.recordings)}), and the model has no floor: one is added and its height calibrated (quantities "
        "floor_height, floor_roll, floor_pitch, floor_friction)"
    )


def _check_joints(model: Model, recordings: Sequence[Recording]) -> None:
    """Raises UnknownNameError for a joint that the model does not have, and says how to rename it."""
    from trueup.formats.strangers import several_robots

    joints, file = model.scalar_joints(), model.path.name
    for recording in recordings:
        if recording.has("position"):
            labels = recording.channel("position").labels
            left = [j for j in joints if j not in labels]
            for label in labels:
                if label not in joints:
                    raise unknown_name(
                        "joint", label, left or joints,
                        f"model '{file}' (recording '{recording.name}', channel 'position'; rename it in the mapping's "
                        f"[joints]: `trueup inspect RECORDINGS --model {file}` proposes{several_robots(labels, joints)})",
                    )  # fmt: skip
