# SPDX-License-Identifier: Apache-2.0
"""A SimSpark-like simulator of a NAO, as it is and grounded, beside a stand-in robot on walks that were not learned from.

How far simulated joint angles and torso angles are from the robot's under the same commands, and whether the simulator ranks
walks by speed as the robot does. The stand-in is the robot's own model with a hidden truth; neither is told of the other.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from results import result
from scipy.stats import spearmanr

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.engines.simulator import Simulator
from trueup.evidence import evidence
from trueup.grounding.blend import with_inverse
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.grounding import Grounding
from trueup.grounding.learn import Learned, Wishes, learn
from trueup.recording import Recording
from trueup.studies.walk import scenes
from trueup.studies.walk.robot import StandInNao, Truth
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import WalkFront
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

SPREAD = 0.04  # of each parameter's range by which walks differ: as a search around the start walk does
SHARES = (0.3, 0.6, 1.0)
NOTHING = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Walks:
    """Walks that were done: (n, 17) parameters, the robot's recordings of each, and its trials as a simulator takes them."""

    values: Array
    recordings: tuple[Recording, ...]
    trials: tuple[Trial, ...]

    def first(self, count: int) -> Walks:
        """The first of them."""
        return Walks(self.values[:count], self.recordings[:count], self.trials[:count])


def walked(robot: StandInNao, rng: np.random.Generator, count: int, seconds: float, label: str) -> Walks:
    """So many walks of the robot around the start walk."""
    low, high = np.array([(p.lower, p.upper) for p in PARAMETERS.parameters]).T
    values = PARAMETERS.nominal + SPREAD * (high - low) * rng.standard_normal((count, len(low)))
    values = np.clip(values, low, high)
    walk = scenes.task(WalkFront, noisy=False, runs=1, seconds=seconds)
    recordings = [robot.perform(robot_trials(walk, v, f" {label} {k}")[0])[0] for k, v in enumerate(values)]
    return Walks(values, tuple(recordings), tuple(_observing(walk, r) for r in recordings))


def _observing(walk: WalkFront, recording: Recording) -> Trial:
    """The simulator's own trial of a walk, observed at the robot's instants up to the robot's end."""
    time_ = recording.time[recording.time >= walk.trials[0].start]
    seen = {"position": Observed(scenes.MOTORS, "rad", time_)}
    for name, o in walk.trials[0].observed.items():
        seen[name] = replace(o, time=o.time[o.time <= time_[-1] + 1e-9])
    return replace(walk.trials[0], observed=seen, name=recording.name)


@dataclass(frozen=True, eq=False)
class Agreement:
    """(n,) how far walks are from the robot's, by their recorded commands: joints, roll and pitch, in rad."""

    joints: Array
    torso: Array


def replayed(simulator: Simulator, walks: Walks) -> Agreement:
    """The robot's commands played in the simulator; what follows a fall is held."""
    trials = [Trial.of(_legs(r), ["position", "base_orientation"]) for r in walks.recordings]
    rows = []
    for recording, rollout in zip(walks.recordings, simulator.rollout(trials, NOTHING[None]), strict=True):
        position, angles = (rollout.trial.observed[n].time for n in ("position", "base_orientation"))
        joints = rollout.channels["position"][0] - recording.channel("position").select(scenes.MOTORS).at(position)
        torso = rollout.channels["base_orientation"][0] - recording.channel("base_orientation").at(angles)
        rows.append((_root(joints), _root(torso[:, :2])))
    return Agreement(*np.array(rows).T)


def speeds(simulator: Simulator, walks: Walks) -> tuple[Array, Array]:
    """(n,), (n,) m/s ahead of each walk in the simulator, walking by itself with the same parameters, and on the robot."""
    make = scenes.task(WalkFront, noisy=False, runs=1).make
    rows = []
    for value, recording, trial in zip(walks.values, walks.recordings, walks.trials, strict=True):
        (done,) = simulator.rollout([trial], value[None], make)
        x, far = done.held().channels["base_position"][0][:, 0], recording.channel("base_position").column("x")
        last = float(np.ptp(trial.observed["base_position"].time))
        rows.append(((x[-1] - x[0]) / last, (far[-1] - far[0]) / last))
    simulated, real = np.array(rows).T
    return simulated, real


def _root(wrong: Array) -> float:
    return float(np.sqrt(np.nanmean(wrong**2)))


def groundings(learned: Learned, simulator: Simulator, walks: Walks, *, quick: bool) -> dict[str, Grounding]:
    """The paper's with several shares, with the simulator's inverse model, and each going on from its own predictions."""
    kinds = {"forward": learned.grounding}
    if not quick:
        commands = [_legs(r).without("base_orientation") for r in walks.recordings[:6]]
        kinds["inverse"] = with_inverse(learned.grounding, simulator, commands, NOTHING)
    return {
        f"{name}{', chained' * chained}, {share:g}": replace(g.weighted(1.0 - share, share), chained=chained)
        for name, g in kinds.items()
        for chained in (False, True)
        for share in (SHARES[::2] if quick else SHARES)
    }


