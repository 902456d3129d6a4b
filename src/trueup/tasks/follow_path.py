# SPDX-License-Identifier: Apache-2.0
"""Following paths with the Stanley controller: gains in, distance from the path out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.controllers.controller import Controller
from trueup.controllers.stanley.kernel import ARC, MEMORY, nearest, path_table
from trueup.controllers.stanley.law import GAINS, Stanley, StanleySettings, gain_space
from trueup.engines.simulator import Rollout
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import ParameterSpace
from trueup.paths import Path
from trueup.recording import Channel
from trueup.rounding import PRINTED
from trueup.samples import stretches_of
from trueup.tasks.steered import steered_otherwise
from trueup.trial import Observed, Trial

POINTS = ("front", "rear")
MEASURES = ("rms", "mean", "max")

LOST = 1.0
"""Distance, in m, that counts at most for what of the path was never reached; else how far on it lies counts.

A run that ends a hand's breadth before the path does is about as good as one that does not, and costs about as much.
"""

_BACK = 0.75 * np.pi  # rad within a wheelbase: no corner, the vehicle would have to back off
_SLACK = 1.0 / 0.7
"""A robot that is as slow as a calibration reckons with (`wheel_scale`) still arrives: what it has not reached counts as
lost, so that gains would be tuned for being early."""
_PAUSE = 4.0  # s: delays, and the first steps from standstill


class FollowPath:
    """A Task: tune the Stanley gains `names` so that the robot stays on `paths` (one trial each).

    The score is the distance from the path by arc length ('rms', 'mean' or 'max', in m), of several paths the geometric
    mean, so that a tenth less counts alike on each and none rules, of the
    axle that the controller steers onto the path ('front'), or of the pose itself ('rear'): a front axle on the path means
    a rear axle inside the curve, by geometry, whatever the gains. `nominal` are today's gains, `ranges`
    the lowest and highest that are searched; `duration` in s holds for all paths, else each has a little more time than its
    target speed needs.
    Raises ParameterError without paths or for one shorter than the vehicle, UnknownNameError for other points or measures.
    """

    def __init__(
        self, paths: Sequence[Path], settings: StanleySettings | None = None, *, names: tuple[str, ...] = GAINS,
        nominal: dict[str, float] | None = None, measure: str = "rms", point: str = "front", rate: float = 20.0,
        duration: float | None = None, ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:  # fmt: skip
        if not paths:
            raise ParameterError("a path-following task needs at least one path")
        for value, known, kind in ((measure, MEASURES, "measure"), (point, POINTS, "point")):
            if value not in known:
                raise unknown_name(kind, value, known, "what a path-following task can judge by")
        self.paths = tuple(paths)
        self.settings = settings or StanleySettings()
        short = next((p for p in self.paths if p.length < self.settings.wheelbase), None)
        if short is not None:
            least = f"less than the vehicle (wheelbase {self.settings.wheelbase:.3g} m)"
            raise ParameterError(f"path '{short.name}' is {short.length:.3g} m long, {least}: are its numbers metres?")
        self.parameters: ParameterSpace = gain_space(names, self.settings.edges, ranges, **(nominal or {}))
        self.measure, self.point = measure, point
        self.trials = tuple(trial_of(p, self.settings, rate, duration) for p in self.paths)

    @property
    def name(self) -> str:
        """What is followed."""
        return "follow " + ", ".join(p.name for p in self.paths)

    @property
    def unit(self) -> str:
        """Of the score."""
        return "m"

    def controllers(self, values: Array) -> Controller:
        """The controller of b copies with gains (b, m)."""
        return Stanley(values, self.settings, names=self.parameters.names)

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        """(b,) in m, NaN where a simulation failed. See Task.score."""
        each = [self.errors(r, p) for r, p in zip(rollouts, self.paths, strict=True)]
        return each[0] if len(each) == 1 else np.exp(np.mean(np.log(np.maximum(each, PRINTED)), axis=0))

    def errors(self, rollout: Rollout, path: Path) -> Array:
        """(b,) distance from one path, in m."""
        errors = self.distances(self.driven(rollout), path)
        errors[list(rollout.failures)] = np.nan
        return errors

    def distances(self, driven: Array, path: Path) -> Array:
        """(b,) distance of driven points (b, T, 2) from one path by the task's measure, in m; NaN samples are skipped."""
        return self._judged(driven, path)[:, 0]

    def doubts(self, rollouts: Sequence[Rollout]) -> tuple[tuple[str, ...], ...]:
        """See Doubts: how much of a path runs did not reach, where that is more than its points can tell."""
        found = []
        for rollout, path in zip(rollouts, self.paths, strict=True):
            missing = self._judged(self.driven(rollout), path)[:, 1]
            found.append((*(
                f"the last {m:.3g} m of path '{path.name}' were not reached, and count with how far on they lie: a log is to "
                "go on until the path's end is passed" for m in missing if m > path.arc[-1] - path.arc[-2]
            ), *steered_otherwise(rollout, path.name, self.parameters.nominal, self.controllers)))  # fmt: skip
        return tuple(found)

    def _judged(self, driven: Array, path: Path) -> Array:
        """(b, 2) distance from a path by the task's measure, and how much of it was not reached, in m."""
        points = np.ascontiguousarray(driven, dtype=np.float64)
        spare = self.settings.wheelbase if self.point == "rear" else 0.0  # the front axle is at the end before it
        return _distances(points, path_table(path), self.settings.ahead, spare, MEASURES.index(self.measure))

    def driven(self, rollout: Rollout) -> Array:
        """(b, T, 2) where the judged point of the vehicle was, in m; NaN where nothing was measured."""
        position = rollout.channels["position"]
        if self.point == "rear":
            return position
        heading = rollout.channels["heading"][:, :, 0]
        return position + self.settings.wheelbase * np.stack([np.cos(heading), np.sin(heading)], axis=2)


