# SPDX-License-Identifier: Apache-2.0
"""From a plan to the concrete parts of a campaign: names resolved, recordings read, nothing moved yet."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, TracePoint
from trueup.campaign.beginning import begun_with
from trueup.campaign.events import Event
from trueup.campaign.kinds import (
    CALIBRATIONS,
    DISCREPANCIES,
    ROBOTS,
    SEARCHES,
    SIMULATORS,
    TASKS,
    Suited,
    in_windows,
)
from trueup.campaign.making import arguments, called, component_type, instance
from trueup.campaign.output import create_folder as made_folder
from trueup.campaign.parts import Calibrator, Parts
from trueup.campaign.plan import Calibrate, Plan, PlanFile
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.engines.family import Family
from trueup.errors import ModelError, ParameterError, PlanError
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.formats import read
from trueup.loop.calibrate import Options
from trueup.loop.earlier import Earlier
from trueup.loop.prepare import Preparation
from trueup.recording import Recording
from trueup.search.search import Search
from trueup.tasks.task import Task, counted_by
from trueup.tracking.windows import LENGTH
from trueup.typed_toml import Component

_ROLES = {
    "robot": ("perform", "repeatable"),
    "simulator": ("name", "parameters", "step", "at_step", "shipped", "observable", "rollout"),
    "task": ("name", "parameters", "trials", "controllers", "score"),
}
"""What each part must have."""


def parts_of(
    file: PlanFile, folder: Path, say: Callable[[str], None], evaluator: Evaluator | None = None,
    past: Sequence[Event] = (),
) -> Parts:  # fmt: skip
    """Everything that the plan names, made; `folder` is the campaign's, `say` shows a robot's messages to the operator,
    `evaluator` says where candidates are simulated (None: here), `past` is what the campaign's journal holds.

    What is made may ask, by the names of its parameters, for: folder, folder_of_plan, say, seed, recordings, and the
    simulator and the task that were made before it. Raises PlanError, JournalError where recordings are others than those
    that the campaign began with, and what the parts raise.
    """
    plan, base = file.plan, file.path.parent
    recordings, held_out = _recordings(plan.calibrate, base, str(file.path), lambda every: begun_with(every, past, say))
    given: dict[str, Any] = {
        "folder": folder, "folder_of_plan": base, "say": say, "seed": plan.seed, "recordings": (*recordings, *held_out),
        "whole_runs": plan.calibrate.method.type == "whole-runs", "as_it_is": plan.calibrate.method.type == "none",
    }  # fmt: skip
    ready = _prepared(plan, given, base)
    given["simulator"] = simulator = ready.simulator
    given["task"] = task = _with(plan.task, instance(plan.task, "task", TASKS, given, base), "task")
    if not task.parameters.free.any():
        raise PlanError(f"{plan.task.where}: task '{task.name}' has no free parameter: nothing to tune")
    _check_success(file, task)
    robot = _with(plan.robot, instance(plan.robot, "robot", ROBOTS, given, base), "robot")
    discrepancy = None
    if plan.calibrate.discrepancy is not None:
        discrepancy = instance(plan.calibrate.discrepancy, "discrepancy", DISCREPANCIES, given, base)
    given["discrepancy"] = discrepancy
    parts = Parts(
        robot, simulator, task, _search(file, task.parameters), _calibrator(file, given, ready), tuple(recordings),
        tuple(held_out), discrepancy, plan.calibrate.channels or None, plan.limits.limits(), _suited(plan, ready),
        evaluator=evaluator or Here(), write=_writer(ready, tuple(held_out), folder, say), beside=base,
    )  # fmt: skip
    later = ready.later
    if later is None:
        return parts

    def proposed(seen: Sequence[Recording]) -> Parts:
        new = _limited(plan, later(seen))
        return replace(
            parts, simulator=new.simulator, calibrator=_calibrator(file, given, new), suited=_suited(plan, new),
            write=_writer(new, tuple(held_out), folder, say),
        )  # fmt: skip

    return replace(parts, later=proposed)


def _prepared(plan: Plan, given: Mapping[str, Any], base: Path) -> Preparation:
    """The plan's simulator, prepared: one with a model file is so already, another takes recordings as they are.

    Raises PlanError where nothing is declared to be calibrated and no experiment will show what to propose.
    """
    part = instance(plan.simulator, "simulator", SIMULATORS, given, base)
    ready = (
        part if isinstance(part, Preparation) else Preparation(Family(), _with(plan.simulator, part, "simulator"), ())
    )
    if ready.later is None:
        return _limited(plan, ready)
    if not plan.experiment.settings:
        raise PlanError(
            f"{plan.simulator.where}: what is to be calibrated? Name recordings in [calibrate] or a parameters file in "
            "[simulator], or let [experiment] settings = 1 make a recording from which parameters are proposed"
        )
    return ready


def _limited(plan: Plan, ready: Preparation) -> Preparation:
    """With only those parameters free that the plan calibrates."""
    if not plan.calibrate.parameters:
        return ready
    try:
        return ready.only(plan.calibrate.parameters)
    except ParameterError as error:
        raise type(error)(f"[calibrate], parameters: {error}") from error


def _suited(plan: Plan, ready: Preparation) -> Suited:
    """What makes recordings of the robot ready for the simulator that the plan names."""
    if plan.calibrate.method.type == "drives":
        return in_windows(float(plan.calibrate.method.options.get("length", LENGTH)), ready.simulator)
    return ready.suited


def _with(component: Component, part: Any, role: str) -> Any:
    """The part, if it has what its role asks for. Raises PlanError, which lists what is missing."""
    missing = [name for name in _ROLES[role] if not hasattr(part, name)]
    if missing:
        raise PlanError(
            f"{component.where}: '{component.type}' is no {role}: it lacks {', '.join(missing)} (see trueup.testing, which "
            "checks whether a class keeps its contract)"
        )
    return part


def _check_success(file: PlanFile, task: Task) -> None:
    """Raises PlanError for how much is enough below zero where more is better: plans had the score's own sign once."""
    enough = file.plan.stop.success
    if (counts := counted_by(task)) and -math.inf < enough < 0.0:
        raise PlanError(
            f"{file.path}, [stop]: success is {enough:g}: of task '{task.name}' plans and reports speak of the {counts}, "
            f"which is more the better; write how much is enough, as in success = {-enough:g}"
        )


