# SPDX-License-Identifier: Apache-2.0
"""Whether the torque of joints, logged in N m, is scaled differently from joint to joint, as sensors and drives may be.

A scale of a joint's own is no part of a model of measured torque unless it is asked for, since it may stand for something
else; but what a fit then says of masses hangs on it. It is asked beside the model that was chosen, as a score test.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trueup.arrays import Array
from trueup.evidence import Evidence, half_interval, jackknife
from trueup.identification.estimation.beside_choice import (
    left_out_errors,
    links_of,
    solved,
    solved_without_each,
    with_columns,
)
from trueup.identification.estimation.modelled import Modelled, fitted_blocks
from trueup.identification.estimation.moments import moments_of
from trueup.identification.estimation.motion import Motion
from trueup.identification.estimation.selection import compared
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics


def own_scales(modelled: Modelled, scaled: Callable[[], Modelled], margin: float) -> list[str]:
    """What is said where left-out blocks are predicted clearly better with scales of the joints' own: which, and what to do.

    `scaled` makes the model that may have them; `margin` is in s, what is left out at the borders of blocks.
    """
    pool, _, _, (_, _, _, choice) = modelled
    if "gain" in pool.groups or pool.model.tree.n < 2 or not _asked_for(modelled, margin):
        return []
    wide, _, _, (pieces, links, moments, found) = scaled()
    evidence = found.against(choice)
    gains = list(wide.groups["gain"])
    if not evidence.holds or not found.active[gains].any():
        return []
    active, tree = np.flatnonzero(found.active), wide.model.tree
    kept = np.isin(active, gains)
    drives = np.searchsorted(gains, active[kept])
    own, each = np.ones(tree.n), np.ones((len(moments.count), tree.n))
    own[drives] += solved(moments, found, active)[kept]
    each[:, drives] += solved_without_each(moments, found, active)[:, kept]
    # All scales together are one of the links: only quotients are told. The joint that carries most is the measure.
    most = int(np.argmax(sum(np.sum(_carried(tree, links, p.motion) ** 2, axis=0) for p in pieces)))
    half = half_interval(len(each)) * jackknife(each / each[:, [most]])
    return _in_words(tree.joints, tree.joints[most], own / own[most] - 1.0, half, evidence)


def _asked_for(modelled: Modelled, margin: float) -> bool:
    """Whether scales beside the model that was chosen without them predict left-out blocks clearly better."""
    pool, _, _, (pieces, _, _, choice) = modelled
    tree, fitted = pool.model.tree, [p for p in pieces if not p.held_out]
    links = links_of(pool, moments_of(fitted_blocks(fitted, margin)), choice)

    def carried_load(motion: Motion) -> Array:
        return _carried(tree, links, motion)[:, :, None] * np.eye(tree.n)

    moments = moments_of(fitted_blocks(with_columns(fitted, np.flatnonzero(choice.active), carried_load), margin))
    every = np.arange(len(moments.scale))
    plain, free = left_out_errors(moments, choice, [every[: -tree.n], every])
    return compared(free, plain).holds


def _carried(tree: KinematicTree, links: Array, motion: Motion) -> Array:
    """(S, n) torque of links (n, 10)."""
    return inverse_dynamics(tree, links, motion.q, motion.v, motion.a)


def _in_words(joints: tuple[str, ...], most: str, own: Array, half: Array, evidence: Evidence) -> list[str]:
    """Shares (n,) by which each joint's torque is larger than on the scale of `most`, and half their intervals."""
    sure = [
        f"{joint} {100.0 * value:+.2g} +- {100.0 * wide:.1g} %"
        for joint, value, wide in zip(joints, own, half, strict=True)
        if abs(value) > wide
    ]
    if not sure:
        return []
    return [
        f"the torque of joints seems to be scaled differently, against {most} {', '.join(sure)} (errors on stretches "
        f"that were left out are {evidence.in_words()}): sensors or torque constants that were not calibrated alike, or "
        "something else that grows with the load. Masses and centres of mass below may be off by as much, beyond their "
        "intervals. --gains takes these scales into the model; a weighed payload tells them best"
    ]
