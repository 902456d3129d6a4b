# SPDX-License-Identifier: Apache-2.0
"""A SimSpark-like simulator of a NAO, as it is, calibrated and grounded, beside a stand-in robot on walks held out.

How far simulated joint angles and torso angles are from the robot's under the same commands, and whether the simulator ranks
walks by speed as the robot does. The stand-in is the robot's own model with a hidden truth; neither is told of the other.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from results import result
from scipy.stats import spearmanr

from trueup.articulated.declarations import Declaration, declare
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator
from trueup.evidence import Evidence, evidence
from trueup.grounding.blend import with_inverse
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.grounding import Grounding
from trueup.grounding.learn import Learned, Wishes, learn
from trueup.grounding.residual import with_residual
from trueup.recording import Recording
from trueup.search.cma_es import CmaEs
from trueup.studies.walk import scenes
from trueup.studies.walk.robot import StandInNao, Truth
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import WalkFront
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

SPREAD = 0.04  # of each parameter's range by which walks differ: as a search around the start walk does
SHARES = np.array([0.3, 0.6, 1.0])
NOTHING = np.zeros(0)
SERVOS = ("kp", "kv", "friction", "delay")  # what is calibrated, alike in all motors of the legs


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
    """(b, n) or (n,) how far walks are from the robot's, by their recorded commands: joints, roll and pitch, in rad."""

    joints: Array
    torso: Array


@dataclass(frozen=True, eq=False)
class Way:
    """A simulator with its parameters' values."""

    simulator: Simulator
    values: Array


def replayed(simulator: Simulator, walks: Walks, values: Array) -> Agreement:
    """The robot's commands played in the simulator, for values (b, n): (b, walks). What follows a fall is held."""
    trials = [Trial.of(_legs(r), ["position", "base_orientation"]) for r in walks.recordings]
    joints, torso = [], []
    for recording, rollout in zip(walks.recordings, simulator.rollout(trials, values), strict=True):
        position, angles = (rollout.trial.observed[n].time for n in ("position", "base_orientation"))
        wrong = rollout.channels["position"] - recording.channel("position").select(scenes.MOTORS).at(position)
        leans = rollout.channels["base_orientation"] - recording.channel("base_orientation").at(angles)
        joints.append([_root(w) for w in wrong])
        torso.append([_root(w[:, :2]) for w in leans])
    return Agreement(np.array(joints).T, np.array(torso).T)


def typical(found: Agreement) -> Array:
    """(b,) mean of the logarithms of both errors: what a way of grounding is chosen by."""
    return np.nan_to_num(np.mean(np.log(found.joints) + np.log(found.torso), axis=1), nan=np.inf)


def speeds(way: Way, walks: Walks) -> tuple[Array, Array]:
    """(n,), (n,) m/s ahead of each walk in the simulator, walking by itself with the same parameters, and on the robot."""
    walk = scenes.task(WalkFront, noisy=False, runs=1)
    longest = max(walks.trials, key=lambda trial: trial.observed["base_position"].time[-1])
    rows = np.concatenate([np.tile(way.values, (len(walks.values), 1)), walks.values], axis=1)
    (done,) = way.simulator.rollout([longest], rows, walk.make)
    time_, ahead = longest.observed["base_position"].time, done.held().channels["base_position"][:, :, 0]
    pairs = []
    for x, recording, trial in zip(ahead, walks.recordings, walks.trials, strict=True):
        first, last = trial.observed["base_position"].time[[0, -1]]
        far = recording.channel("base_position").column("x")
        pairs.append(
            (np.diff(np.interp([first, last], time_, x))[0] / (last - first), (far[-1] - far[0]) / (last - first))
        )
    simulated, real = np.array(pairs).T
    return simulated, real


def calibrated(walks: Walks, *, quick: bool) -> Way:
    """Servos of the simulator that replay walks best: stiffness, damping, friction and latency, by evolution."""
    model = load(scenes.SIMSPARK)
    lines = [Declaration(q, ("*",) if q == "delay" else scenes.MOTORS, tie="all", name=q) for q in SERVOS]
    space, quantities = declare(model, lines)
    simulator = MujocoSimulator(model, space, quantities, step=scenes.STEP, threads=1)
    population, generations = (8, 6) if quick else (12, 12)
    search = CmaEs(space.to_unit(space.nominal), seed=0, sigma=0.25, population=population)
    for _ in range(generations):
        tried = search.ask()
        search.tell(tried, typical(replayed(simulator, walks, space.from_unit(tried))))
    return Way(simulator, space.from_unit(search.best[0]))