def _recordings(
    plan: Calibrate, base: Path, where: str, chosen: Callable[[Sequence[Recording]], list[Recording]]
) -> tuple[list[Recording], list[Recording]]:
    """Those to fit and those held out. Raises PlanError for a pattern that finds none, FormatError."""
    paths: list[Path] = []
    for pattern in plan.recordings:
        matching = sorted(base.glob(pattern)) if any(c in pattern for c in "*?[") else [base / pattern]
        if not matching or not matching[0].exists():
            raise PlanError(f"{where}, [calibrate], recordings: '{pattern}' finds nothing in {base}")
        paths += matching
    everything = chosen(read(paths, base / plan.mapping if plan.mapping else None) if paths else [])
    names = [r.name for r in everything]
    for pattern in plan.hold_out:
        if not fnmatch.filter(names, pattern):
            raise PlanError(
                f"{where}, [calibrate], hold_out: '{pattern}' is none of the recordings: {', '.join(names) or 'none'}"
            )
    held = [r for r in everything if any(fnmatch.fnmatchcase(r.name, p) for p in plan.hold_out)]
    return [r for r in everything if r not in held], held


def _search(file: PlanFile, space: Any) -> Callable[[Array, int], Search]:
    """Makes a new search; checked once now, so that a wrong option is said before the robot moves."""
    plan, base = file.plan.optimize, file.path.parent
    labels = tuple(p.name for p in space.parameters if not p.frozen)
    budget = {"trials": plan.evaluations, "max_evaluations": plan.evaluations, "labels": labels}
    target = component_type(plan.search, "search", SEARCHES, base)

    def new(start: Array, seed: int) -> Search:
        return called(plan.search, target, {"start": start, "seed": seed, **budget}, base)

    new(np.full(len(labels), 0.5), 0)
    return new


