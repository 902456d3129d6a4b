# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a log, said before or after a fit that cannot be good: units, order of joints, signs, standstill."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import IdentificationError, listed
from trueup.evidence import HALVED, evidence
from trueup.identification.estimation.motion import Log, Motion
from trueup.identification.kinematic_tree import KinematicTree
from trueup.inspection.ranges import shorter
from trueup.instant import STILL
from trueup.units import FURTHEST_TURN, numbers_of

DOUBTFUL, POOR = 0.1, 0.35
"""Relative errors of a fit from which on simple mistakes are looked for, and from which on it is said to be poor."""
_SLIGHTLY, _MUCH = 0.9, 0.1
"""Of the error that may be left, in place of `HALVED`, where friction would drive joints with more than this share of their
torque: chance does not do that."""
AS_GOOD = 1.1
"""Times an error that is as good."""

_SMALLER = {
    "torque": 'If it is in thousandths, say unit = "mN m" in the mapping; if it is a current, rename the channel and give '
    "torque constants in a drives file",
    "current": 'If it was logged in mA, say unit = "mA" in the mapping; else look at ratio and torque_constant in the drives '
    "file",
}
"""What mends numbers that are too large, by the channel that torque comes from."""

_RECORDING = re.compile(r"recording '([^']*)'")

Errors = tuple[Array, ...]
"""Squared relative errors of a basic model: (1,) as fitted, then for ever finer cuts (K,) of parts foretold by the others."""
Fit = Callable[[Motion], Errors]


@dataclass(frozen=True, eq=False)
class Suspicion:
    """A mistake in a log that would explain its torque, and what the log says of it."""

    sentence: str
    before: Errors
    """Of the log as it is."""
    after: Errors
    """Of the log with the mistake taken out."""
    enough: float = HALVED
    """Of the error that may be left."""
    sure: bool = False
    """Whether nature says so, whatever is left."""

    @property
    def likely(self) -> bool:
        """Whether half of the squared error goes with the mistake, of the log and of parts of it that are left out."""
        return self.certain or self._better(np.sqrt(HALVED))

    @property
    def certain(self) -> bool:
        """Whether they are explained much better, and then not poorly: a log of which this holds is refused.

        Of a short or narrow log parts are foretold badly whatever is wrong with it: of many mistakes that could be taken
        out some do better by chance in one cut, hardly one in all of them and well.
        """
        return self.sure or (self._better(self.enough) and bool(self.after[-1].sum() < POOR**2))

    def _better(self, share: float) -> bool:
        """Whether no more than a share of the error is left in any cut, by the rule of evidence where there are parts."""
        cuts = [(np.sqrt(b), np.sqrt(a)) for b, a in zip(self.before, self.after, strict=True)]
        return all(
            np.sum(a**2) < share**2 * np.sum(b**2) and (len(b) == 1 or evidence(b, a, b**2).holds) for b, a in cuts
        )

    def __str__(self) -> str:
        """In words."""
        before, after = (100.0 * float(np.sqrt(each[0].sum())) for each in (self.before, self.after))
        if self.sure:
            how = f"turned, it is explained as well ({after:.2g} % of the torque is left), and friction brakes"
            return f"{self.sentence}: {how}"
        return f"{self.sentence}: the error would go from {before:.2g} % to {after:.2g} % of the torque"


def check_log(log: Log, tree: KinematicTree, *, judged: bool = False) -> list[str]:
    """What to mind in a log that is fitted, or only `judged`. Raises IdentificationError for what makes it meaningless."""
    span, notes = np.ptp(log.position, axis=0), []
    if np.all(span < STILL) and judged:
        return [
            f"recording '{log.name}': no joint moves; it judges gravity alone, and friction may hold a part of the load"
        ]
    if np.all(span < STILL):
        raise IdentificationError(
            f"recording '{log.name}': no joint moves (the largest span is {span.max():.2g} rad). A dynamic model needs "
            "motion of every joint: `trueup excite` designs one"
        )
    _check_angles(log, tree)
    _check_torque(log, tree)
    still = [joint for joint, s in zip(tree.joints, span, strict=True) if s < STILL]
    if still:
        notes.append(
            f"recording '{log.name}': {', '.join(still)} hardly moves; what depends on its motion cannot be told from it"
        )
    flat = [joint for joint, s in zip(tree.joints, np.ptp(log.torque, axis=0), strict=True) if s == 0.0]
    if flat:
        raise IdentificationError(
            f"recording '{log.name}': the torque of {', '.join(flat)} never changes; is it in this log? Lock joints "
            f"without torque: --lock {' '.join(flat)}"
        )
    return notes


