# SPDX-License-Identifier: Apache-2.0
"""Where walks are searched: the simulator as it comes, or what the robot has left of the doubts about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln

from trueup.engines.simulator import Simulator
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.learn import Wishes, learn
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.correction import Correction
from trueup.recording import Recording
from trueup.studies.walk import scenes
from trueup.studies.walk.search import Scene, whole
from trueup.studies.walk.study import FALL, Story, Tried
from trueup.tasks.task import simulated_scores
from trueup.tasks.walking import Walk, WalkFront

Array = NDArray[np.float64]

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
class Doubted:
    """The simulator with whatever servos, carpet and torso let the start walk stand as the robot does, several at a time.

    Until the robot has fallen the simulator is only made noisy: boldly on, to where it falls. From then on each walk meets
    `models` points of the box of `scenes.DOUBTS`, one run each. They are drawn from `library` points by how likely the start
    walk's runs on the robot are in each: a walk that falls in f of r simulated runs falls in F of R real ones with the chance
    that a beta distribution (Jeffreys') leaves, tempered so that as many effective points are left as are drawn, since no
    point is the truth. Later walks do not count (`learned` says how many do): a few falls in two runs each are as likely
    where nothing ever falls, and such points foretell the robot's falls worst.
    """

    models: int = 8
    seconds: float = 6.0
    fall: float = 0.35
    """m/s: less than on the robot, since each point falls somewhere that the robot does not."""
    sway: bool = True
    """Whether sway counts as the falls that it makes likely."""
    library: int = 48
    learned: int = 1
    """Of how many of the robot's walks the falls count, the start walk first; 0: drawn from the whole box."""
    corrected: bool = False
    threads: int | None = None

    @property
    def name(self) -> str:
        """See Method."""
        told = ", untold" if not self.learned else ", all falls told" if self.learned > 1 else ""
        parts = told, ", falls alone" * (not self.sway), ", corrected" * self.corrected
        return f"doubted simulator{''.join(parts)}"

    def prepared(self, story: Story, seed: int) -> Scene:
        """See Method."""
        if not any(t.runs.falls for t in story.tried):
            return Ungrounded(threads=self.threads).prepared(story, seed)
        simulator = scenes.doubtful(threads=self.threads)
        space = simulator.parameters
        rng = np.random.default_rng([seed, 48])
        points = space.from_unit(_spread(self.library, len(space), rng))
        walk = scenes.task(
            WalkFront, runs=1, seconds=self.seconds, fall=self.fall, seed=seed, alike=True,
            tips=scenes.TIPS if self.sway else None,
        )  # fmt: skip
        chances = np.full(len(points), 1.0 / len(points))
        if self.learned:
            chances = tempered(likelihoods(story.tried[: self.learned], simulator, walk, points), self.models)
        models = points[drawn(chances, self.models, rng)]
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
        stood = [r for t in story.tried for r in t.runs.recordings if r.duration > _WALKED + self.seconds / 2.0]
        half = self.seconds / 2.0
        walked = [legs(r, torso=True).slice(r.start + 1.0, r.start + 1.0 + half) for r in stood[-2:]]
        space = simulator.parameters
        motors = space.freeze([n for n in space.names if n not in MOTOR])
        found = calibrate(simulator, walked, options=Options(select=False, cross_validate=False), space=motors)
        scene = replace(self.base, corrected=False).prepared(story, seed)
        models = found.values[None]
        correction = _correction(story, simulator, scene.walk, models) if self.base.corrected else None
        return replace(scene, simulator=simulator, models=models, correction=correction)


_TELLING = 6  # walks by which points are judged: each costs a run of every point


def likelihoods(tried: Sequence[Tried], simulator: Simulator, walk: Walk, points: Array) -> Array:
    """(p,) logarithms: how likely the robot's falls are if the simulator has the parameters `points` (p, n).

    By the walks of which the robot showed most, the later ones of equals, each in the walk's own disturbed runs.
    """
    known = sorted(range(len(tried)), key=lambda k: (tried[k].runs.number, k))[-_TELLING:]
    values = np.array([tried[k].values for k in known])
    real = np.array([[tried[k].runs.falls + tried[k].runs.veers, tried[k].runs.number] for k in known]).T
    rows = np.hstack([np.repeat(points, len(values), axis=0), np.tile(values, (len(points), 1))])
    falls = np.sum([walk.risk(r) for r in simulator.rollout(walk.trials, rows, walk.controllers)], axis=0)
    falls = falls.reshape(len(points), -1)
    a, b = falls + 0.5, len(walk.trials) - falls + 0.5
    return np.sum(betaln(a + real[0], b + real[1] - real[0]) - betaln(a, b), axis=1)


def tempered(logs: Array, effective: float) -> Array:
    """(p,) chances in proportion to exp(power logs), with the largest power up to 1 that leaves `effective` of them.

    The effective number is that of L. Kish, Survey Sampling, 1965: 1 / sum of squares.
    """

    def chances(power: float) -> Array:
        weights = np.exp(power * (logs - logs.max()))
        return weights / weights.sum()

    low, high = 0.0, 1.0
    if 1.0 / np.sum(chances(high) ** 2) >= effective:
        return chances(high)
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 1.0 / np.sum(chances(middle) ** 2) >= effective else (low, middle)
    return chances(low)


def drawn(chances: Array, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(count,) of p by their chances, evenly spaced along their sum, so that each comes about as often as it should."""
    edges = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(chances), edges), len(chances) - 1)


def _spread(count: int, dimensions: int, rng: np.random.Generator) -> Array:
    """(count, n) of the unit box, a Latin hypercube (M. McKay, R. Beckman and W. Conover, Technometrics 21, 1979)."""
    order = rng.permuted(np.tile(np.arange(count), (dimensions, 1)), axis=1).T
    return (order + rng.random(order.shape)) / count


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

    base: Ungrounded | Doubted | Calibrated = field(default_factory=Ungrounded)
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
        runs = [legs(r) for t in story.tried for r in t.runs.recordings if r.duration > _WALKED]
        wishes = Wishes(
            joints=scenes.MOTORS, others=(), learners=(self.learner,), by_row=False, period=scenes.CYCLE, view="own"
        )
        learned = learn(runs[-self.recordings :], wishes).grounding.weighted(1.0 - self.share, self.share)
        grounding = replace(learned, chained=self.chained)
        scene = self.base.prepared(story, seed)
        simulator = GroundedSimulator(scene.simulator, grounding, extrapolate=True)
        told = None if scene.correction is None else _correction(story, simulator, scene.walk, scene.models)
        return replace(scene, simulator=simulator, correction=told)


_WALKED = 3.0  # s: shorter runs are mostly falls


def legs(recording: Recording, *, torso: bool = False) -> Recording:
    """Positions and commands of the legs' motors alone, and how the torso was."""
    kept = {n: recording.channel(n).select(scenes.MOTORS) for n in ("command", "position")}
    more = ("base_position", "base_orientation") if torso else ()
    return recording.replace(channels={**kept, **{n: recording.channel(n) for n in more}})
