# SPDX-License-Identifier: Apache-2.0
"""Whether a robot's feet slide by what was recorded: legs exchanged, joints that turn the other way, a treadmill."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION, headed, in_angles, quaternion_of
from trueup.evidence import EXCERPT, HALVED
from trueup.recording import Recording
from trueup.trial import LOOK

STRIDE = 0.2
"""s over which ways and turns are compared: noise is small beside them, and no gait is as quick."""
_AHEAD = round(STRIDE / LOOK)
_SLIPS = 0.2
"""Of how far the base went: less makes nobody wrong, and is not looked into."""


@dataclass(frozen=True, eq=False)
class Legs:
    """What hangs on a base, and where that goes if feet stand still."""

    joints: tuple[str, ...]
    limbs: Sequence[Sequence[int]]
    """The joints of each limb by their numbers, from the base on."""
    places: Sequence[Array]
    """(2,) of each limb: where it begins, x and y in m."""
    path: Callable[[Array, Array], tuple[Array, Integers]]
    """Of joints at poses (T, k) and a base turned by quaternions (T, 4): (T, 3) where the base is in m, and (T,) the bodies
    on which it stood."""


@dataclass(frozen=True, eq=False)
class _Walk:
    """Joints (T, k) in the order of the robot's, quaternions (T, 4) and places (T, 3) of its base."""

    poses: Array
    turns: Array
    places: Array


