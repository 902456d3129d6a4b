# SPDX-License-Identifier: Apache-2.0
"""Computes one part of the study: a first motion, a campaign on one robot, or what it is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import zip_longest
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.inspection.repeats import bridged
from trueup.loop.confirm import hunt
from trueup.search.cma_es import CmaEs
from trueup.studies.balance.calibration import STEP, Runs, calibrated, simulator_of
from trueup.studies.balance.campaign import Kept, Round, campaign, most, performed
from trueup.studies.balance.pictures import poses_of
from trueup.studies.balance.plan import SCENES, Depth, Part
from trueup.studies.balance.robot import StandInHumanoid
from trueup.studies.balance.scenes import transition
from trueup.studies.balance.searching import RANDOM, searched, task_of
from trueup.tasks.task import robot_scores
from trueup.tasks.transitions import Transition

Firsts = Mapping[str, Mapping[str, Any]]
"""Scene to what is kept of its parts 'first' and 'wide'."""


def computed(part: Part, depth: Depth, firsts: Firsts, kept: Kept) -> object:
    """What is kept of a part: anything that JSON holds; `kept` holds what leads to it."""
    match part.kind:
        case "first":
            return first(part.scene, depth)
        case "wide":
            return wide(part.scene, depth, firsts)
        case "rounds":
            return rounds(part.scene, part.number, depth, firsts, kept)
        case "randomised":
            robot, task = StandInHumanoid(part.scene, part.number), transition(part.scene, step=STEP)[1]
            return list(performed(robot, task, np.array(firsts[part.scene]["randomised"]), "randomised")[1])
        case "oracle":
            return oracle(part.scene, part.number, depth, firsts, part.runs)
        case _:
            return generalised(part.number, part.on, depth, firsts)


def first(scene: str, depth: Depth) -> dict[str, Any]:
    """The motion that the model file as it is leads to."""
    simulator, rng = simulator_of(scene), np.random.default_rng([depth.seed, SCENES.index(scene)])
    file = simulator.parameters.nominal
    found = hunt(task_of(scene, simulator, file), simulator, rng, wanted=1, simulations=depth.hunted)
    if not found.winners:
        return {"motion": found.best.tolist(), "share": 0.0, "simulations": found.simulations}
    best = found.winners[0]
    return {"motion": best.values.tolist(), "share": best.shares[-1], "simulations": found.simulations}


def wide(scene: str, depth: Depth, firsts: Firsts) -> dict[str, Any]:
    """The motion that many models drawn widely around the file lead to."""
    rng = np.random.default_rng([depth.seed, SCENES.index(scene), 1])
    file, begin = simulator_of(scene).parameters.nominal[None], np.array(firsts[scene]["motion"])
    found = searched(scene, file, rng, doubt=RANDOM, begin=begin, effort=depth.scale.effort)
    return {"randomised": found.values.tolist(), "randomised_share": found.share}


def rounds(scene: str, number: int, depth: Depth, firsts: Firsts, kept: Kept) -> list[dict[str, Any]]:
    """The campaign."""
    task, motion = transition(scene, step=STEP)[1], np.array(firsts[scene]["motion"])
    robot = StandInHumanoid(scene, number)
    done = campaign(scene, robot, task, motion, seed=number, scale=depth.scale, kept=kept)
    told = [as_told(scene, task, r, values) for r, values in zip_longest(done, [r.values for r in done[1:]])]
    if len(done) > 1:  # as in the paper's Figure 5, but on a run that the calibration did not see
        again, _ = performed(robot, task, motion, f"{scene}-0-left-out", 1)
        told[0]["repeat"] = Runs(scene, again, task.trials[0].ends).errors(done[1].values, depth.scale.parameters)
    return told


def oracle(scene: str, number: int, depth: Depth, firsts: Firsts, runs: int) -> int:
    """Runs of the robot until CMA-ES on the robot itself, from the same first motion, finds one that works; 0: too many.

    Works: three runs in a row end as wanted.
    """
    robot, task = StandInHumanoid(scene, number), transition(scene, step=STEP)[1]
    space, rng = task.parameters, np.random.default_rng([depth.seed, number])
    begin = space.to_unit(np.array(firsts[scene]["motion"]))
    search = CmaEs(begin, seed=int(rng.integers(2**31)), sigma=0.08, population=8, restarts=0, max_evaluations=runs)
    count = 0
    while not search.done and count < runs:
        asked, scores = search.ask(), []
        for motion in space.from_unit(asked):
            (run,), (stood,) = performed(robot, task, motion, f"oracle-{count}", 1)
            count += 1
            if stood:
                again = performed(robot, task, motion, f"oracle-{count}-again", 2)[1]
                count += 2
                if all(again):
                    return count
            seen = bridged(run)
            scores.append(float(robot_scores(task, [[seen.slice(0.0, seen.stop)]], motion)[0]))
        search.tell(asked, np.array(scores))
    return 0


def generalised(number: int, on: tuple[str, ...], depth: Depth, firsts: Firsts) -> dict[str, bool]:
    """A row of Table I: calibrated on the first runs of the scenes `on`, whether the motion of each of I to III works."""
    rng, runs, failed = np.random.default_rng([depth.seed, number, 7]), [], set()
    for scene in on:
        task = transition(scene, step=STEP)[1]
        recordings, stood = performed(
            StandInHumanoid(scene, number), task, np.array(firsts[scene]["motion"]), f"{scene}-0"
        )
        runs.append(Runs(scene, recordings, task.trials[0].ends))
        failed |= set() if most(stood) else {scene}
    models = calibrated(runs, seed=number, generations=depth.generations).values
    worked = {}
    for scene in [s for s in SCENES[:3] if s in firsts]:
        begin, task = np.array(firsts[scene]["motion"]), transition(scene, step=STEP)[1]
        found = searched(scene, models, rng, begin=begin, effort=depth.scale.effort, untried=scene not in failed)
        name = f"{scene} after {'+'.join(on)}"
        worked[scene] = most(performed(StandInHumanoid(scene, number), task, found.values, name)[1])
    return worked


def as_told(scene: str, task: Transition, one: Round, later: Array | None) -> dict[str, Any]:
    """A round in numbers, with what its pictures need; `later` are the values that its recordings led to."""
    simulator = simulator_of(scene)
    planned = task.watched(one.motion)
    usual = next(r for r, stood in zip(one.recordings, one.stood, strict=True) if stood == one.succeeded)
    shown = {"robot": bridged(usual)}
    fitted = {} if later is None else {"fitted": later}
    for word, values in {"file": simulator.parameters.nominal, "calibrated": one.values, **fitted}.items():
        shown[word] = simulator.rollout([planned], values[None])[0].recording()
    return {
        "motion": one.motion.tolist(), "stood": list(one.stood), "succeeded": one.succeeded, "expected": one.expected,
        "values": one.values.tolist(), "errors": list(one.errors), "seconds": one.seconds,
        "poses": {word: poses_of(recording, task.motion.joints) for word, recording in shown.items()},
    }  # fmt: skip