def grouped(sentences: Iterable[str]) -> list[str]:
    """Sentences on recordings, those that say the same of several as one, with the numbers of the first."""
    alike: dict[str, list[tuple[str, str]]] = {}
    for sentence in dict.fromkeys(sentences):
        name = _RECORDING.search(sentence)
        key = re.sub(r"\d[\d.e+-]*", "0", _RECORDING.sub("", sentence))
        alike.setdefault(key, []).append((sentence, name[1] if name else ""))
    made = []
    for (sentence, _), *more in alike.values():
        names = list(dict.fromkeys(name for _, name in more if name))
        made += [f"{sentence}; likewise in {listed(names)}"] if names else [sentence, *(other for other, _ in more)]
    return made


def _check_angles(log: Log, tree: KinematicTree) -> None:
    turning = ~np.asarray(tree.prismatic)
    reached = np.where(turning, np.abs(log.position).max(axis=0), 0.0)
    allowed = np.fmax(np.fmax(np.abs(tree.lower), np.abs(tree.upper)), np.pi)
    worst = int(np.argmax(reached / np.fmax(allowed, np.pi)))
    if reached[worst] > max(FURTHEST_TURN, 1.5 * float(np.nan_to_num(allowed[worst], nan=FURTHEST_TURN))):
        raise IdentificationError(
            f"recording '{log.name}': {tree.joints[worst]} reaches {reached[worst]:.4g} rad. If these are degrees, say "
            f"{_units(log, tree, 'deg')} for position in the mapping; if they are angles of motors before their gears, say "
            "so in a drives file (--drives, `trueup identify --help` shows one)"
        )
    for joint in _shorter(log, tree):
        j = tree.joints.index(joint)
        low, high = log.position[:, j].min(), log.position[:, j].max()
        raise IdentificationError(
            f"recording '{log.name}': {joint} slides from {low:.4g} to {high:.4g} m; its "
            f"range in the model is {tree.lower[j]:g} to {tree.upper[j]:g} m. If it was logged in mm, say "
            f"{_units(log, tree, 'rad')} for position in the mapping"
        )


def _shorter(log: Log, tree: KinematicTree) -> list[str]:
    """Slides that were measured far beyond their range in the model, and lie in it as mm or cm."""
    known = np.flatnonzero(tree.prismatic & np.isfinite(tree.lower + tree.upper))
    low, high = log.position.min(axis=0), log.position.max(axis=0)
    ends = {int(j): (float(tree.lower[j]), float(tree.upper[j])) for j in known}
    return [tree.joints[j] for j, both in ends.items() if shorter(both, float(low[j]), float(high[j]))]


def _units(log: Log, tree: KinematicTree, turned: str) -> str:
    """The line of a mapping that says that hinges are in `turned`, and what slides are in beside them."""
    if not tree.prismatic.any():
        return f'unit = "{turned}"'
    short, slides = _shorter(log, tree), dict(zip(tree.joints, tree.prismatic, strict=True))
    units = ", ".join(f'"{"mm" if j in short else "m" if slides[j] else turned}"' for j in tree.joints)
    return f"units = [{units}] (of {', '.join(tree.joints)}: one for each label)"


