# SPDX-License-Identifier: Apache-2.0
"""Which parameters a round may change, and how boldly: as an expert says, or as simulator and robot show.

A. Farchy, S. Barrett, P. MacAlpine and P. Stone (AAMAS 2013), section 4.4; leaving it to an algorithm is their future work.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.errors import PlanError, unknown_name
from trueup.evidence import STANDARD_ERRORS
from trueup.parameters import ParameterSpace
from trueup.studies.walk.search import Scene, whole

BALANCE = (
    "gyro_hipPitch", "gyro_kneePitch", "gyro_hipRoll", "gyro_ankleRoll", "scale_roll", "offset_pitch", "scale_pitch",
)  # fmt: skip
"""What the paper's expert froze: what it feels in a simulator is not what a robot feels."""


@dataclass(frozen=True, eq=False)
class Advice:
    """What a round searches."""

    space: ParameterSpace = PARAMETERS
    """Frozen are those that stay."""
    wide: Mapping[str, float] = field(default_factory=dict)
    """Factors on the search's first deviation."""
    words: tuple[str, ...] = ()
    """Why, for reports."""


class Guidance(Protocol):
    """Decides before each round what may change."""

    @property
    def name(self) -> str:
        """For tables."""
        ...

    def advice(self, number: int, scene: Scene, start: Array, sigma: float) -> Advice:
        """For round `number`, from 1, that begins at a walk (17,) with a deviation of `sigma` of each range."""
        ...


@dataclass(frozen=True)
class Unguided:
    """All parameters, always."""

    name: str = "no guidance"

    def advice(self, number: int, scene: Scene, start: Array, sigma: float) -> Advice:
        """See Guidance."""
        return Advice()


@dataclass(frozen=True)
class Expert:
    """What an expert says from some round on: by default the paper's choices, after the first round."""

    freeze: tuple[str, ...] = BALANCE
    widen: Mapping[str, float] = field(default_factory=lambda: {"amp_swing": 2.0})
    since: int = 2
    name: str = "expert"

    @classmethod
    def read(cls, path: Path) -> Expert:
        """From TOML: `freeze = ["scale_roll"]`, `since = 2`, a table `[widen]` of factors.

        Raises PlanError for a file that is none, UnknownNameError for what is no parameter of the walk.
        """
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise PlanError(f"{path}: {error}") from error
        freeze, widen, since = (table.pop(k, d) for k, d in (("freeze", []), ("widen", {}), ("since", 2)))
        for name in table:
            raise unknown_name("key", name, ("freeze", "widen", "since"), str(path))
        for name in (*freeze, *widen):
            if name not in PARAMETERS.names:
                raise unknown_name("parameter", name, PARAMETERS.names, str(path))
        factors = {k: v for k, v in widen.items() if isinstance(v, (int, float)) and v > 0.0}
        if len(factors) < len(widen) or not isinstance(since, int):
            raise PlanError(f"{path}: factors under [widen] are numbers above 0, since is a whole number")
        return cls(tuple(freeze), factors, since, f"expert ({path.name})")

    def advice(self, number: int, scene: Scene, start: Array, sigma: float) -> Advice:
        """See Guidance."""
        if number < self.since:
            return Advice()
        words = [f"frozen by the expert: {', '.join(self.freeze)}"] if self.freeze else []
        words += [f"{n} is changed {f:g} times as boldly, says the expert" for n, f in self.widen.items()]
        return Advice(PARAMETERS.freeze(self.freeze), dict(self.widen), tuple(words))


@dataclass(frozen=True)
class Automatic:
    """Each parameter is moved by one deviation of the search, up and down, in the simulator with the robot's scores told.

    One that loses either way, falls counted, and surely in one, is frozen: to change it only costs stability. Sure is what
    differs by two standard errors over models and disturbances, which all moves meet alike. None is changed more boldly for
    what it gains there: a search that does so takes more of what the simulator promises and no robot has.
    """

    runs: int = 12
    name: str = "automatic"

    def advice(self, number: int, scene: Scene, start: Array, sigma: float) -> Advice:
        """See Guidance."""
        gains, errors = self.gains(scene, start, sigma, number)
        worst, names = gains.argmin(axis=0), PARAMETERS.names
        at = worst, np.arange(len(names))
        lost = (gains.max(axis=0) < 0.0) & (gains[at] < -STANDARD_ERRORS * errors[at])
        words = []
        for j in np.flatnonzero(lost):
            up, down = (f"{100 * g:+.1f} cm/s" for g in gains[:, j])
            words.append(f"{names[j]} is frozen: a step up is worth {up}, a step down {down}, falls counted")
        if lost.all():  # nothing is left to change: where nothing helps, everything may
            return Advice(words=tuple(words))
        return Advice(PARAMETERS.freeze([names[j] for j in np.flatnonzero(lost)]), words=tuple(words))

    def gains(self, scene: Scene, start: Array, sigma: float, seed: int) -> tuple[Array, Array]:
        """(2, 17), (2, 17) m/s gained by a step up and down of each parameter, and their standard errors."""
        low, high = np.array([(p.lower, p.upper) for p in PARAMETERS.parameters]).T
        steps = np.concatenate([np.diag(sigma * (high - low)), -np.diag(sigma * (high - low))])
        rows = np.clip(np.concatenate([start[None], start + steps]), low, high)
        walk = replace(scene.walk, seed=7_000 + seed, runs=max(2, round(self.runs / len(scene.models))), alike=True)
        models = np.repeat(scene.models, len(rows), axis=0)
        done = scene.simulator.rollout(
            walk.trials, np.hstack([models, np.tile(rows, (len(scene.models), 1))]), walk.controllers
        )
        made = np.array([walk.made_good(r) - walk.fall * walk.risk(r) for r in done]).reshape(-1, len(rows))
        gain = made[:, 1:] - made[:, :1]
        mean, error = np.nanmean(gain, axis=0), np.nanstd(gain, axis=0, ddof=1) / np.sqrt(len(gain))
        if scene.correction is not None:
            zero = np.zeros(len(rows))
            told = -scene.correction(whole(rows), zero, zero)[0]
            mean = mean + told[1:] - told[0]
        return mean.reshape(2, -1), np.maximum(error, 1e-9).reshape(2, -1)
