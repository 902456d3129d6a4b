# SPDX-License-Identifier: Apache-2.0
"""The plan of a campaign, as campaign.toml says it: typed, checked, nothing made yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trueup import files
from trueup.errors import PlanError
from trueup.trial import Limits
from trueup.typed_toml import Component, build

USUAL: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "transition": {
        "experiment": {"settings": 0},
        "calibrate": {"method": "whole-runs", "choose": True},
        "optimize": {"evaluations": 800, "samples": 4},
        "transfer": {"incumbent": False},
    }
}
"""What a plan with a task of this type means where it says nothing, if that is not what the tables below say. A motion is
searched from a rough guess, with which a robot would fall: the first that it performs works in the simulator."""


ON_ROBOT: Mapping[str, Mapping[str, Any]] = {
    "experiment": {"repeats": 2},
    "calibrate": {"method": "none"},
    "transfer": {"candidates": 10, "incumbent": False, "confirm": False},
    "stop": {"rounds": 6, "patience": 6, "trials": 60},
}
"""The same of a plan that tunes on the robot: so many trials that all of its runs together tell what few cannot."""


@dataclass(frozen=True)
class Experiment:
    """[experiment]: the runs whose recordings the first calibration starts from."""

    settings: int = 1
    """With how many settings the task's trials are performed before the first calibration. The first is what the robot
    runs with today, which gives the score to beat; more are chosen for what they tell about the simulator."""
    later: int = 0
    """The same for each later round."""
    repeats: int = 1
    again: int = 1
    """How often a run that was aborted is handed out again, as a new trial."""
    noise: float = 0.02
    """Measurement noise that the choice reckons with, as a share of each signal's range."""

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        _at_least(self, "settings", 0)
        _at_least(self, "later", 0)
        _at_least(self, "again", 0)
        _at_least(self, "repeats", 1)
        _at_least(self, "noise", 0)


@dataclass(frozen=True)
class Calibrate:
    """[calibrate]: which of the simulator's parameters are fitted to which recordings, and how."""

    method: Component = field(default_factory=lambda: Component("fit"))
    """'fit' (least squares, or CMA-ES where slopes mislead), 'whole-runs' (runs of a free base that fall and touch: CMA-ES,
    then least squares from several priors), 'none', or your own function."""
    recordings: tuple[str, ...] = ()
    """Files, folders or patterns, relative to the plan, beside those of the campaign itself."""
    mapping: str = ""
    hold_out: tuple[str, ...] = ()
    """Names or patterns of recordings that only judge the fit."""
    parameters: tuple[str, ...] = ()
    """Names or patterns of what is fitted; the others stay as they are. Empty: all that the simulator declares free."""
    channels: tuple[str, ...] = ()
    """Measured channels to fit; empty: positions and sensors."""
    discrepancy: Component | None = None
    search: Literal["auto", "gradient", "cma-es", "hybrid"] = "auto"
    select: bool = True
    choose: bool = False
    """Before each fit, keep only those parameters on which replays hang and that the recordings can tell."""
    lacking: bool | None = None
    """Ask recordings what the model lacks, which can double the time; left out: those of no more than a minute."""
    robust: float = 3.0


@dataclass(frozen=True)
class Optimize:
    """[optimize]: how the controller is tuned: in the calibrated simulator, or on the robot itself."""

    method: Literal["simulator", "on-robot"] = "simulator"
    """'on-robot', for tasks whose settings go from gentle to bold (a walk's pace and lean): each trial is made where it tells
    most, by how all runs so far ended; the last ones are of what is worth the most. The rest of this table is then idle."""
    search: Component = field(default_factory=lambda: Component("cma-es"))
    evaluations: int = 200
    """Candidates tried in each round."""
    samples: int = 8
    """Each candidate is simulated with this many sets of the simulator's parameters, drawn from what the calibration
    is unsure of."""
    risk: float = 1.0
    """A candidate's loss is its mean score over these samples plus this many of their standard deviations."""
    widen: float = 1.0
    """Factor on the calibration's own uncertainty; above 1 where the simulator's structure is doubted."""
    within: float = 1.5
    """Only samples that foretell the robot's scores so far within this factor are tuned on; 0: all of them. Counts where
    scores are positive."""
    correct: bool = False
    """Whether the robot's own scores correct the simulator's: a Gaussian process over the task's parameters, of how far
    these are from those. Where it knows little, candidates count as unsure; see risk."""
    trust: float = 0.5
    """Half width of the first trust region, as a share of each parameter's range; 0.5 or more: all of it."""

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        _at_least(self, "evaluations", 1)
        _at_least(self, "samples", 1)
        _at_least(self, "risk", 0)
        _at_least(self, "widen", 0)
        if self.within != 0.0 and not self.within > 1.0:
            raise ValueError(f"within = {self.within} must be above 1, or 0 for no such choice")
        if not 0.0 < self.trust <= 1.0:
            raise ValueError(f"trust = {self.trust} must be above 0 and at most 1")


@dataclass(frozen=True)
class Evaluate:
    """[evaluate]: where candidates are simulated while the controller is tuned."""

    cluster: str = ""
    """'local:N' (workers on this machine), 'tcp://HOST:PORT' (a dask scheduler), 'slurm:N', 'htcondor:N' (jobs); empty: in
    this process, on all its cores. `trueup run --cluster` says it for one run."""
    quorum: float = 1.0
    """Share of a generation that must be scored on a cluster before the search goes on; what is late counts as failed. Below
    1, a campaign that is run again may go another way."""

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        if not 0.0 < self.quorum <= 1.0:
            raise ValueError(f"quorum = {self.quorum} must be above 0 and at most 1")