def _check_torque(log: Log, tree: KinematicTree) -> None:
    reached, effort = np.abs(log.torque).max(axis=0), np.asarray(tree.effort)
    known = np.isfinite(effort) & (effort > 0.0)
    if known.any():
        ratio = float(np.median(reached[known] / effort[known]))
        if ratio**2 > numbers_of("mN m"):  # nearer to thousandths
            worst = int(np.argmax(np.where(known, reached / np.where(known, effort, 1.0), 0.0)))
            raise IdentificationError(
                f"recording '{log.name}': {log.channel} of {tree.joints[worst]} reaches {reached[worst]:.4g} N m, "
                f"{reached[worst] / effort[worst]:.3g} times its limit of {effort[worst]:g} N m in the model. "
                f"{_SMALLER.get(log.channel, _SMALLER['torque'])}"
            )


def mistakes(motion: Motion, tree: KinematicTree, fit: Fit) -> Suspicion:
    """The simple mistake that, taken out, lets parts that are left out be foretold best."""
    before = fit(motion)
    tried = (Suspicion(said, before, fit(changed)) for said, changed in _candidates(motion, tree))
    return min(tried, key=lambda s: s.after[-1].sum())


def signs(motion: Motion, tree: KinematicTree, driven: Mapping[int, float], fit: Fit) -> Suspicion:
    """Joints that friction seems to drive: their torques, or else their positions, have the wrong sign.

    `driven` has the share of a joint's torque that seems to be such friction. Where it is small much has to be explained
    better: sensors behind gears see little of it.
    """
    sign = np.ones(tree.n)
    sign[list(driven)] = -1.0
    turned = replace(motion, q=motion.q * sign, v=motion.v * sign, a=motion.a * sign)
    before, torque, position = fit(motion), fit(replace(motion, torque=motion.torque * sign)), fit(turned)
    least, most = sorted(float(np.sqrt(each[0].sum())) for each in (torque, position))
    channel, after = ("torque", torque) if torque[0].sum() <= position[0].sum() else ("position", position)
    if most < AS_GOOD * least:
        channel = "torque or the position"
    everywhere = len(driven) == tree.n and least < AS_GOOD * float(np.sqrt(before[0].sum()))
    names = ", ".join(tree.joints[j] for j in driven)
    said = (
        f"the {channel} of {names} seems to have the wrong sign, since friction would drive what it should brake (sign = -1 "
        "in the mapping)"
    )
    return Suspicion(said, before, after, _SLIGHTLY if min(driven.values()) > _MUCH else HALVED, everywhere)


def _candidates(motion: Motion, tree: KinematicTree) -> Iterator[tuple[str, Motion]]:
    joints, n = tree.joints, tree.n
    degrees = np.where(tree.prismatic, 1.0, np.radians(1.0))
    scaled = replace(motion, q=motion.q * degrees, v=motion.v * degrees, a=motion.a * degrees)
    yield 'positions seem to be in degrees (unit = "deg" in the mapping)', scaled
    for j in range(n):
        sign = np.where(np.arange(n) == j, -1.0, 1.0)
        yield (
            f"the torque of {joints[j]} seems to have the wrong sign (sign = -1 in the mapping)",
            replace(motion, torque=motion.torque * sign),
        )
        yield (
            f"the position of {joints[j]} seems to have the wrong sign (sign = -1 in the mapping)",
            replace(motion, q=motion.q * sign, v=motion.v * sign, a=motion.a * sign),
        )
    for i, j in itertools.combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield (
            f"the torques of {joints[i]} and {joints[j]} seem to be exchanged",
            replace(motion, torque=motion.torque[:, order]),
        )
        yield (
            f"the joints {joints[i]} and {joints[j]} seem to be exchanged (order of columns)",
            replace(
                motion, q=motion.q[:, order], v=motion.v[:, order], a=motion.a[:, order], torque=motion.torque[:, order]
            ),
        )
    yield (
        "the joints seem to be in reverse order",
        replace(motion, q=motion.q[:, ::-1], v=motion.v[:, ::-1], a=motion.a[:, ::-1], torque=motion.torque[:, ::-1]),
    )
