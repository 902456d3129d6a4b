# SPDX-License-Identifier: Apache-2.0
"""Which column of a log is which joint of a model: by name, else by order where that is the only way, and said."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trueup.errors import UnknownNameError, unknown_name
from trueup.identification.kinematic_tree import KinematicTree
from trueup.recording import Recording

_CHANNELS = ("position", "velocity", "torque", "current", "load")

_NUMBER = re.compile(r"\d+$")

Groups = tuple[list[Recording], list[Recording]]


def matched(tree: KinematicTree, groups: Groups) -> tuple[KinematicTree, Groups, tuple[str, ...]]:
    """Recordings with the joints' names of the model, the tree with joints locked that no log has, and what was done.

    Names count where they agree but for capitals, hyphens and letters that all of them begin or end with. Names that
    only number the joints (joint_1 ... joint_6) are taken in the model's order, if their number is that of its joints
    or of its revolute ones. Raises UnknownNameError for any other.
    """
    labels = list(
        dict.fromkeys(x for group in groups for r in group if r.has("position") for x in r.channel("position").labels)
    )
    names, notes = _names(tree, labels), []
    changed = {old: new for old, new in names.items() if old != new}
    if changed and any(_plain(new) not in _plain(old) for old, new in changed.items()):
        said = ", ".join(f"{old} -> {new}" for old, new in changed.items())
        notes.append(f"columns were taken as joints in the model's order, which nothing here can prove: {said}")
    missing = [joint for joint in tree.joints if joint not in names.values()]
    if missing and names:
        notes.append(f"no log has {', '.join(missing)}: locked at zero")
        tree = tree.lock(missing)
    training, held_out = ([_renamed(r, tree, changed) for r in group] for group in groups)
    return tree, (training, held_out), tuple(notes)


def _names(tree: KinematicTree, labels: Sequence[str]) -> dict[str, str]:
    """Label -> joint."""
    alike = {_plain(joint): joint for joint in tree.joints}
    by_name = {label: alike[_plain(label)] for label in labels if _plain(label) in alike}
    if by_name or not labels:
        return by_name
    if inside := _within(tree, labels):
        return inside
    turning = [j for j, slides in zip(tree.joints, np.asarray(tree.prismatic).tolist(), strict=True) if not slides]
    numbers = [int(found[0]) if (found := _NUMBER.search(label)) else -1 for label in labels]
    for joints in (tree.joints, turning):
        if len(joints) == len(labels) and all(b == a + 1 for a, b in pairwise(numbers)) and numbers[0] in (0, 1):
            return dict(zip(labels, joints, strict=True))
    raise _unknown(tree, labels)


def _within(tree: KinematicTree, labels: Sequence[str]) -> dict[str, str]:
    """Label -> joint where each label is a joint's name with the same letters before and after: motor_elbow, elbow_act."""
    plain = [_plain(label) for label in labels]
    before, after = _common(plain), _common([p[::-1] for p in plain])
    joints = {_plain(joint): joint for joint in tree.joints}
    for start in range(before + 1):
        for stop in range(after + 1):
            cores = [p[start : len(p) - stop] for p in plain]
            if all(core in joints for core in cores) and len(set(cores)) == len(cores):
                return {label: joints[core] for label, core in zip(labels, cores, strict=True)}
    return {}


def _common(words: Sequence[str]) -> int:
    """How many letters all words begin with."""
    alike = [len(set(letters)) == 1 for letters in zip(*words, strict=False)]
    return next((k for k, same in enumerate(alike) if not same), len(alike))


def _unknown(tree: KinematicTree, labels: Sequence[str]) -> UnknownNameError:
    return unknown_name(
        "joint", labels[0], tree.joints,
        f"model '{tree.name}' (position columns of the logs: {', '.join(labels)}). Say which column is which joint in the "
        "mapping's [joints]: `trueup inspect LOGS --model MODEL` writes one to edit",
    )  # fmt: skip


def _renamed(recording: Recording, tree: KinematicTree, names: dict[str, str]) -> Recording:
    """The recording with the model's names; a channel that numbers or decorates its joints otherwise is matched by itself."""
    plain = {_plain(old): new for old, new in names.items()}
    used: dict[str, str] = {}
    for channel in (recording.channel(name) for name in _CHANNELS if recording.has(name)):
        own = {x: names.get(x, plain.get(_plain(x), x)) for x in channel.labels}
        if not set(own.values()) & set(tree.joints):
            try:
                own = _names(tree, channel.labels)
            except UnknownNameError:
                own = {}
        used |= {old: new for old, new in own.items() if old != new}
    return recording.rename(used) if used else recording


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())
