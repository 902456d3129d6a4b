# SPDX-License-Identifier: Apache-2.0
"""The whole study: each transition on stand-ins with different hidden truths, beside two other ways; into a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.inspection.repeats import bridged
from trueup.loop.confirm import hunt
from trueup.recording import Recording
from trueup.search.cma_es import CmaEs
from trueup.studies.balance.calibration import Runs, calibrated, simulator_of
from trueup.studies.balance.campaign import Round, Scale, campaign, performed
from trueup.studies.balance.pictures import poses_of
from trueup.studies.balance.robot import StandInHumanoid
from trueup.studies.balance.scenes import transition
from trueup.studies.balance.searching import CALIBRATED, RANDOM, Effort, searched, task_of
from trueup.studies.saved import Parts
from trueup.tasks.transitions import Transition

Array = NDArray[np.float64]
Told = Callable[[str, float], None]

SCENES: tuple[str, ...] = ("lean-to-stand", "sit-to-stand", "kneel-to-stand", "stand-to-handstand")
"""The paper's tasks I to IV."""


@dataclass(frozen=True)
class Size:
    """How large a study is."""

    stand_ins: int = 10
    scenes: tuple[str, ...] = SCENES
    rounds: int = 2
    generations: int = 10
    """Of CMA-ES in each calibration, of 32."""
    searched: int = 24
    """Generations of each search, of 32; half as many follow in several models."""
    hunted: int = 3200
    """Simulations that the search of a first motion may take."""
    randomised: bool = True
    """Whether a motion searched in many random models is tried beside."""
    oracle: int = 24
    """Runs of the robot that a search on it may take; 0: none is made."""
    subsets: int = 2
    """Stand-ins on which the paper's Table I is regenerated."""
    first: int = 0
    """Number of the first stand-in; those of the study are 0 to 9."""
    seed: int = 0

    @property
    def scale(self) -> Scale:
        """Of each campaign."""
        return Scale(self.rounds, generations=self.generations, effort=Effort(generations=self.searched))

    @property
    def numbers(self) -> range:
        """The stand-ins."""
        return range(self.first, self.first + self.stand_ins)


QUICK = Size(stand_ins=3, scenes=("lean-to-stand", "sit-to-stand"), searched=16, oracle=0, subsets=0)


@dataclass
class Findings:
    """All that the report tells, as it was saved."""

    size: Size
    first: dict[str, Any] = field(default_factory=dict)
    """Scene to the motions found in the model as it is, and in many random ones."""
    campaigns: dict[str, dict[int, Any]] = field(default_factory=dict)
    """Scene to stand-in to rounds."""
    randomised: dict[str, dict[int, list[bool]]] = field(default_factory=dict)
    oracle: dict[str, dict[int, int]] = field(default_factory=dict)
    """Runs of the robot until a search on it succeeded; 0: it did not."""
    subsets: dict[str, dict[str, list[bool]]] = field(default_factory=dict)
    """Table I: scenes calibrated on, joined by '+', to scene tried to whether each stand-in succeeded."""

    def share(self, scene: str, rounds: int) -> float:
        """Of the stand-ins on which a scene's motion worked after so many calibrations; NaN without any."""
        done = self.campaigns.get(scene, {}).values()
        return (
            float(np.mean([any(r["succeeded"] for r in each[: rounds + 1]) for each in done])) if done else float("nan")
        )

    def needed(self, scene: str) -> list[int]:
        """Calibrations until it worked, of the stand-ins on which it did."""
        done = [[r["succeeded"] for r in each] for each in self.campaigns.get(scene, {}).values()]
        return [each.index(True) for each in done if True in each]


def studied(folder: Path, size: Size, told: Told, *, compute: bool = True) -> Findings:
    """Computes what is not in the folder yet, or leaves it out. Raises OutputError where another study is in it."""
    parts, findings = Parts.at(folder, size), Findings(size)
    steps = len(size.scenes) * (1 + size.stand_ins * (1 + size.randomised + (size.oracle > 0))) + 7 * size.subsets
    done = 0

    def kept(name: str, made: Callable[[], object]) -> Any:
        nonlocal done
        told(name, done / steps)
        done += 1
        return parts.text(name, made) if compute or parts.has(name) else None

    def put(table: dict[str, dict[int, Any]], scene: str, number: int, found: Any) -> None:
        if found is not None:
            table.setdefault(scene, {})[number] = found

    for scene in size.scenes:
        found = kept(f"{scene}, first motion", lambda s=scene: _first(s, size))
        findings.first |= {scene: found} if found is not None else {}
        if found is None or found["share"] < 0.5:  # not even in its own simulator
            continue
        task = transition(scene, step=0.004)[1]
        motion, randomised = np.array(found["motion"]), np.array(found.get("randomised", []))
        for n in size.numbers:
            name, robot = f"{scene}, stand-in {n}", StandInHumanoid(scene, n)
            one = _Once(robot, task, size, motion, randomised, lambda line: told(line, done / steps))
            put(findings.campaigns, scene, n, kept(name, one.rounds))
            if size.randomised:
                put(findings.randomised, scene, n, kept(f"{name}, randomised", one.blindly))
            if size.oracle:
                put(findings.oracle, scene, n, kept(f"{name}, searched on it", one.oracle))
    findings.subsets = _generalised(findings, size, kept)
    return findings


