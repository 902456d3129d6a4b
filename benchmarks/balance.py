# SPDX-License-Identifier: Apache-2.0
"""A small humanoid rises from a chair, from its knees, and into a handstand: what searches cost, and how often they find.

From the chair: a search of 32 x 50 simulations, its share of the engine's own rate, and its winner. From the knees and into a
handstand: from how many of five seeds a motion is found within twice as many simulations, replays included, that succeeds in
at least five of six replays under noise (0.01 rad in the start and the commands) at 4, at 2 and at 1 ms; in a full run also
by the paper's integral as printed.

The peer is the engine alone: as many robots stepped in a plain loop over `Batch.step` with a constant command, no controller
and nothing read off. Its steps cost as the search's own: the winner's motion is under way in them.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray
from results import result

from trueup.engines.mujoco.model import prepared
from trueup.engines.simulator import Simulator
from trueup.loop.confirm import hunt
from trueup.search.cma_es import CmaEs
from trueup.studies.balance.scenes import SCENES, model_of, transition
from trueup.tasks.transitions import Transition

Array = NDArray[np.float64]

STEP = 0.004  # s, of the search; winners are confirmed at finer ones
POPULATION, GENERATIONS = 32, 50
BUDGET = 2 * POPULATION * GENERATIONS
"""Simulations of a hunt, replays included: two of the paper's searches."""


def searched(simulator: Simulator, task: Transition, generations: int, seed: int) -> tuple[Array, float, float, float]:
    """The best motion, wall and CPU seconds of the search, and simulated ones in all (those after a fall are not)."""
    space, (trial,) = task.parameters, task.trials
    search = CmaEs(space.to_unit(space.nominal), seed=seed, sigma=0.15, population=POPULATION,
                   max_evaluations=POPULATION * generations)  # fmt: skip
    simulated, begun, cpu = 0.0, time.perf_counter(), time.process_time()
    while not search.done:
        candidates = search.ask()
        done = simulator.rollout([trial], space.from_unit(candidates), task.controllers)
        simulated += sum(done[0].ends[k].at if k in done[0].ends else trial.duration for k in range(len(candidates)))
        search.tell(candidates, task.score(done))
    best = space.from_unit(search.best[0][None])
    return best, time.perf_counter() - begun, time.process_time() - cpu, simulated


def engine_rate(task: Transition, best: Array, seconds: float) -> tuple[float, float]:
    """Simulated seconds a second of wall and of CPU time by the engine alone, on as many threads."""
    compiled = prepared(model_of(task.name), step=STEP)
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    batch = Batch(compiled, POPULATION, nthread=threads)
    start = {name: channel.values[0] for name, channel in task.start.items()}
    qpos = batch.bind("qpos")
    qpos[:, :3], qpos[:, 3] = start["base_position"], 1.0
    for joint, angle in zip(task.motion.joints, start["position"], strict=True):
        qpos[:, compiled.jnt_qposadr[compiled.joint(joint).id]] = angle
    poses, times = task.motion.knots(best)
    control = batch.bind("ctrl")
    steps = round(seconds / STEP)
    begun, cpu = time.perf_counter(), time.process_time()
    for k in range(steps):
        control[:] = poses[0, min(int(np.searchsorted(times[0], k * STEP)), poses.shape[1] - 1)]
        batch.step()
    simulated = steps * STEP * POPULATION
    return simulated / (time.perf_counter() - begun), simulated / (time.process_time() - cpu)


def seeds_found(name: str, seeds: Sequence[int], fitness: str = "repaired") -> int:
    """From how many seeds a motion is found that holds; prints what each search cost."""
    simulator, task = transition(name, step=STEP, fitness=fitness)
    count = 0
    for seed in seeds:
        begun = time.process_time()
        found = hunt(task, simulator, np.random.default_rng(seed), wanted=1, simulations=BUDGET)
        count += bool(found.winners)
        said = f"holds in {found.winners[0].shares} of replays" if found.winners else "nothing that holds"
        print(f"{name}, {fitness} fitness, seed {seed}: {said}; {found.simulations} simulations, {found.doubted} that did "
              f"not hold, {time.process_time() - begun:.1f} CPU s", flush=True)  # fmt: skip
    return count


def main() -> None:
    """Prints the search's time, the share of the engine's rate, and whether the winner stands at finer steps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a fifth of the generations, and fewer seeds")
    parser.add_argument("--scene", default="sit-to-stand", choices=sorted(SCENES))
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    generations = GENERATIONS // 5 if asked.quick else GENERATIONS
    simulator, task = transition(asked.scene, step=STEP)
    simulator.rollout(task.trials, task.parameters.nominal[None], task.controllers)  # compiles
    best, seconds, cpu, simulated = searched(simulator, task, generations, asked.seed)
    rate, cpu_rate = engine_rate(task, best, task.duration)
    stands = []
    for step in (0.004, 0.002, 0.001):
        finer, again = transition(asked.scene, step=step)
        stands.append(bool(again.succeeded(finer.rollout(again.trials, best, again.controllers))[0]))
        print(f"at {1e3 * step:g} ms the winner {'stands' if stands[-1] else 'does not stand'}")
    print(f"{POPULATION} x {generations}: {seconds:.1f} s, {cpu:.1f} CPU s, {simulated:.0f} s simulated, "
          f"{simulated / cpu:.0f} a CPU second, by the engine alone {cpu_rate:.0f}")  # fmt: skip
    peer = "the engine's own steps in a plain loop"
    result("transition_search_seconds", seconds, "s", 1.3, peer=peer, peer_value=simulated / rate, ratio_goal=True)
    result("share_of_engine", simulated / cpu / cpu_rate, "of CPU", 0.85, peer=peer, at_most=False)
    result("winner_stands_at_2_ms", float(stands[1]), "", 1.0, at_most=False)
    for short, name, few in (("kneel", "kneel-to-stand", 3), ("handstand", "stand-to-handstand", 1)):
        seeds = range(few) if asked.quick else range(5)
        found = seeds_found(name, seeds)
        printed = None if asked.quick else float(seeds_found(name, seeds, "paper"))
        result(f"{short}_seeds_found", float(found), f"of {len(seeds)}", float(np.ceil(0.8 * len(seeds))), at_most=False,
               peer="" if asked.quick else "the paper's integral as printed", peer_value=printed)  # fmt: skip


if __name__ == "__main__":
    main()