def best_of(way: Way, groundings: Sequence[Grounding], walks: Walks) -> tuple[Way, str]:
    """The simulator grounded so that it replays walks best: which of several groundings, how much of it; and in words."""
    weights = np.column_stack([1.0 - SHARES, SHARES])
    scored = []
    for grounding in groundings:
        tried = GroundedSimulator(way.simulator, grounding, extrapolate=True, weights=weights)
        each = typical(replayed(tried, walks, np.tile(way.values, (len(SHARES), 1))))
        scored += [(float(s), share, grounding) for s, share in zip(each, SHARES, strict=True)]
    _, share, best = min(scored, key=lambda entry: entry[0])
    words = f"{'inverse, ' * (best.inverse is not None)}{'chained, ' * best.chained}{share:g}"
    return Way(GroundedSimulator(way.simulator, best.weighted(1.0 - share, share), extrapolate=True), way.values), words


def ways(learned: Learned, walks: Walks, *, quick: bool) -> dict[str, Way]:
    """The simulator as it is, with calibrated servos, grounded in each way, and both; chosen on walks learned from."""
    plain, few = Way(scenes.simulator(threads=1), NOTHING), walks.first(4 if quick else 6)
    commands = [_legs(r).without("base_orientation") for r in few.recordings]
    paper = Way(GroundedSimulator(plain.simulator, learned.grounding, extrapolate=True), NOTHING)
    found = {"ungrounded": plain, "the paper's, 0.3": paper, "parameter calibration": calibrated(few, quick=quick)}
    of = {"learned grounding": plain, "calibration and learned": found["parameter calibration"]}
    for name, way in of.items():
        told = [
            learned.grounding,
            *([] if quick else [with_inverse(learned.grounding, way.simulator, commands, way.values)]),
        ]
        found |= _named(name, best_of(way, [*told, *(replace(g, chained=True) for g in told)], few))
    for name, torque in (("delta action", False), ("residual torque", True)):
        added = with_residual(learned.grounding, plain.simulator, commands, NOTHING, torque=torque)
        print(f"{name}: {added.about['residual learner']}; {added.about['residual replay']}")
        found |= _named(name, best_of(plain, [added, replace(added, chained=True)], few))
    return found


def _named(name: str, best: tuple[Way, str]) -> dict[str, Way]:
    return {f"{name} ({best[1]})": best[0]}


def _legs(recording: Recording) -> Recording:
    """Positions and commands of the legs alone, and how the torso was."""
    kept = {n: recording.channel(n).select(scenes.MOTORS) for n in ("command", "position")}
    return recording.replace(
        channels={**kept, **{n: recording.channel(n) for n in ("base_position", "base_orientation")}}
    )


def rank_of(simulated: Array, real: Array) -> float:
    """Rank correlation of simulated and real speeds."""
    return float(np.asarray(spearmanr(simulated, real)[0]))


def intervals(before: Array, after: Array, real: Array) -> Array:
    """(2, 2) 95 % bootstrap intervals over walks: of a rank correlation, and of its gain over another."""
    rng, each = np.random.default_rng(0), []
    for _ in range(1000):
        pick = rng.integers(len(real), size=len(real))
        rank = rank_of(after[pick], real[pick])
        each.append((rank, rank - rank_of(before[pick], real[pick])))
    return np.nanquantile(each, [0.025, 0.975], axis=0).T


def _root(wrong: Array) -> float:
    return float(np.sqrt(np.nanmean(wrong**2)))


@dataclass(frozen=True, eq=False)
class Held:
    """A way on one robot's held-out walks: (n,) m/s in its simulator and on the robot; logarithms of both errors' ratios to
    the ungrounded ones.
    """

    simulated: Array
    real: Array
    joints: Evidence
    torso: Evidence


