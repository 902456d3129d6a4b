# SPDX-License-Identifier: Apache-2.0
"""Brings logs and a tree together: columns get the joints' names, joints that no log has are locked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.errors import UnknownNameError, unknown_name
from trueup.identification.estimation.torque_choice import with_one_torque
from trueup.identification.estimation.unnamed import named_by_motion
from trueup.identification.kinematic_tree import KinematicTree
from trueup.inspection.joint_names import plain_name as plain_name
from trueup.inspection.joint_names import sure_names
from trueup.inspection.scales import Way, with_units
from trueup.inspection.scattered import gathered
from trueup.instant import STILL
from trueup.recording import Recording

_CHANNELS = ("position", "velocity", "torque", "current", "load")

Groups = tuple[list[Recording], list[Recording]]


def matched(
    whole: KinematicTree, groups: Groups, torque: str = "", lock: Sequence[str] = (), *, at_motors: bool = False
) -> tuple[KinematicTree, Groups, tuple[str, ...]]:
    """Recordings with the joints' names of the model, the tree with joints locked that no log has, or that are named in
    `lock`, and what was done.

    Columns that only count are those of all joints, also of those to be locked, or else of the others. Joints are found as
    `inspection.joint_names.sure_names` does, columns without names as `unnamed` does, the torque that is fitted as
    `torque_choice` does, or the one that `torque` names. Positions without a unit are in rad, or in degrees where they fit
    the joints' ranges only so, unless they are `at_motors`. Raises UnknownNameError where no joint is found,
    IdentificationError where columns without names fit no joint, or it is open which torque was measured.
    """
    tree = whole.lock(lock)
    training, apart = gathered(groups[0], whole.joints, filled=True)
    groups = (training, gathered(groups[1], whole.joints, filled=True)[0])
    named = [[named_by_motion(tree, r, torque) for r in group] for group in groups]
    bare = {r.name for group in named for r, note in group if note}  # their torque is chosen already
    groups = ([r for r, _ in named[0]], [r for r, _ in named[1]])
    labels = list(
        dict.fromkeys(x for group in groups for r in group if r.has("position") for x in r.channel("position").labels)
    )
    names, notes = (
        _names_of_either(whole, tree, labels),
        [*apart, *dict.fromkeys(note for group in named for _, note in group if note)],
    )
    changed = {old: new for old, new in names.items() if old != new}
    if changed and any(plain_name(new) not in plain_name(old) for old, new in changed.items()):
        said = ", ".join(f"{old} -> {new}" for old, new in changed.items())
        notes.append(f"columns were taken as joints in the model's order, which nothing here can prove: {said}")
    notes += _elsewhere(groups, {old: new for old, new in names.items() if new in lock})
    missing = [joint for joint in tree.joints if joint not in names.values()]
    if missing and names:
        notes.append(f"no log has {', '.join(missing)}: locked at zero{_strange(names, labels, missing)}")
        tree = tree.lock(missing)
    one = [
        [with_one_torque(_renamed(r, tree, changed), tree, "" if r.name in bare else torque) for r in group]
        for group in groups
    ]
    notes += dict.fromkeys(note for group in one for _, note in group if note)
    every = [r for group in one for r, _ in group]
    taken, said = (every, []) if at_motors else with_units(_ways(tree), every)
    return tree, (taken[: len(one[0])], taken[len(one[0]) :]), (*notes, *said)


def _ways(tree: KinematicTree) -> dict[str, Way]:
    ends = np.stack([tree.lower, tree.upper], axis=1)
    return {
        joint: Way(bool(slides), (float(low), float(high)) if np.isfinite(low + high) else None)
        for joint, slides, (low, high) in zip(tree.joints, tree.prismatic, ends, strict=True)
    }


def _elsewhere(groups: Groups, locked: Mapping[str, str]) -> list[str]:
    """What to mind where a log shows joints that are locked to move, or to stay elsewhere: they are welded at zero."""
    found = []
    for old, joint in locked.items():
        every = [c.column(old) for group in groups for r in group for c in r.channels.values()
                 if c.name == "position" and old in c.labels]  # fmt: skip
        low, high = (float(f.reduce(np.concatenate(every))) for f in (np.fmin, np.fmax))
        if max(abs(low), abs(high)) > STILL:
            moved = f"moves from {low:.3g} to {high:.3g}" if high - low > STILL else f"stays at {low:.3g}"
            found.append(
                f"{joint} {moved} in the logs, while it is locked at zero: what it changes is not in the model"
            )
    return found


def _names_of_either(whole: KinematicTree, tree: KinematicTree, labels: Sequence[str]) -> dict[str, str]:
    """As `_names` of the whole tree, or of what is left of it where that has no such joints."""
    try:
        return _names(whole, labels)
    except UnknownNameError:
        if whole.n == tree.n:
            raise
        return _names(tree, labels)


def _names(tree: KinematicTree, labels: Sequence[str]) -> dict[str, str]:
    """Label -> joint; where labels merely count, as many hinges as there are labels will do, beside slides without one."""
    hinges = {
        j: "" if slides else j for j, slides in zip(tree.joints, np.asarray(tree.prismatic).tolist(), strict=True)
    }
    names = sure_names(labels, hinges)[0]
    if labels and not names:
        raise _unknown(tree, labels)
    return names


def _strange(names: Mapping[str, str], labels: Sequence[str], missing: Sequence[str]) -> str:
    """What to say of joints that the logs have beside those that the model lacks; '' where there are none."""
    strange = [label for label in labels if label not in names]
    if not strange:
        return ""
    return (
        f", while the logs have {', '.join(strange)}, which the model lacks: if these are the same joints under other names, "
        f'say which is which in [joints] of a mapping ({strange[0]} = "{missing[0]}", if so), which `trueup inspect LOGS '
        "--model MODEL` writes to be edited"
    )


def _unknown(tree: KinematicTree, labels: Sequence[str]) -> UnknownNameError:
    return unknown_name(
        "joint", labels[0], tree.joints,
        f"model '{tree.name}' (position columns of the logs: {', '.join(labels)}). Say which column is which joint in the "
        "mapping's [joints]: `trueup inspect LOGS --model MODEL` writes one to edit",
    )  # fmt: skip


def _renamed(recording: Recording, tree: KinematicTree, names: dict[str, str]) -> Recording:
    """The recording with the model's names; a channel that numbers or decorates its joints otherwise is matched by itself."""
    plain = {plain_name(old): new for old, new in names.items()}
    used: dict[str, str] = {}
    for channel in (recording.channel(name) for name in _CHANNELS if recording.has(name)):
        own = {x: names.get(x, plain.get(plain_name(x), x)) for x in channel.labels}
        if not set(own.values()) & set(tree.joints):
            try:
                own = _names(tree, channel.labels)
            except UnknownNameError:  # one is missing: those that count are of the joints whose positions count alike
                numbers = {_number(old): new for old, new in names.items()}
                own = {x: numbers.get(_number(x), x) for x in channel.labels if _number(x)}
        used |= {old: new for old, new in own.items() if old != new}
    return recording.rename(used) if used else recording


def _number(label: str) -> str:
    found = re.search(r"\d+$", label)
    return found[0].lstrip("0") or "0" if found else ""