def sliding(legs: Legs | None, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence where the base goes elsewhere than feet that stand still would take it, and agrees with these once two legs
    are exchanged, all of both sides are, or one joint turns the other way. () where nothing else agrees clearly better.
    """
    walks = [] if legs is None else _walks(legs.joints, recordings)
    if legs is None or not walks:
        return ()
    count = len(legs.joints)
    if belts := _belts(legs, walks):
        return (belts,)
    went = np.array([_size(w.places[_AHEAD:] - w.places[:-_AHEAD]) for w in walks])
    errors, stood = _stepped(legs, walks, np.arange(count), np.ones(count))
    if not np.any(errors > _SLIPS * went):
        return ()
    worst, better = int(np.argmax(errors / (went + errors))), {}
    for words, (order, signs) in _ways(legs).items():
        looked, _ = _stepped(legs, [walks[worst]], order, signs)
        if looked[0] ** 2 > HALVED * errors[worst] ** 2:  # of made-up robots that slip, 0.72 by chance
            continue
        found, feet = _stepped(legs, walks, order, signs)
        # A leg that is in the air all along shows nothing, and hides what was wrong with it.
        if feet >= stood and _size(found) < _size(errors):
            better[words] = found
    if not better:
        return ()
    least = min(map(_size, better.values()))  # what one leg shows tells seldom whether others were mixed up, too
    best = [w for w in sorted(better, key=lambda words: _size(better[words])) if HALVED * _size(better[w]) <= least]
    ways = ", or by ".join(f"{1e3 * _size(better[words]):.1f} mm if {words}" for words in best)
    return (
        f"by joints and base the feet slide: within {STRIDE:g} s the base goes elsewhere than feet that stand still "
        f"would take it by {1e3 * _size(errors):.1f} mm, and by {ways}: were they mixed up in the log? Mend the mapping, or "
        "the model",
    )


def _belts(legs: Legs, walks: Sequence[_Walk]) -> str:
    """A sentence where all feet go over the floor alike while the base stays where it is, as on a treadmill; '' elsewhere."""
    speeds = []
    for walk in walks:
        by_feet, _ = legs.path(walk.poses, walk.turns)
        beside = (by_feet - walk.places)[:, :2]
        apart = beside[_AHEAD:] - beside[:-_AHEAD]
        stays = np.hypot(*(walk.places[-1] - walk.places[0])[:2]) < _SLIPS * np.hypot(*(by_feet[-1] - by_feet[0])[:2])
        if stays and _size(apart - apart.mean(axis=0)) ** 2 < HALVED * _size(apart) ** 2:
            speeds.append(float(np.hypot(*apart.mean(axis=0))) / STRIDE)
    if 2 * len(speeds) <= len(walks):
        return ""
    return (
        f"by joints and base all feet go over the floor alike, at about {np.median(speeds):.2g} m/s, and the base stays: "
        "does the robot walk on a treadmill? The model's floor stands still, where the fit would blame friction. Log "
        f"{POSITION} as the belt sees it (add how far that has run), or leave it out: where the base was is then reckoned "
        "from its feet"
    )


def _walks(names: Sequence[str], recordings: Sequence[Recording]) -> list[_Walk]:
    """What recordings that tell all joints and the base show, up to `EXCERPT` s: what is mixed up is so in every motion."""
    found, left = list[_Walk](), round(EXCERPT / LOOK)
    for recording in map(in_angles, recordings):
        if not all(recording.has(name) for name in ("position", POSITION, ORIENTATION)) or left < 2 * _AHEAD:
            continue
        joints, place, turn = (recording.channel(name) for name in ("position", POSITION, ORIENTATION))
        whole = set(names) <= set(joints.labels) and set(AXES) <= set(place.labels) and turn.labels == ANGLES
        if not whole:
            continue
        time = np.arange(recording.start, recording.stop, LOOK)[:left]
        poses, places = joints.select(names).at(time), place.select(AXES).at(time)
        turns = headed(turn.at(time))
        good: Mask = np.asarray(np.isfinite(np.hstack([poses, places, turns])).all(axis=1))
        if np.count_nonzero(good) > 2 * _AHEAD and good[good.argmax() : len(good) - good[::-1].argmax()].all():
            found.append(_Walk(poses[good], quaternion_of(turns[good]), places[good]))
            left -= len(time)
    return found


def _stepped(legs: Legs, walks: Sequence[_Walk], order: Integers, signs: Array) -> tuple[Array, int]:
    """How far, in m, the base goes elsewhere in each walk than feet that stand still take it, if joints were recorded in
    this order and with these signs, and on how many bodies it stood.
    """
    beside, bodies = [], set[int]()
    for walk in walks:
        by_feet, stood = legs.path(signs * walk.poses[:, order], walk.turns)
        beside.append(_size((by_feet - walk.places)[_AHEAD:] - (by_feet - walk.places)[:-_AHEAD]))
        bodies |= set(stood.tolist())
    return np.array(beside), len(bodies)


def _size(ways: Array) -> float:
    """Root mean square length of vectors (n, 3), or of numbers (n,)."""
    return float(np.sqrt(np.sum(ways**2) / len(ways)))


def _ways(robot: Legs) -> Mapping[str, tuple[Integers, Array]]:
    """What may have been mixed up, in words: which joint each column is of, and its sense."""
    joints, places = robot.joints, robot.places
    legs = [list(limb) for limb in robot.limbs]
    ways: dict[str, tuple[Integers, Array]] = {}
    same, count = np.arange(len(joints)), len(joints)
    for words, flip in (("left and right are exchanged", (1, -1)), ("front and rear are exchanged", (-1, 1))):
        order = same.copy()
        for leg, place in zip(legs, places, strict=True):
            others = [k for k, other in enumerate(legs) if len(other) == len(leg)]
            other = legs[min(others, key=lambda k: float(np.linalg.norm(places[k] - place * flip)))]
            order[leg] = other
        if sorted(order) == list(same) and any(order != same):
            ways[words] = (order, np.ones(count))
    for one, other in itertools.combinations(legs, 2):
        if len(one) == len(other):
            order = same.copy()
            order[one], order[other] = other, one
            a, b = (", ".join(joints[i] for i in leg) for leg in (one, other))
            ways.setdefault(f"{a} are exchanged for {b}", (order, np.ones(count)))
    for i, joint in enumerate(joints):
        ways[f"'{joint}' turns the other way"] = (same, np.where(same == i, -1.0, 1.0))
    return ways