def main() -> None:
    """Prints a row for each way of bringing the simulator nearer to the robot, and RESULT lines over all robots."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two robots, 6 walks of 5 s to learn from, 24 held out, no inverse models, lines alone",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, help="so many stand-ins, of this seed and those that follow (default: 8)")
    options = parser.parse_args()
    robots = options.robots or (2 if options.quick else 8)
    pooled([of_robot(seed, quick=options.quick) for seed in range(options.seed, options.seed + robots)])


def of_robot(seed: int, *, quick: bool) -> dict[str, Held]:
    """Each way on the held-out walks of one stand-in; prints its table."""
    rng, begun = np.random.default_rng(seed), time.process_time()
    robot = StandInNao(Truth.random(rng), seed=seed, threads=1)
    train, held, seconds = (6, 24, 5.0) if quick else (20, 40, 10.0)
    learning, fresh = walked(robot, rng, train, seconds, "learn"), walked(robot, rng, held, seconds, "fresh")
    falls = [sum("ended" in r.provenance for r in w.recordings) for w in (learning, fresh)]
    print(f"robot {seed}: {train} walks to learn from ({falls[0]} fell), {held} held out ({falls[1]} fell)")
    names = ("linear",) if quick else ("linear", "model-tree")
    view = "own" if quick else None
    wishes = Wishes(joints=scenes.MOTORS, others=(), learners=names, by_row=False, period=scenes.CYCLE, view=view)
    learned = learn(learning.recordings, wishes)
    print(f"{learned.grounding.about['learner']}, {learned.view}, {learned.rows.inputs.history} frames: "
          f"{learned.comparison.why}; {time.process_time() - begun:.0f} CPU s")  # fmt: skip
    found = report(ways(learned, learning, quick=quick), fresh, len(fresh.values) if quick else 12)
    print(f"{time.process_time() - begun:.0f} CPU s", flush=True)
    return found


def report(found: dict[str, Way], fresh: Walks, replays: int) -> dict[str, Held]:
    """Prints the table of one robot's held-out walks."""
    print(f"held-out walks: replays of {replays}; {len(fresh.values)} walking by themselves (the robot: "
          f"{100 * speeds(found['ungrounded'], fresh)[1].mean():.1f} cm/s)")  # fmt: skip
    print(f"{'':44}joints  torso   over ungrounded: joints, torso     speed  rank correlation    gain")
    print(f"{'':44}  mrad   mrad   (ratio, 95 %)                      cm/s   (95 %)              (95 %)")
    held: dict[str, Held] = {}
    plain, (before, real) = replayed_by(found["ungrounded"], fresh.first(replays)), speeds(found["ungrounded"], fresh)
    for name, way in found.items():
        each, (simulated, _) = replayed_by(way, fresh.first(replays)), speeds(way, fresh)
        joints, torso = (evidence(getattr(plain, part), getattr(each, part)) for part in ("joints", "torso"))
        shown = "  ".join(f"{np.exp(-g.gain):.2f} ({np.exp(-g.gain - 2 * g.standard_error):.2f}-"
                          f"{np.exp(-g.gain + 2 * g.standard_error):.2f})" for g in (joints, torso))  # fmt: skip
        rank, (own, gain) = rank_of(simulated, real), intervals(before, simulated, real)
        errors = f"{name:44}{1e3 * _root(each.joints):6.1f}{1e3 * _root(each.torso):7.1f}   {shown}"
        ranks = f"{rank:.2f} ({own[0]:.2f}, {own[1]:.2f})  {gain[0]:+.2f} ... {gain[1]:+.2f}"
        print(f"{errors}{100 * simulated.mean():8.1f}  {ranks}")
        held[name.split(" (")[0]] = Held(simulated, real, joints, torso)
    return held


def pooled(robots: Sequence[dict[str, Held]]) -> None:
    """Prints errors over the ungrounded ones in the geometric mean over robots, and rank correlations in the mean, with 95 %
    intervals over robots and their walks; and the RESULT lines.
    """
    count = len(robots)
    print(f"{count} robots, in the mean (95 % over robots and walks; on how many it is better):")
    print(f"{'':26}joints      torso       rank correlation   its gain")
    before = float(np.mean([rank_of(r["ungrounded"].simulated, r["ungrounded"].real) for r in robots]))
    for name in robots[0]:
        joints, torso = (np.exp([-getattr(r[name], part).gain for r in robots]) for part in ("joints", "torso"))
        ranks = np.array([[rank_of(r[k].simulated, r[k].real) for k in ("ungrounded", name)] for r in robots])
        gain, (low, high) = float(np.mean(ranks[:, 1] - ranks[:, 0])), over_robots(robots, name)
        shown = "  ".join(f"{np.exp(np.log(x).mean()):.2f} ({np.sum(x < 1.0)} of {count})" for x in (joints, torso))
        print(f"{name:26}{shown}  {ranks[:, 1].mean():.3f}    {gain:+.3f} ({low:+.3f} ... {high:+.3f}; "
              f"{np.sum(ranks[:, 1] > ranks[:, 0])} of {count})")  # fmt: skip
        if name == "ungrounded":
            continue
        short = name.replace(",", "").replace(" ", "_").replace("'", "")
        for part, x in (("joints", joints), ("torso", torso)):
            result(f"{short}_{part}_over_ungrounded", float(np.exp(np.log(x).mean())), f"({count} robots)", 1.0,
                   peer="ungrounded simulator")  # fmt: skip
        result(f"{short}_speed_rank", before + gain, f"({count} robots)", before, peer="ungrounded", peer_value=before,
               at_most=False)  # fmt: skip


def over_robots(robots: Sequence[dict[str, Held]], name: str) -> Array:
    """(2,) 95 % bootstrap interval over robots, and over walks of each, of a rank correlation's gain over the ungrounded."""
    rng, gains = np.random.default_rng(0), []
    for _ in range(1000):
        drawn = []
        for k in rng.integers(len(robots), size=len(robots)):
            before, after = robots[k]["ungrounded"], robots[k][name]
            pick = rng.integers(len(after.real), size=len(after.real))
            drawn.append(
                rank_of(after.simulated[pick], after.real[pick]) - rank_of(before.simulated[pick], before.real[pick])
            )
        gains.append(np.mean(drawn))
    return np.nanquantile(gains, [0.025, 0.975])


def replayed_by(way: Way, walks: Walks) -> Agreement:
    """(walks,) of one way."""
    found = replayed(way.simulator, walks, way.values[None])
    return Agreement(found.joints[0], found.torso[0])


if __name__ == "__main__":
    main()