@dataclass(frozen=True)
class Transfer:
    """[transfer]: what goes to the robot at the end of a round."""

    candidates: int = 3
    """Distinct settings that are tried on the robot."""
    incumbent: bool = True
    """Whether the best so far is run again beside them, so that a drift of the robot is not taken for progress."""
    repeats: int = 1
    again: int = 1
    """How often a run that was aborted is handed out again, as a new trial."""
    confirm: bool = True
    """Whether the best is run once more at the end, if it was run but once: one run may have been lucky."""
    apart: float = 0.2
    """How far candidates lie from each other at least, as a share of the trust region."""

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        _at_least(self, "candidates", 1)
        _at_least(self, "again", 0)
        _at_least(self, "repeats", 1)
        _at_least(self, "apart", 0)


@dataclass(frozen=True)
class Stop:
    """[stop]: when the campaign ends. It always ends after its rounds."""

    rounds: int = 3
    success: float = -math.inf
    """A score on the robot that is good enough; of a task that counts something (a walk's speed) how much of that."""
    patience: int = 2
    """Rounds in a row without improvement."""
    improvement: float = 0.01
    """What counts as one, as a share of the score."""
    trials: int = 0
    """Runs on the robot at most; 0: no limit."""

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        _at_least(self, "rounds", 1)
        _at_least(self, "patience", 1)
        _at_least(self, "improvement", 0)
        _at_least(self, "trials", 0)

    def reached(self, score: float, counts: str) -> bool:
        """Whether a score is good enough; it is minus what `counts` names, where it names something."""
        return math.isfinite(self.success) and (-score >= self.success if counts else score <= self.success)


@dataclass(frozen=True)
class JointLimits:
    """[limits.joints.NAME]: range in rad or m, speed per s, effort in N m or N; a missing one is no limit."""

    range: tuple[float, float] = (-math.inf, math.inf)
    speed: float = math.inf
    effort: float = math.inf

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        if not self.range[0] <= self.range[1]:
            raise ValueError(f"range = {list(self.range)} must be the lowest and the highest, in this order")
        _at_least(self, "speed", 0)
        _at_least(self, "effort", 0)


@dataclass(frozen=True)
class Safety:
    """[limits]: what a trial may not exceed, checked before it is handed out."""

    joints: Mapping[str, JointLimits] = field(default_factory=dict)
    workspace: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def limits(self) -> Limits | None:
        """As a trial carries them; None where nothing is limited."""
        if not self.joints and not self.workspace:
            return None
        rows = self.joints.values()
        array = [np.array([f(j) for j in rows], dtype=np.float64) for f in
                 (lambda j: j.range[0], lambda j: j.range[1], lambda j: j.speed, lambda j: j.effort)]  # fmt: skip
        return Limits(tuple(self.joints), *array, workspace=dict(self.workspace))


@dataclass(frozen=True)
class Plan:
    """campaign.toml. Names are resolved by campaign/resolve.py."""

    robot: Component
    simulator: Component
    task: Component
    name: str = "campaign"
    seed: int = 0
    experiment: Experiment = field(default_factory=Experiment)
    calibrate: Calibrate = field(default_factory=Calibrate)
    optimize: Optimize = field(default_factory=Optimize)
    evaluate: Evaluate = field(default_factory=Evaluate)
    transfer: Transfer = field(default_factory=Transfer)
    stop: Stop = field(default_factory=Stop)
    limits: Safety = field(default_factory=Safety)

    def __post_init__(self) -> None:
        """Raises ValueError for what cannot be."""
        _at_least(self, "seed", 0)


@dataclass(frozen=True)
class PlanFile:
    """A plan, where it was read, and its text, which a campaign keeps."""

    plan: Plan
    path: Path
    text: str


def templates() -> dict[str, Path]:
    """What `trueup new` begins with: name -> folder with a campaign.toml and the files that it needs."""
    root = Path(str(resources.files("trueup.campaign") / "plans"))
    return {f.name: f for f in sorted(root.iterdir()) if f.is_dir()}


def read_plan(path: Path) -> PlanFile:
    """The plan in a file. Raises PlanError, naming file, table, key, value and the choices."""
    if not path.exists() and not path.is_symlink():
        raise PlanError(f"{path}: no such file{files.hint(path)}; `trueup new NAME` writes a plan to edit")
    text = files.text(path, PlanError)
    return PlanFile(plan_in(text, path), path, text)


def plan_in(text: str, where: Path) -> Plan:
    """The plan in a text, which came from the file `where`. Raises PlanError."""
    table = files.toml(where, PlanError, text)
    for f in fields(Plan):
        if f.name in ("robot", "simulator", "task") and f.name not in table:
            raise PlanError(f'{where}: [{f.name}] is missing; it says with type = "..." which {f.name} to use')
    return build(Plan, _with_usual(table), str(where))


def _with_usual(table: Mapping[str, Any]) -> Mapping[str, Any]:
    """A plan's table with what is usual for its task; what is no table stays, to be complained of."""
    task, optimize = table["task"], table.get("optimize")
    usual = dict(USUAL.get(str(task.get("type")), {})) if isinstance(task, Mapping) else {}
    if isinstance(optimize, Mapping) and optimize.get("method") == "on-robot":
        one_run = isinstance(task, Mapping) and task.get("type") == "walk"
        usual = {**usual, **ON_ROBOT, **({"task": {"runs": 1}} if one_run else {})}
    own = {name: table.get(name, {}) for name in usual}
    return {**table, **{n: {**usual[n], **t} for n, t in own.items() if isinstance(t, Mapping)}}


def _at_least(table: object, key: str, least: float) -> None:
    value = getattr(table, key)
    if not value >= least:
        raise ValueError(f"{key} = {value} must be at least {least}")
