# SPDX-License-Identifier: Apache-2.0
"""Calibrates the humanoid's simulator on whole-body recordings: the paper's 30 parameters, or those and what it left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from trueup.arrays import Array
from trueup.articulated.assignments import Assignment
from trueup.articulated.declaration_file import read_declarations
from trueup.articulated.declarations import declare
from trueup.discrepancies.whole_body import WholeBody, orientation_error
from trueup.ends import End
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.problem import Problem
from trueup.loop.whole_runs import Told, WholeRuns, whole_body, whole_runs
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.studies.balance.scenes import model_of

PARAMETERS = {
    name: Path(str(resources.files("trueup") / "studies" / "balance" / f"{name}.toml"))
    for name in ("parameters", "wider")
}
CHANNELS = ("position", "base_position", "base_orientation")
_COM = 0.015  # m to each side of what the file says
STEP = 0.004  # s of the search; what it finds is judged at 2 ms


def declared(scene: str, parameters: str = "wider") -> tuple[ParameterSpace, tuple[Assignment, ...]]:
    """What is calibrated of the humanoid in a scene: 'parameters' are the paper's, 'wider' more."""
    space, assignments = declare(
        model_of(scene), read_declarations(PARAMETERS[parameters]), {"channel": ["base_position", "base_orientation"]}
    )
    near = [
        replace(p, lower=p.nominal - _COM, upper=p.nominal + _COM) if ".com_" in p.name else p for p in space.parameters
    ]
    return ParameterSpace(tuple(near)), assignments


def simulator_of(scene: str, parameters: str = "wider", *, step: float = STEP) -> MujocoSimulator:
    """The scene's simulator with these parameters."""
    return MujocoSimulator(model_of(scene), *declared(scene, parameters), step=step)


@dataclass(frozen=True, eq=False)
class Runs:
    """Recordings of one motion in one scene, and the conditions that end a run of it."""

    scene: str
    recordings: tuple[Recording, ...]
    ends: tuple[End, ...] = ()

    def problem(self, simulator: MujocoSimulator) -> Problem:
        """Their average, as far as they agree, as something to be replayed."""
        return whole_body(simulator, self.recordings, self.ends)

    def error(self, simulator: MujocoSimulator, values: Array) -> float:
        """Root mean square angle in rad from the measured torso to the simulated one with values (n,), each run by itself."""
        problem = Problem(simulator, self.recordings, WholeBody(), CHANNELS, ends=self.ends)
        return orientation_error(self.recordings, problem.rollouts(values[None]))

    def errors(self, values: Array, parameters: str = "wider") -> tuple[float, float]:
        """`error` by the model file, and with values (n,)."""
        simulator = simulator_of(self.scene, parameters)
        return self.error(simulator, simulator.parameters.nominal), self.error(simulator, values)


def calibrated(
    runs: Sequence[Runs], parameters: str = "wider", *, seed: int = 0, told: Told | None = None, **effort: Any
) -> WholeRuns:
    """Calibrates on motions in any scenes, on the average of each one's repeats; `effort` as in `whole_runs`."""
    simulators = {r.scene: simulator_of(r.scene, parameters) for r in runs}
    space = simulators[runs[0].scene].parameters
    problems = [r.problem(simulators[r.scene]) for r in runs]
    return whole_runs(problems, space, seed=seed, told=told, **effort)
