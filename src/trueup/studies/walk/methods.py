# SPDX-License-Identifier: Apache-2.0
"""Where walks are searched: the simulator as it comes, or what the robot has left of the doubts about it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.learn import Wishes, learn
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.correction import Correction
from trueup.recording import Recording
from trueup.studies.walk import scenes
from trueup.studies.walk.search import Scene, whole
from trueup.studies.walk.study import FALL, Story
from trueup.tasks.task import simulated_scores
from trueup.tasks.walking import Walk, WalkFront

MOTOR = ("kp", "kv", "friction", "delay")
"""Of `scenes.DOUBTS`: what joints under their commands show."""


@dataclass(frozen=True)
class Ungrounded:
    """The simulator as it comes, quiet or noisy, whatever the robot shows; or with the robot's scores as correction."""

    noisy: bool = True
    seconds: float = 8.0
    runs: int = 4
    fall: float = FALL
    corrected: bool = False
    threads: int | None = None

    @property
    def name(self) -> str:
        """See Method."""
        return f"{'noisy' if self.noisy else 'quiet'} simulator{', corrected' * self.corrected}"

    def prepared(self, story: Story, seed: int) -> Scene:
        """See Method."""
        walk = scenes.task(WalkFront, noisy=self.noisy, runs=self.runs, seconds=self.seconds, fall=self.fall, seed=seed)
        simulator = scenes.simulator(threads=self.threads)
        models = simulator.parameters.nominal[None]
        return Scene(simulator, walk, models, _correction(story, simulator, walk, models) if self.corrected else None)


@dataclass(frozen=True)
class Calibrated:
    """The noisy simulator with motors as stiff, damped, sticky and late as the robot's joints show under their commands.

    Fitted anew in each round to `seconds` of the newest runs that stood, replayed in windows (`trueup.loop.calibrate`).
    """

    base: Ungrounded = field(default_factory=Ungrounded)
    seconds: float = 12.0

    @property
    def name(self) -> str:
        """See Method."""
        return f"{self.base.name}, servos calibrated"

    def prepared(self, story: Story, seed: int) -> Scene:
        """See Method."""
        simulator = scenes.doubtful(threads=self.base.threads)
        stood = [r for t in story.tried for r in t.runs.recordings if r.duration > WALKED + self.seconds / 2.0]
        half = self.seconds / 2.0
        walked = [legs(r, torso=True).slice(r.start + 1.0, r.start + 1.0 + half) for r in stood[-2:]]
        space = simulator.parameters
        motors = space.freeze([n for n in space.names if n not in MOTOR])
        found = calibrate(
            simulator, walked, options=Options(select=False, cross_validate=False, lacking=False), space=motors
        )
        scene = replace(self.base, corrected=False).prepared(story, seed)
        models = found.values[None]
        correction = _correction(story, simulator, scene.walk, models) if self.base.corrected else None
        return replace(scene, simulator=simulator, models=models, correction=correction)


def _correction(story: Story, simulator: Simulator, walk: Walk, models: Array) -> Correction:
    """Of the simulated scores of walks, by what the robot showed of those that were tried."""
    values = np.array([t.values for t in story.tried])
    simulated = simulated_scores(replace(walk, runs=max(1, 12 // len(models))), simulator, models, values).mean(axis=0)
    real = np.array([t.runs.score(FALL) for t in story.tried])
    counts = np.array([t.runs.number for t in story.tried], dtype=np.float64)
    return Correction.between(whole(values), -real, simulated, counts)


@dataclass(frozen=True)
class Grounded:
    """Another method's simulator, grounded anew in each round by what the robot's joints did in all runs so far.

    The paper's is a noisy simulator whose commands are 0.7 of those asked for and 0.3 of the joints predicted; `chained`, the
    model goes on from its own predictions, which replays the robot best (`trueup.grounding.blend`).
    """

    base: Ungrounded | Calibrated = field(default_factory=Ungrounded)
    learner: str = "linear"
    share: float = 0.3
    chained: bool = False
    recordings: int = 16
    """The newest runs that are learned from."""

    @property
    def name(self) -> str:
        """See Method."""
        return f"{self.base.name}, grounded ({self.learner}, {self.share:g}{', chained' * self.chained})"

    def prepared(self, story: Story, seed: int) -> Scene:
        """See Method."""
        runs = [legs(r) for t in story.tried for r in t.runs.recordings if r.duration > WALKED]
        wishes = Wishes(
            joints=scenes.MOTORS, others=(), learners=(self.learner,), by_row=False, period=scenes.CYCLE, view="own"
        )
        learned = learn(runs[-self.recordings :], wishes).grounding.weighted(1.0 - self.share, self.share)
        grounding = replace(learned, chained=self.chained)
        scene = self.base.prepared(story, seed)
        simulator = GroundedSimulator(scene.simulator, grounding, extrapolate=True)
        told = None if scene.correction is None else _correction(story, simulator, scene.walk, scene.models)
        return replace(scene, simulator=simulator, correction=told)


WALKED = 3.0
"""s: shorter runs are mostly falls."""


def legs(recording: Recording, *, torso: bool = False) -> Recording:
    """Positions and commands of the legs' motors alone, and how the torso was."""
    kept = {n: recording.channel(n).select(scenes.MOTORS) for n in ("command", "position")}
    more = ("base_position", "base_orientation") if torso else ()
    return recording.replace(channels={**kept, **{n: recording.channel(n) for n in more}})
