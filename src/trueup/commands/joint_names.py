# SPDX-License-Identifier: Apache-2.0
"""Which joint of the files is which of the model: alike by name, by what drives it, or by order."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

_FILLING = re.compile(r"(?i)joint|motor|servo|link|actuator|position|pos")


def match_joints(labels: Sequence[str], drives: Mapping[str, str]) -> tuple[dict[str, str], str]:
    """Label in the files -> joint of the model, and how it was found; labels that stay open are not in it.

    `drives`: each joint of the model to the name of what drives it, '' where nothing does. Tried in turn: the same
    name, alike but for capitals and words such as "joint", one within the other, the name of the actuator; what is
    left goes by order if as many joints, or as many driven joints, are left too.
    """
    found = _counted(labels, drives)
    how = "by order, which nothing here can prove: check them" if found else "by name"
    for key in (str, _plain, _core):
        _pair(found, labels, {j: key(j) for j in drives}, key)
    _pair(found, labels, {j: _core(a) for j, a in drives.items() if a}, _core)
    _within(found, labels, drives)
    open_labels = [label for label in labels if label not in found]
    free = [j for j in drives if j not in found.values()]
    driven = [j for j in free if drives[j]]
    if open_labels and len(open_labels) in (len(free), len(driven)):
        found |= zip(open_labels, free if len(free) == len(open_labels) else driven, strict=True)
        how = "by order, which nothing here can prove: check them"
    return {label: found[label] for label in labels if label in found}, how


def _counted(labels: Sequence[str], drives: Mapping[str, str]) -> dict[str, str]:
    """Pairs of labels and joints that only count, one side from 0 and the other from 1: joint_0 is joint_1; else none."""
    counted = {_core(label): label for label in labels if _core(label).isdigit()}
    theirs = {_core(joint): joint for joint in drives if _core(joint).isdigit()}
    if len(counted) < 2 or ("0" in counted) == ("0" in theirs):
        return {}
    shift = 1 if "0" in counted else -1
    wanted = {label: f"{int(number) + shift}" for number, label in counted.items()}
    return {label: theirs[n] for label, n in wanted.items()} if set(wanted.values()) <= set(theirs) else {}


def _pair(found: dict[str, str], labels: Sequence[str], keys: Mapping[str, str], make: Callable[[str], str]) -> None:
    """Adds pairs whose keys are the same, where no other has that key."""
    for label in labels:
        same = [j for j, k in keys.items() if k and k == make(label) and j not in found.values()]
        rivals = [x for x in labels if x not in found and make(x) == make(label)]
        if label not in found and len(same) == 1 and len(rivals) == 1:
            found[label] = same[0]


def _within(found: dict[str, str], labels: Sequence[str], drives: Mapping[str, str]) -> None:
    """Adds pairs of which one name holds the other ("gripper", "left_gripper"), where that is so of one joint only."""
    for label in labels:
        core = _core(label)
        free = [j for j in drives if j not in found.values()]
        near = [j for j in free if any(core and (core in name or name in core) for name in _names(j, drives[j]))]
        near = [j for j in near if drives[j]] if len(near) > 1 else near
        if label not in found and len(core) > 2 and len(near) == 1:
            found[label] = near[0]


def _names(joint: str, actuator: str) -> list[str]:
    return [core for core in (_core(joint), _core(actuator)) if len(core) > 2]


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())


def _core(name: str) -> str:
    """A name without what many names have in common, unless nothing but a number is left."""
    return _plain(_FILLING.sub("", name)) or _plain(name)