def trial_of(path: Path, settings: StanleySettings, rate: float = 20.0, duration: float | None = None) -> Trial:
    """The trial that drives `path` once, from standstill with the front axle on its first point; `rate` in Hz."""
    lasting = path.duration * _SLACK + _PAUSE if duration is None else duration
    time = np.arange(int(lasting * rate) + 1, dtype=np.float64) / rate
    heading = path.heading[0]
    rear = path.points[0] - settings.wheelbase * np.array([np.cos(heading), np.sin(heading)])
    start = np.zeros(1)
    return Trial(
        name=path.name, start=0.0, duration=float(time[-1]), command=None,
        observed={
            "position": Observed(("x", "y"), "m", time),
            "heading": Observed(("heading",), "rad", time),
            "speed": Observed(("speed",), "m/s", time),
            "command": Observed(("speed", "steering"), "", time),
        },
        initial={
            "position": Channel("position", ("x", "y"), "m", start, rear[None]),
            "heading": Channel("heading", ("heading",), "rad", start, np.array([[heading]])),
            "speed": Channel("speed", ("speed",), "m/s", start, np.zeros((1, 1))),
        },
        references={"path": path.reference()},
        notes=(
            "Position and heading are those of the middle of the rear axle; angles grow to the left (counter-clockwise).",
            "What is commanded: speed of the wheels in m/s, steering angle in rad.",
            f"The run ends when the front axle, {settings.wheelbase:.4g} m ahead of it, has reached the path's last point.",
            "Keep the log going until that point is passed and the robot stands: what of the path was not reached counts",
            "in the score as far from it as it lies.",
        ),
    )  # fmt: skip


def too_tight(path: Path, settings: StanleySettings) -> str:
    """A sentence where a path turns more tightly than the front axle can, for longer than the vehicle, or back; else ''.

    Curvature is the mean along a wheelbase: points that are rounded to a millimetre bend a path that does not.
    """
    most = float(np.sin(min(settings.max_steering, 0.5 * np.pi))) / settings.wheelbase
    ahead = np.interp(path.arc + settings.wheelbase, path.arc, path.heading)
    curvature = np.abs(ahead - path.heading) / settings.wheelbase
    if settings.wheelbase * curvature.max() > _BACK:
        x, y = path.points[int(curvature.argmax())]
        where = f"path '{path.name}' turns back on itself near x = {x:.3g}, y = {y:.3g} m"
        return f"{where}, and is followed forward only: give the sections ahead and back as paths of their own"
    first, behind = stretches_of(curvature > most * (1.0 + PRINTED)).T
    # A corner alone is beyond it from a wheelbase before.
    runs = path.arc[behind - 1] - path.arc[first]
    beyond = float(runs[runs > settings.wheelbase * (1.0 + PRINTED)].sum())
    if not beyond:
        return ""
    tightest = float(curvature.max())
    return (
        f"path '{path.name}' turns more tightly than the vehicle can along {beyond:.3g} of its {path.length:.3g} m "
        f"(radius {1.0 / tightest:.3g} m; a front axle {settings.wheelbase:.3g} m ahead that steers by "
        f"{settings.max_steering:.3g} rad drives {1.0 / most:.3g} m): whatever the gains, it leaves the path "
        "there. Give a wider path, or mend wheelbase (m) and max_steering (rad)"
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(driven: Array, path: Array, ahead: float, spare: float, measure: int) -> Array:
    """(b, 2) distance of driven points (b, T, 2) from the path, each metre of path counting alike, and what was not reached
    of it, but for its last `spare` m, in m.
    """
    out = np.empty((driven.shape[0], 2))
    memory = np.empty(MEMORY)
    length = path[path.shape[0] - 1, 5]
    for row in range(driven.shape[0]):
        memory[:] = 0.0
        total, largest, before, seen = 0.0, 0.0, 0.0, False
        for k in range(driven.shape[1]):
            x, y = driven[row, k, 0], driven[row, k, 1]
            if not (np.isfinite(x) and np.isfinite(y)):
                continue
            was = memory[ARC]
            i, t = nearest(path, x, y, ahead, memory)
            dx = path[i, 0] + t * (path[i + 1, 0] - path[i, 0]) - x
            dy = path[i, 1] + t * (path[i + 1, 1] - path[i, 1]) - y
            d = np.sqrt(dx * dx + dy * dy)
            gone = memory[ARC] - was
            # Trapezes between samples; the first sample counts for what it has skipped.
            total += (
                gone * (d if measure == 1 else d * d)
                if not seen
                else 0.5 * gone * (d + before if measure == 1 else d * d + before * before)
            )
            # Once the end is reached the robot may stop a little beyond it.
            largest = max(largest, d) if gone > 0.0 else largest
            before, seen = d, True
        missing = max(length - memory[ARC] - spare, 0.0)
        out[row, 1] = missing
        if not seen:
            out[row] = np.nan
        elif measure == 2:
            out[row, 0] = max(largest, LOST) if missing > 0.5 else largest
        else:
            mean = (total + _beyond(missing, before, 2 - measure)) / (memory[ARC] + missing)
            out[row, 0] = mean if measure == 1 else np.sqrt(mean)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(missing: float, before: float, power: int) -> float:
    """Integral, over `missing` m of path that was not reached, of the distance to the power.

    The distance is that at the run's end, `before` (m), at least, else how far on the path lies, `LOST` at most.
    """
    if before >= LOST:
        return missing * before**power
    flat, near = min(missing, before), min(missing, LOST)
    rising = (max(near, flat) ** (power + 1) - flat ** (power + 1)) / (power + 1)
    return flat * before**power + rising + (missing - near) * LOST**power
