# SPDX-License-Identifier: Apache-2.0
"""A generation of a small humanoid's runs with a controller in Python, beside the engine's own steps in a plain loop."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

import trueup.studies.balance
from trueup.controllers.controller import Observation
from trueup.ends import Fallen
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.stepping import unclocked
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

STEP, TICK = 0.002, 5  # s; steps from one command to the next: 100 Hz
TRIALS = 7


class Sway:
    """Moves all joints to and fro, each copy as far as it is told: some fall, sooner or later."""

    period = TICK * STEP

    def __init__(self, values: Array) -> None:
        self._size = values

    def reset(self, observation: Observation) -> None:
        """See Controller."""

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        tilt = observation.velocity[:, 4:5]
        return np.repeat(self._size * np.sin(4.0 * observation.time) - 0.02 * tilt, WIDTH, axis=1)


MODEL = load(Path(trueup.studies.balance.__file__).parent / "bioloid_gp.xml")
WIDTH = MODEL.width


def cpu(work: Callable[[], object]) -> float:
    """CPU seconds, the best of three."""
    times = []
    for _ in range(3):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def plain(simulator: MujocoSimulator, rows: int, steps: int) -> None:
    """The same number of steps with nothing in between but a command for all."""
    batch = simulator.batches.get(rows, contacts=True, sensors=True)
    batch.reset(keyframe=0 if simulator.compiled.nkey else -1)
    control = batch.bind("ctrl")
    with unclocked():
        for step in range(steps):
            if step % TICK == 0:
                control[:] = 0.02 * np.sin(4.0 * step * STEP)
            batch.step()


def main() -> None:
    """Prints the share of the engine's own rate, and what runs that end early cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer and shorter runs")
    options = parser.parse_args()
    candidates, lasting = (10, 2.0) if options.quick else (50, 4.0)
    simulator = MujocoSimulator(MODEL, step=STEP, threads=1)
    read = np.arange(0.0, lasting, 0.02)
    observed = {"position": Observed(MODEL.scalar_joints(), "rad", read)}
    trials = [Trial(f"run {k}", 0.0, lasting, None, observed, controller=Sway) for k in range(TRIALS)]
    small, far = np.full((candidates, 1), 0.02), np.linspace(0.02, 1.5, candidates)[:, None]
    simulator.rollout(trials[:1], small[:1], Sway)  # compiles
    rows, steps = candidates * TRIALS, round(lasting / STEP)
    ours, engine = cpu(lambda: simulator.rollout(trials, small)), cpu(lambda: plain(simulator, rows, steps))
    ending = [replace(t, ends=(Fallen(tilt=1.0),)) for t in trials]
    stopped, whole = cpu(lambda: simulator.rollout(ending, far)), cpu(lambda: simulator.rollout(trials, far))
    ends = [end.at for rollout in simulator.rollout(ending, far) for end in rollout.ends.values()]
    lived = (sum(ends) + lasting * (rows - len(ends))) / (lasting * rows)
    print(f"{rows} runs of {lasting:g} s, {steps} steps each, a command every {TICK}; {len(ends)} fall")
    print(f"ours        {ours:8.2f} CPU s   the engine alone {engine:8.2f} CPU s")
    print(f"with ends   {stopped:8.2f} CPU s   without {whole:8.2f} CPU s; {100 * lived:.0f} % of the time was lived")
    result("share_of_engine_rate", rows * steps / ours, "steps/s", 0.8, peer="Batch.step in a loop",
           peer_value=rows * steps / engine, at_most=False, ratio_goal=True)  # fmt: skip
    result("cpu_of_runs_that_end", stopped, "s", 1.2, peer="the time they lived, of whole runs", peer_value=lived * whole,
           ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
