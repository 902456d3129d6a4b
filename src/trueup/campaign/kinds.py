# SPDX-License-Identifier: Apache-2.0
"""The short names that a plan may use, and the functions that make what is behind them out of a plan's options.

Concrete classes are imported inside functions only, so that a plan loads nothing that it does not use.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.calibration import Calibration, TracePoint
from trueup.engines.simulator import Simulator
from trueup.errors import PlanError, RecordingError, unknown_name
from trueup.recording import Recording
from trueup.tracking.windows import LENGTH

if TYPE_CHECKING:
    from trueup.engines.vehicle import BicycleSimulator
    from trueup.loop.prepare import Preparation
    from trueup.robots.stand_in_vehicle import StandInVehicle
    from trueup.tasks.follow_path import FollowPath

Suited = Callable[[Sequence[Recording]], Sequence[Recording]]
"""Makes recordings what a simulator can replay."""

ROBOTS = {
    "by-hand": "trueup.robots.by_hand:ByHand",
    "rcss": "trueup.robots.rcss:RcssRobot",
    "stand-in-arm": "trueup.robots.stand_in:StandInArm",
    "stand-in-vehicle": "trueup.campaign.kinds:stand_in_vehicle",
}
SIMULATORS = {
    "mujoco": "trueup.campaign.kinds:mujoco",
    "dart": "trueup.campaign.kinds:dart",
    "bicycle": "trueup.campaign.kinds:bicycle",
    "vehicle": "trueup.campaign.cars:simulator_of",
}
TASKS = {
    "follow-path": "trueup.campaign.kinds:follow_path",
    "transition": "trueup.campaign.motions:task_of",
    "walk": "trueup.campaign.walks:task_of",
}
SEARCHES = {
    "cma-es": "trueup.search.cma_es:CmaEs",
    "optuna": "trueup.search.optuna:OptunaSearch",
    "genetic": "trueup.search.genetic:Genetic",
}
DISCREPANCIES = {
    "weighted": "trueup.campaign.kinds:weighted",
    "plain": "trueup.discrepancies.plain:Plain",
    "path-shape": "trueup.discrepancies.path_shape:PathShape",
}
CALIBRATIONS = {"fit": "", "whole-runs": "", "none": "", "drives": "trueup.campaign.kinds:drives"}

DRIVES = (
    "speed_delay", "speed_lag", "acceleration_limit", "wheel_scale", "steering_delay", "steering_lag",
    "steering_rate_limit", "steering_scale", "steering_offset", "steering_slack", "understeer", "localisation_latency",
    "rear_slip", "relaxation",
)  # fmt: skip
"""What a recorded drive tells when it is compared instant by instant."""


def robot(
    engine: str, model: Path, say: Callable[[str], None], recordings: Sequence[Recording] = (),
    parameters: Path | None = None, refuse: tuple[str, ...] = (), whole_runs: bool = False,
    as_it_is: bool = False,
) -> Preparation:  # fmt: skip
    """A robot model with the parameters of a file, or those proposed for the plan's recordings; says what was done to both.
    Without either they are proposed once the first experiment is recorded, or at once what `whole_runs` tell, if these are to
    be fitted; where nothing is (`as_it_is`) there are none. `refuse` names what shall stay as it is though the recordings
    show it to be wrong or missing.

    Raises PlanError where there is no model, ModelError, ParameterError, and MissingExtraError for DART without dartpy.
    """
    from trueup.loop.prepare import prepare

    if not model.is_file():
        raise PlanError(f"[simulator], model: there is no file '{model}'; name your robot's MJCF or URDF")
    if model.suffix.lower() == ".toml":
        raise PlanError(f"[simulator], model: '{model}' is the file of a vehicle, which type = \"vehicle\" simulates")

    def with_notes_shown(ready: Preparation) -> Preparation:
        for note in ready.notes:
            say(f"note: {note}")
        return ready

    if parameters is None and whole_runs:
        return with_notes_shown(
            prepare(model, recordings, propose=False, refuse=refuse, engine=engine).for_whole_runs()
        )
    if parameters is None and not recordings and as_it_is:
        return with_notes_shown(prepare(model, (), propose=False, refuse=refuse, engine=engine))
    if parameters is None and not recordings:
        say(
            "what is to be calibrated is proposed after the first experiment; a parameters file in [simulator] says it now"
        )
        plain = with_notes_shown(prepare(model, (), propose=False, refuse=refuse, engine=engine))
        return replace(plain, later=lambda seen: with_notes_shown(prepare(model, seen, refuse=refuse, engine=engine)))
    return with_notes_shown(prepare(model, recordings, parameters=parameters, refuse=refuse, engine=engine))


mujoco, dart = partial(robot, "mujoco"), partial(robot, "dart")
"""The same robot model, simulated by one engine or by the other."""


def bicycle(
    wheelbase: float, max_steering: float = 0.6, parameters: tuple[str, ...] = DRIVES, step: float = 0.02, seed: int = 0,
    name: str = "vehicle", values: Mapping[str, float] | None = None,
) -> BicycleSimulator:  # fmt: skip
    """A vehicle that steers its front axle: `wheelbase` in m, `max_steering` in rad; `values` of what is known of it.

    The noise of its localisation is taken from its drives (method 'drives') where `values` do not say it.
    Raises ParameterError, and UnknownNameError for a parameter that a vehicle does not have.
    """
    from trueup.engines.vehicle import BicycleSimulator, Vehicle, vehicle_space
    from trueup.engines.vehicle.quantities import NOISES

    vehicle = Vehicle(name, wheelbase, max_steering, dict(values or {}))
    measured = [n for n in NOISES if n not in parameters and n not in vehicle.values]
    space = vehicle_space(vehicle, (*parameters, *measured)).freeze(measured)
    return BicycleSimulator(vehicle, space, step=step, seed=seed)


def follow_path(
    paths: tuple[str, ...], simulator: Simulator, folder_of_plan: Path, say: Callable[[str], None],
    gains: tuple[str, ...] = ("k1", "k2", "k3", "lead"), nominal: Mapping[str, float] | None = None,
    measure: str = "rms", point: str = "front", rate: float = 20.0,
    max_speed: float = 1.0, edges: tuple[float, float] = (0.5, 0.8), period: float = 0.02, speed: float | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> FollowPath:  # fmt: skip
    """Follow paths, each a course by name or a CSV file of waypoints beside the plan, with the Stanley controller.

    A path that is too tight is told of by `say`. `gains` are tuned from their `nominal` values within `ranges`; `speed` in
    m/s where a file has none. Raises PlanError for a simulator that is no vehicle, UnknownNameError, ParameterError,
    FormatError.
    """
    from trueup.campaign.cars import follower
    from trueup.controllers.stanley import StanleySettings
    from trueup.tasks.follow_path import FollowPath, too_tight

    vehicle = follower(simulator)
    settings = StanleySettings(
        wheelbase=vehicle.wheelbase, max_steering=vehicle.max_steering, max_speed=max_speed, edges=edges, period=period
    )
    found = [_path(p, folder_of_plan, speed) for p in paths]
    for words in filter(None, (too_tight(p, settings) for p in found)):
        say(f"note: {words}")
    return FollowPath(
        found, settings, names=gains, nominal=dict(nominal or {}), measure=measure, point=point, rate=rate,
        ranges=ranges,
    )  # fmt: skip


def stand_in_vehicle(task: FollowPath, number: int = 0, seed: int = 0, failing: float = 0.0) -> StandInVehicle:
    """Stand-in `number` of a series with hidden truths, driven by the task's controller."""
    from trueup.robots.stand_in_vehicle import StandInVehicle

    return StandInVehicle(number, task.settings, seed=seed, failing=failing)


