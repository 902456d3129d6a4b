# SPDX-License-Identifier: Apache-2.0
"""A generation of walks: 150 candidates x 7 disturbed runs of 15 s, a controller in Python at 100 Hz that feels its gyros.

The peer is the engine alone: as many robots stepped in a plain loop over `Batch.step`, each with the commands of its own walk
set every 10 ms, with nothing sensed, drawn or read off. Its steps cost as ours: robots that walk, not ones that stand.
"""

from __future__ import annotations

import argparse
import os
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.controllers.controller import Controller, Observation
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.stepping import unclocked
from trueup.studies.walk.scenes import STEP, simulator, task
from trueup.tasks.walking import WalkFront

Array = NDArray[np.float64]

PERIOD = 0.01  # s from one command to the next
CANDIDATES, RUNS, SECONDS = 150, 7, 15.0
ALONE = 4.0  # s for which the engine is stepped alone, before and after
SPREAD = 0.03  # of the box: a generation of a search under way, in which few candidates fall


class Kept:
    """A Controller that keeps what another one commands."""

    def __init__(self, walk: Controller) -> None:
        self.period, self._walk = walk.period, walk
        self.commands: list[Array] = []

    def reset(self, observation: Observation) -> None:
        """See Controller."""
        self._walk.reset(observation)

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        self.commands.append(self._walk.command(observation))
        return self.commands[-1]


def generation(walk: WalkFront) -> Array:
    """(150, 17) candidates around the start walk."""
    space, rng = walk.parameters, np.random.default_rng(0)
    start = space.to_unit(space.nominal)
    return space.from_unit(np.clip(start + SPREAD * rng.standard_normal((CANDIDATES, len(start))), 0.0, 1.0))


def ours(engine: MujocoSimulator, walk: WalkFront, values: Array) -> tuple[float, float, int]:
    """Wall seconds, simulated seconds (of those that fell: up to there), and how many fell."""
    begun = time.perf_counter()
    done = engine.rollout(walk.trials, values, walk.controllers)
    seconds = time.perf_counter() - begun
    ends = [end.at for rollout in done for end in rollout.ends.values()]
    return seconds, walk.duration * (len(values) * len(done) - len(ends)) + sum(ends), len(ends)


def plain(engine: MujocoSimulator, commands: list[Array]) -> float:
    """Wall seconds of the engine alone, with commands (b, nu) of b candidates for each period."""
    batch = engine.batches.get(CANDIDATES * RUNS, contacts=True, sensors=True)
    batch.reset(keyframe=0)
    control, ticks = batch.bind("ctrl"), round(PERIOD / STEP)
    begun = time.perf_counter()
    with unclocked():
        for now in commands:
            control[:] = np.tile(now, (RUNS, 1))
            for _ in range(ticks):
                batch.step()
    return time.perf_counter() - begun


def main() -> None:
    """Prints simulations per second and the share of the engine's own step rate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="runs of 2 s")
    asked = parser.parse_args()
    lasting = 2.0 if asked.quick else SECONDS
    engine = simulator(STEP)
    walk = task(WalkFront, runs=RUNS, seconds=lasting, period=PERIOD)
    calm = task(WalkFront, runs=1, seconds=min(lasting, ALONE), period=PERIOD, noisy=False)
    values = generation(walk)
    kept: list[Kept] = []

    def keeping(rows: Array) -> Kept:
        kept.append(Kept(calm.controllers(rows)))
        return kept[-1]

    engine.rollout(calm.trials, values, keeping)  # compiles, too
    before = plain(engine, kept[0].commands)
    seconds, lived, fell = ours(engine, walk, values)
    peers = (before, plain(engine, kept[0].commands))  # before and after: the machine is not always alike
    rate = CANDIDATES * RUNS * calm.duration / float(np.mean(peers))
    each = f"runs of {lasting:g} s in steps of {1e3 * STEP:g} ms, commands at {1.0 / PERIOD:g} Hz"
    print(f"{CANDIDATES} x {RUNS} {each}; {fell} fell")
    print(f"ours              {seconds:7.1f} s, {lived / seconds:7.0f} simulated seconds a second")
    print(f"the engine alone  {np.mean(peers):7.1f} s, {rate:7.0f} simulated seconds a second")
    peer = "the engine's own steps in a plain loop"
    print(f"simulations a second: {lived / walk.duration / seconds:.1f} of {lasting:g} s")
    result("walks_per_second", lived / SECONDS / seconds, "runs of 15 s/s", 0.8, peer=peer, peer_value=rate / SECONDS,
           at_most=False, ratio_goal=True)  # fmt: skip
    result("share_of_engine", lived / seconds / rate, "", 0.8, peer=peer, at_most=False)


if __name__ == "__main__":
    main()