def _calibrator(file: PlanFile, given: Mapping[str, Any], ready: Preparation) -> Calibrator | None:
    plan, base = file.plan, file.path.parent
    method = plan.calibrate.method.type
    if method == "none":
        return None
    if method in (fits := {"fit": _fit, "whole-runs": _whole}):
        if plan.calibrate.method.options:
            raise PlanError(
                f"{plan.calibrate.method.where}: '{method}' takes no options here; set choose, parameters, ... in [calibrate]"
            )
        return fits[method](file, given, ready)
    given = {**given, "simulator": ready.simulator}  # with what was proposed for the recordings
    target = component_type(plan.calibrate.method, "calibration", CALIBRATIONS, base)
    before = {**given, "recordings": (), "held_out": (), "progress": None, "earlier": None}
    arguments(plan.calibrate.method, target, before, base)  # what is wrong with the options is said now, not after runs

    def calibrate_by_plan(
        recordings: Sequence[Recording], held_out: Sequence[Recording], progress: Callable[[TracePoint], None],
        earlier: Earlier | None,
    ) -> Calibration:  # fmt: skip
        now = {**given, "recordings": recordings, "held_out": held_out, "progress": progress, "earlier": earlier}
        return target(**arguments(plan.calibrate.method, target, now, base))

    return calibrate_by_plan


def _writer(
    ready: Preparation, held_out: Sequence[Recording], folder: Path, say: Callable[[str], None]
) -> Callable[[int, Calibration, Sequence[Recording]], None] | None:
    """Writes the calibrated model of each round with its parameters beside it; None where the simulator came from no file."""
    if ready.model is None:
        return None

    said: set[str] = set()

    def write(number: int, calibration: Calibration, recordings: Sequence[Recording]) -> None:
        at = made_folder(folder / f"round-{number}")
        model = at / f"calibrated{ready.family.suffix}"
        try:
            notes = ready.with_recordings(recordings, held_out).write(calibration, model, at / "parameters.toml")
        except ModelError as error:  # the round goes on: its values are in the journal and the report
            notes = (f"the calibrated model could not be written: {error}",)
        for note in notes:
            if note not in said:  # once, not in each round
                say(f"note: {at.name}/{model.name}: {note}")
        said.update(notes)

    return write


def _fit(file: PlanFile, given: Mapping[str, Any], ready: Preparation) -> Calibrator:
    discrepancy: Discrepancy | None = given["discrepancy"]
    plan, say = file.plan.calibrate, given["say"]
    options = Options(search=plan.search, select=plan.select, robust=plan.robust, channels=plan.channels or None,
                      seed=file.plan.seed, lacking=plan.lacking)  # fmt: skip

    def fit(
        recordings: Sequence[Recording], held_out: Sequence[Recording], progress: Callable[[TracePoint], None],
        earlier: Earlier | None,
    ) -> Calibration:  # fmt: skip
        now = ready.with_recordings(recordings, held_out)
        if plan.choose:  # anew each time: what was left earlier may be told by now
            now, choice = now.worthwhile(plan.channels or None, discrepancy, seed=file.plan.seed)
            for note in choice.notes:
                say(f"note: {note}")
        return now.calibrate(
            options, discrepancy=discrepancy, progress=progress, earlier=None if plan.choose else earlier
        )

    return fit


def _whole(file: PlanFile, given: Mapping[str, Any], ready: Preparation) -> Calibrator:
    """Fits whole runs of a robot with a free base, all rounds' anew: what was left earlier may be told by now."""
    plan, ends = file.plan, given["task"].trials[0].ends

    def fit(
        recordings: Sequence[Recording], held_out: Sequence[Recording], progress: Callable[[TracePoint], None],
        earlier: Earlier | None,
    ) -> Calibration:  # fmt: skip
        now = ready.with_recordings(recordings, held_out)
        return now.calibrate_whole(ends=ends, choose=plan.calibrate.choose, seed=plan.seed, progress=progress)

    return fit