def _first(scene: str, size: Size) -> dict[str, Any]:
    """The motion that the model file as it is leads to, and the one that many models drawn widely around it lead to."""
    simulator, rng = simulator_of(scene), np.random.default_rng([size.seed, SCENES.index(scene)])
    file = simulator.parameters.nominal
    task = task_of(scene, simulator, file)
    found = hunt(task, simulator, rng, wanted=1, simulations=size.hunted)
    if not found.winners:
        return {"motion": found.best.tolist(), "share": 0.0, "simulations": found.simulations}
    motion = found.winners[0].values
    told = {"motion": motion.tolist(), "share": found.winners[0].shares[-1], "simulations": found.simulations}
    if size.randomised:
        other = searched(scene, file[None], rng, doubt=RANDOM, begin=motion, effort=size.scale.effort)
        told |= {"randomised": other.motion.tolist(), "randomised_share": other.share}
    return told


@dataclass(frozen=True, eq=False)
class _Once:
    """One task on one stand-in, in three ways."""

    robot: StandInHumanoid
    task: Transition
    size: Size
    motion: Array
    randomised: Array
    told: Callable[[str], None]

    def rounds(self) -> list[dict[str, Any]]:
        """The campaign."""
        scene, number = self.robot.scene, self.robot.number
        rounds = campaign(scene, self.robot, self.task, self.motion, seed=number, scale=self.size.scale,
                          told=lambda line: self.told(f"stand-in {number}: {line}"))  # fmt: skip
        later = [r.values for r in rounds[1:]]
        return [as_told(scene, self.task, r, values) for r, values in zip_longest(rounds, later)]

    def blindly(self) -> list[bool]:
        """Repeats that stood of the motion that was searched in random models."""
        return list(performed(self.robot, self.task, self.randomised, "randomised")[1])

    def oracle(self) -> int:
        """Runs of the robot until CMA-ES on the robot itself, from the same first motion, finds one that works; 0: too many.

        Works: three runs in a row end as wanted.
        """
        space, rng = self.task.parameters, np.random.default_rng([self.size.seed, self.robot.number])
        search = CmaEs(space.to_unit(self.motion), seed=int(rng.integers(2**31)), sigma=0.08, population=8, restarts=0,
                       max_evaluations=self.size.oracle)  # fmt: skip
        count = 0
        while not search.done and count < self.size.oracle:
            asked, scores = search.ask(), []
            for motion in space.from_unit(asked):
                (run,), (stood,) = performed(self.robot, self.task, motion, f"oracle-{count}", 1)
                count += 1
                if stood:
                    again = performed(self.robot, self.task, motion, f"oracle-{count}-again", 2)[1]
                    count += 2
                    if all(again):
                        return count
                scores.append(_score(self.task, run, motion))
            search.tell(asked, np.array(scores))
        return 0


def as_told(scene: str, task: Transition, one: Round, later: Array | None) -> dict[str, Any]:
    """A round in numbers, with what its pictures need; `later` are the values that its recordings led to."""
    simulator = simulator_of(scene)
    (planned,) = task.planned(one.motion)
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


def _score(task: Transition, run: Recording, motion: Array) -> float:
    from trueup.tasks.task import as_rollout

    seen = bridged(run)
    return float(task.score([as_rollout(task.trials[0], [seen.slice(0.0, seen.stop)], motion)])[0])


def _generalised(
    findings: Findings, size: Size, kept: Callable[[str, Callable[[], object]], Any]
) -> dict[str, dict[str, list[bool]]]:
    """Table I: calibrated on the first runs of some scenes, tried on each of tasks I to III."""
    scenes = [s for s in SCENES[:3] if s in findings.campaigns]
    found: dict[str, dict[str, list[bool]]] = {}
    for n in list(size.numbers)[: size.subsets]:
        for on in _subsets(scenes):
            cells: Mapping[str, bool] | None = kept(
                f"calibrated on {'+'.join(on)}, stand-in {n}", lambda n=n, on=on: _cells(findings, n, on, scenes, size)
            )
            for scene, stood in (cells or {}).items():
                found.setdefault("+".join(on), {}).setdefault(scene, []).append(stood)
    return found


def _subsets(scenes: Sequence[str]) -> list[tuple[str, ...]]:
    """As the paper's table has them: one, two, three of them."""
    masks = sorted(
        range(1, 2 ** len(scenes)), key=lambda m: (m.bit_count(), [-(m >> k & 1) for k in range(len(scenes))])
    )
    return [tuple(s for k, s in enumerate(scenes) if m >> k & 1) for m in masks]


def _cells(findings: Findings, number: int, on: Sequence[str], scenes: Sequence[str], size: Size) -> dict[str, bool]:
    """Whether each scene's motion, searched with values from the scenes `on`, works on a stand-in."""
    rng, runs = np.random.default_rng([size.seed, number, 7]), []
    for scene in on:
        task = transition(scene, step=0.004)[1]
        motion = np.array(findings.first[scene]["motion"])
        recordings, _ = performed(StandInHumanoid(scene, number), task, motion, f"{scene}-0")
        runs.append(Runs(scene, recordings, task.trials[0].ends))
    models = calibrated(runs, seed=number, generations=size.generations).values
    stood = {}
    for scene in scenes:
        task = transition(scene, step=0.004)[1]
        begin = np.array(findings.first[scene]["motion"])
        found = searched(scene, models, rng, doubt=CALIBRATED, begin=begin, effort=size.scale.effort)
        worked = performed(StandInHumanoid(scene, number), task, found.motion, f"{scene} after {'+'.join(on)}")[1]
        stood[scene] = bool(2 * sum(worked) > len(worked))
    return stood
