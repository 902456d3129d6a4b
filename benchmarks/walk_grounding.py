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


def main() -> None:
    """Prints a row for each way of bringing the simulator nearer to the robot, and their RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="6 walks of 5 s to learn from, 24 held out, no inverse models, lines alone"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, default=1, help="so many stand-ins, of this seed and those that follow")
    options = parser.parse_args()
    ranked = [of_robot(seed, quick=options.quick) for seed in range(options.seed, options.seed + options.robots)]
    if options.robots > 1:
        pooled(ranked)


def of_robot(seed: int, *, quick: bool) -> dict[str, tuple[Array, Array]]:
    """Each way to the speeds of held-out walks in its simulator and on one stand-in; prints its table."""
    rng, begun = np.random.default_rng(seed), time.process_time()
    robot = StandInNao(Truth.drawn(rng), seed=seed, threads=1)
    train, held, seconds = (6, 24, 5.0) if quick else (20, 40, 10.0)
    learning, fresh = walked(robot, rng, train, seconds, "learn"), walked(robot, rng, held, seconds, "fresh")
    falls = [sum("ended" in r.provenance for r in w.recordings) for w in (learning, fresh)]
    print(f"{train} walks to learn from ({falls[0]} fell), {held} held out ({falls[1]} fell)")
    names = ("linear",) if quick else ("linear", "model-tree")
    view = "own" if quick else None
    wishes = Wishes(joints=scenes.MOTORS, others=(), learners=names, by_row=False, period=scenes.CYCLE, view=view)
    learned = learn(learning.recordings, wishes)
    print(f"{learned.grounding.about['learner']}, {learned.view}, {learned.rows.inputs.history} frames: "
          f"{learned.comparison.why}; {time.process_time() - begun:.0f} CPU s")  # fmt: skip
    ranked = report(ways(learned, learning, quick=quick), fresh, len(fresh.values) if quick else 12)
    print(f"{time.process_time() - begun:.0f} CPU s", flush=True)
    return ranked


def pooled(ranked: Sequence[dict[str, tuple[Array, Array]]]) -> None:
    """Prints rank correlations in the mean over robots, and their gain with 95 % intervals over robots and their walks."""
    print(
        f"{len(ranked)} robots: {'':32}rank correlation    gain, 95 % over robots and walks    robots on which it rises"
    )
    for name in ranked[0]:
        speeds_of = [(each["ungrounded"][0], *each[name]) for each in ranked]
        ranks = np.array([[rank_of(before, real), rank_of(after, real)] for before, after, real in speeds_of])
        rng, gains = np.random.default_rng(0), []
        for _ in range(1000):
            drawn = []
            for k in rng.integers(len(speeds_of), size=len(speeds_of)):
                before, after, real = speeds_of[k]
                pick = rng.integers(len(real), size=len(real))
                drawn.append(rank_of(after[pick], real[pick]) - rank_of(before[pick], real[pick]))
            gains.append(np.mean(drawn))
        low, high = np.nanquantile(gains, [0.025, 0.975])
        gain = float(np.mean(ranks[:, 1] - ranks[:, 0]))
        print(f"{name:44}{ranks[:, 1].mean():.3f}    {gain:+.3f} ({low:+.3f} ... {high:+.3f})"
              f"    {np.sum(ranks[:, 1] > ranks[:, 0])} of {len(ranks)}")  # fmt: skip
        if name != "ungrounded":
            result(f"{_short(name)}_speed_rank_gain_of_{len(ranks)}", gain, "", 0.0, peer="ungrounded", at_most=False)


def _short(name: str) -> str:
    """A way's name in RESULT lines."""
    return name.split(" (")[0].replace(",", "").replace(" ", "_").replace("'", "")


def report(found: dict[str, Way], fresh: Walks, replays: int) -> dict[str, tuple[Array, Array]]:
    """The table on held-out walks, and the RESULT lines; each way to its speeds and the robot's."""
    print(f"held-out walks: replays of {replays}; {len(fresh.values)} walking by themselves (the robot: "
          f"{100 * speeds(found['ungrounded'], fresh)[1].mean():.1f} cm/s)")  # fmt: skip
    print(f"{'':44}joints  torso   over ungrounded: joints, torso     speed  rank correlation    gain")
    print(f"{'':44}  mrad   mrad   (ratio, 95 %)                      cm/s   (95 %)              (95 %)")
    told: list[tuple[str, list[Evidence], float]] = []
    ranked: dict[str, tuple[Array, Array]] = {}
    plain, (before, real) = replayed_by(found["ungrounded"], fresh.first(replays)), speeds(found["ungrounded"], fresh)
    for name, way in found.items():
        each, (simulated, _) = replayed_by(way, fresh.first(replays)), speeds(way, fresh)
        ranked[name.split(" (")[0]] = simulated, real
        ratios = [evidence(getattr(plain, part), getattr(each, part)) for part in ("joints", "torso")]
        shown = "  ".join(f"{np.exp(-g.gain):.2f} ({np.exp(-g.gain - 2 * g.standard_error):.2f}-"
                          f"{np.exp(-g.gain + 2 * g.standard_error):.2f})" for g in ratios)  # fmt: skip
        rank, (own, gain) = rank_of(simulated, real), intervals(before, simulated, real)
        errors = f"{name:44}{1e3 * _root(each.joints):6.1f}{1e3 * _root(each.torso):7.1f}   {shown}"
        ranks = f"{rank:.2f} ({own[0]:.2f}, {own[1]:.2f})  {gain[0]:+.2f} ... {gain[1]:+.2f}"
        print(f"{errors}{100 * simulated.mean():8.1f}  {ranks}")
        if name != "ungrounded":
            told.append((name, ratios, rank))
    for name, ratios, rank in told:
        short = _short(name)
        for part, g in zip(("joints", "torso"), ratios, strict=True):
            result(f"{short}_{part}_over_ungrounded", float(np.exp(-g.gain)), "", 1.0, peer="ungrounded simulator")
        result(f"{short}_speed_rank", rank, "", rank_of(before, real), peer="ungrounded",
               peer_value=rank_of(before, real), at_most=False)  # fmt: skip
    return ranked


def replayed_by(way: Way, walks: Walks) -> Agreement:
    """(walks,) of one way."""
    found = replayed(way.simulator, walks, way.values[None])
    return Agreement(found.joints[0], found.torso[0])


if __name__ == "__main__":
    main()