def _legs(recording: Recording) -> Recording:
    """Positions and commands of the legs alone, and how the torso was."""
    kept = {n: recording.channel(n).select(scenes.MOTORS) for n in ("command", "position")}
    return recording.replace(
        channels={**kept, **{n: recording.channel(n) for n in ("base_position", "base_orientation")}}
    )


def rank_of(simulated: Array, real: Array) -> float:
    """Rank correlation of simulated and real speeds."""
    return float(np.asarray(spearmanr(simulated, real)[0]))


def interval(before: Array, after: Array, real: Array, rng: np.random.Generator) -> tuple[float, float]:
    """95 % bootstrap interval over walks of the gain in rank correlation."""
    gains = []
    for _ in range(2000):
        pick = rng.integers(len(real), size=len(real))
        gains.append(rank_of(after[pick], real[pick]) - rank_of(before[pick], real[pick]))
    low, high = np.nanquantile(gains, [0.025, 0.975])
    return float(low), float(high)


def main() -> None:
    """Prints a row for each way of grounding, and the RESULT lines of the one that replayed the walks learned from best."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="6 walks of 5 s to learn from, 24 held out, no inverse models"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    robot = StandInNao(Truth.drawn(rng), seed=options.seed, threads=1)
    train, held, seconds = (6, 24, 5.0) if options.quick else (20, 40, 10.0)
    begun = time.process_time()
    learning, fresh = walked(robot, rng, train, seconds, "learn"), walked(robot, rng, held, seconds, "fresh")
    falls = [sum("ended" in r.provenance for r in w.recordings) for w in (learning, fresh)]
    print(f"{train} walks to learn from ({falls[0]} fell), {held} held out ({falls[1]} fell)")
    names = ("linear",) if options.quick else ("linear", "model-tree")
    view = "own" if options.quick else None
    wishes = Wishes(joints=scenes.MOTORS, others=(), learners=names, by_row=False, period=scenes.CYCLE, view=view)
    learned = learn(learning.recordings, wishes)
    print(f"{learned.grounding.about['learner']}, {learned.view}, {learned.rows.inputs.history} frames: "
          f"{learned.comparison.why}; {time.process_time() - begun:.0f} CPU s")  # fmt: skip
    simulator = scenes.simulator(threads=1)
    ways: dict[str, Simulator] = {"ungrounded": simulator}
    for name, grounding in groundings(learned, simulator, learning, quick=options.quick).items():
        ways[name] = GroundedSimulator(simulator, grounding, extrapolate=True)
    known = {name: replayed(s, learning.first(6)) for name, s in ways.items()}
    chosen = min(ways, key=lambda n: float(np.nan_to_num(np.mean(np.log(known[n].joints)), nan=np.inf)))
    found = {name: replayed(s, fresh.first(12)) for name, s in ways.items()}
    print("replays of the held-out walks' commands   joints   torso   [mrad]")
    for name, each in found.items():
        mark = " *" if name == chosen else ""
        print(f"  {name + mark:36s}{1e3 * _root(each.joints):10.1f}{1e3 * _root(each.torso):8.1f}")
    print(f"* replayed the walks learned from best; {time.process_time() - begun:.0f} CPU s")
    for part in ("joints", "torso"):
        gain = evidence(getattr(found["ungrounded"], part), getattr(found[chosen], part))
        print(f"{part}: ln(error ungrounded / grounded) = {gain.gain:.2f} +- {gain.standard_error:.2f}")
        result(f"grounded_{part}_over_ungrounded", float(np.exp(-gain.gain)), "", 1.0, peer="ungrounded simulator")
    ranks({"ungrounded": simulator, "the paper's": ways["forward, 0.3"], chosen: ways[chosen]}, fresh, rng)


def ranks(ways: dict[str, Simulator], walks: Walks, rng: np.random.Generator) -> None:
    """How each simulator, walking by itself, ranks the held-out walks by speed; RESULT of the last one."""
    found = {name: speeds(s, walks) for name, s in ways.items()}
    before, real = found["ungrounded"]
    print(f"walking by itself (the robot: {100 * real.mean():.1f} cm/s)   cm/s   rank correlation of speeds")
    for name, (simulated, _) in found.items():
        low, high = interval(before, simulated, real, rng)
        print(
            f"  {name:38s}{100 * simulated.mean():10.1f}{rank_of(simulated, real):8.2f}   gain {low:.2f} ... {high:.2f}"
        )
    last = rank_of(found[list(ways)[-1]][0], real)
    result("speed_rank_correlation", last, "", rank_of(before, real), peer="ungrounded",
           peer_value=rank_of(before, real), at_most=False)  # fmt: skip


if __name__ == "__main__":
    main()