def in_windows(length: float, simulator: Simulator | None = None) -> Suited:
    """Drives as the calibration by 'drives' takes them: in windows of `length` s, since a whole one drifts away.

    Raises PlanError for a `simulator` that is calibrated in a way of its own.
    """
    from trueup.campaign.cars import is_of_a_file

    if simulator is not None and is_of_a_file(simulator):
        raise PlanError(
            "[calibrate], method: 'drives' fits the simulator 'bicycle'; a vehicle is fitted as `trueup calibrate` does it, "
            "without a method (or with 'fit'), and stays as its file says with 'none'"
        )

    def drives(recordings: Sequence[Recording]) -> list[Recording]:
        from trueup.tracking.windows import windows

        found: list[Recording] = []
        for recording in recordings:
            with contextlib.suppress(RecordingError):  # nothing moves in it
                found += windows(recording, length)
        return found

    return drives


def drives(
    recordings: Sequence[Recording], simulator: Simulator, held_out: Sequence[Recording] = (),
    progress: Callable[[TracePoint], None] | None = None, length: float = LENGTH, most: int = 42,
) -> Calibration:  # fmt: skip
    """Fits a vehicle that is commanded by speed to at most `most` windows of `length` s of its drives.

    It is as unsure of itself as tuning should be. Raises RecordingError where nothing moves, CalibrationError where nothing
    can be fitted.
    """
    from trueup.campaign.drives import Drives
    from trueup.loop.prepare import Preparation

    ready = Preparation(Drives(length, most), simulator, tuple(recordings), tuple(held_out))
    return ready.calibrate(progress=progress)


def weighted(recordings: Sequence[Recording], channels: tuple[str, ...] = ("position",)) -> object:
    """Residuals in units of the noise that the plan's own recordings show. Raises PlanError where there is none."""
    from trueup.discrepancies.weighted import Weighted

    if not recordings:
        raise PlanError(
            "the discrepancy 'weighted' needs recordings in [calibrate]; leave it out, and each fit makes its own"
        )
    return Weighted.estimated(recordings, channels)


def _path(name: str, base: Path, speed: float | None):
    from trueup.paths.courses import COURSES
    from trueup.paths.csv import read_path

    if name in COURSES:
        return COURSES[name]()
    if name.lower().endswith((".csv", ".txt", ".tsv")):
        return read_path(base / name) if speed is None else read_path(base / name, speed=speed)
    raise unknown_name("course", name, COURSES, "those that are built in (a CSV file of waypoints will do too)")
