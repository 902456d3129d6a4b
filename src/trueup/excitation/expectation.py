# SPDX-License-Identifier: Apache-2.0
"""How well a trajectory will identify each parameter combination, before it is run, and which motion would help.

From the information matrix, what a fit knows beforehand (possible bodies, near the file's) and the errors that it will
leave. What the model misses (elasticity, ripple, friction of another form) lasts for some time, unlike noise: what counts is
the power density of all errors at the frequencies of the motion, as earlier fits left it, of other arms or, better, of this
one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trueup import files
from trueup.arrays import Array
from trueup.errors import ModelError
from trueup.excitation.criteria import Criterion
from trueup.excitation.limits import JointLimits
from trueup.excitation.periodic import Fourier
from trueup.excitation.trajectories import Motions, Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.consistent import NEAREST, prior_information
from trueup.rounding import ROUNDED, TINY

_FRICTION = 0.05
"""Share of nominal torque that each friction of an industrial arm takes (at top speed, where it grows with speed)."""


_BAND = 5.0
"""Hz below which errors are as dense as they are said to be: of so many independent ones a fit weighs the file against."""
DENSITY = 2.6e-6
"""Two-sided power density of a fit's errors at low frequencies, in squares of nominal torque per Hz: 0.5 % of nominal
below 5 Hz. What `identify` left of the real logs of TX40, UR10 and Panda (1.44, 1.45 and 0.07 of 5e-6, geometric means of
their joints), in the geometric mean: arms differ by a factor of four either way."""


def densities_of(folder: str | Path, joints: Sequence[str]) -> Array:
    """(n,) what an earlier identification of the same arm left, (N m)^2/Hz; `folder` is what `trueup identify` wrote.

    Raises ModelError where it is of another arm or an older version.
    """
    file = Path(folder) / "identification.json"
    try:
        found = json.loads(files.text(file, ModelError))
        known = dict(zip(found["joints"], map(float, found["error_density"]), strict=True))
        return np.array([known[joint] for joint in joints])
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"'{file}' does not say which errors were left for {', '.join(joints)} ({error}); identify this arm again"
        ) from None


@dataclass(frozen=True)
class Expected:
    """One parameter combination: the standard deviation that its estimate will have."""

    name: str
    """The combination as a sum of parameters."""
    leading: str
    """The parameter that stands for it."""
    unit: str
    value: float
    """By the model file; NaN where that is not known."""
    deviation: float
    size: float
    """What the deviation is compared with: the value, or a typical one of its kind where that is larger or unknown."""
    advice: str = ""
    """What would help, where it is seen worse than asked."""

    @property
    def percent(self) -> float:
        """The deviation in % of the size."""
        return 100.0 * self.deviation / self.size


def expectations(
    criterion: Criterion, trajectory: Trajectory, limits: JointLimits, density: Array | None = None, *, percent: float = 5.0
) -> tuple[Expected, ...]:  # fmt: skip
    """What will be known of each base combination after one run of a trajectory, the worst first.

    `density` (n,): of the errors that will be left, (N m)^2/Hz; None takes what other arms' fits left, see DENSITY. Offsets
    of the drives are as unknown as in a fit: they hide behind gravity.
    What the file says of bodies counts as in a fit, which is drawn to them; a file without inertias says nothing.
    `percent`: combinations that are seen worse get advice, from what wide motions of the same length would see.
    """
    assumed, model = DENSITY * criterion.torque**2 if density is None else density, criterion.model
    deviation = _deviations(criterion, as_motions(trajectory), trajectory.duration, assumed)
    base = model.base()
    place = {int(k): i for i, k in enumerate(base.independent)}
    grouping = base.grouping[[place[int(k)] for k in criterion.independent]]
    try:
        values = grouping @ np.where(np.isnan(known := model.nominal()), 0.0, known)
    except ModelError:
        values = np.full(len(grouping), np.nan)
    typical, names = _typical(model, criterion.torque, limits), base.names
    wide = _wide(criterion, limits, trajectory.duration, assumed)
    found = []
    for i, k in enumerate(criterion.independent.tolist()):
        value = float("nan") if model.friction[k] else float(values[i])
        size = max(abs(value) if np.isfinite(value) else 0.0, float(typical[k]))
        told = 100.0 * deviation[i] / size > percent
        advice = (
            _advice(model, k, float(deviation[i] / wide[i]), float(100.0 * wide[i] / size), percent) if told else ""
        )
        found.append(
            Expected(names[place[k]], model.names[k], model.units[k], value, float(deviation[i]), size, advice)
        )
    return tuple(sorted(found, key=lambda e: -e.percent))


def _deviations(criterion: Criterion, motions: Motions, seconds: float, density: Array) -> Array:
    """(c,) standard deviations of the base parameters, from the mean information of some motions over `seconds`."""
    known, n = criterion.model, criterion.model.tree.n
    model = replace(known, effects=(*known.effects, *((d, Effect("offset")) for d in range(n))))
    base, weighed = known.base(), bool(np.isfinite(known.tree.inertial).all())
    own = np.union1d(np.flatnonzero(~known.friction), criterion.independent) if weighed else criterion.independent
    columns = np.concatenate([own, known.p + np.arange(n)])
    M = model.information(motions.q, motions.qd, motions.qdd, density**-0.5, columns).mean(axis=0)
    M *= seconds / motions.q.shape[1]
    if weighed:
        M += NEAREST * 2.0 * _BAND * seconds * n * prior_information(model, model.nominal())[np.ix_(columns, columns)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(M), TINY))
    values, vectors = np.linalg.eigh(M * scale[:, None] * scale)
    place = {int(k): i for i, k in enumerate(base.independent)}
    grouping = np.pad(base.grouping, ((0, 0), (0, n)))[[place[int(k)] for k in criterion.independent]]
    across = (grouping[:, columns] * scale) @ vectors
    # A direction that is not seen at all has no finite deviation; this floor is far beyond any use.
    return np.sqrt((across**2 / np.maximum(values, 1e-14)).sum(axis=1))


def _wide(criterion: Criterion, limits: JointLimits, seconds: float, density: Array) -> Array:
    """(c,) the deviations after random motions over the whole range, of the same length."""
    kind = Fourier(limits.within(range_share=0.9), max(8.0, min(seconds, 20.0)), 6)
    motions = kind.motions(np.random.default_rng(0).uniform(size=(12, kind.size)), 300)
    return _deviations(criterion, motions, seconds, density)


def as_motions(trajectory: Trajectory) -> Motions:
    """The trajectory thinned out, as a criterion takes it."""
    t = trajectory.thinned(3000)
    return Motions(t.time[None], t.q[None], t.qd[None], t.qdd[None])


def _typical(model: DynamicModel, torque: Array, limits: JointLimits) -> Array:
    """(p,) sizes of the parameters one by one, from masses and extents of the links and from nominal torques.

    A product of inertia of zero cannot be known to 5 % of itself; to 5 % of the moments beside it is what counts.
    """
    size = np.ones(model.p)
    inertial = np.nan_to_num(model.tree.inertial)
    for k in range(model.p):
        j, effect = model.effect(k)
        if effect is None:
            mass, moment = abs(inertial[j, 0]), float(np.abs(inertial[j, [4, 6, 9]]).max())
            size[k] = (mass, np.sqrt(mass * moment), moment)[0 if k % 10 == 0 else 1 if k % 10 < 4 else 2]
        elif model.friction[k]:
            size[k] = _FRICTION * torque[j] / limits.speed[j] ** effect.power
        else:  # a rotor that takes a fifth of the nominal torque at the acceleration limit
            size[k] = 0.2 * torque[j] / limits.acceleration[j]
    return np.maximum(size, ROUNDED)


def _weighs(model: DynamicModel, column: int) -> bool:
    """Whether a combination makes any torque in an arm that stands still."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (20, model.tree.n))
    still = np.zeros_like(q)
    torque = model.rows(np.arange(20.0), q, still, still).dense()[:, :, column]
    return bool(np.abs(torque).max() > ROUNDED)


def _advice(model: DynamicModel, column: int, gain: float, wide_percent: float, percent: float) -> str:
    """What would bring a combination nearer to what was asked; `gain`: how much better wide motions see it."""
    drive, n = model.effect(column)[0], model.tree.n
    joint = model.tree.joints[drive]
    if gain > 2.0 and wide_percent <= 2.0 * percent:
        return "wide motions over the whole range see it several times better"
    if model.friction[column]:
        return "add runs of the same path at other speeds, or longer ones: that parts the terms of friction"
    if drive >= n - 2 or model.names[column].startswith(f"I{drive + 1}"):
        if drive >= n - 3:
            return "carry a payload to see it: without one it makes hardly any torque"
        return f"accelerate {joint} and its neighbours harder"
    if not _weighs(model, column):  # about an upright axis, as a SCARA's
        return f"move {joint} and its neighbours fast in more postures: gravity does not show it"
    return f"hold {joint} in more postures, so that gravity tells it"
