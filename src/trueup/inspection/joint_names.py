# SPDX-License-Identifier: Apache-2.0
"""Which joint of the files is which of the model: alike by name, by what drives it, or by order."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from trueup.evidence import HALVED
from trueup.recording import Recording, is_command

_BY_NAME = "by name"
_NUMBER = re.compile(r"\d+$")
_FILLING = re.compile(r"(?i)joint|motor|servo|link|actuator|position|pos")


def match_joints(labels: Sequence[str], drives: Mapping[str, str]) -> tuple[dict[str, str], str]:
    """Label in the files -> joint of the model, and how it was found; labels that stay open are not in it.

    `drives`: each joint of the model to the name of what drives it, '' where nothing does. Tried in turn: the same
    name, alike but for capitals and words such as "joint", the name of the actuator, alike but for what all labels begin
    or end with (motor_elbow, elbow_act), one within the other; what is left goes by order if as many joints, or as many
    driven joints, are left too.
    """
    found = _counted(labels, drives) or _numbered(labels, drives)
    how = "by order, which nothing here can prove: check them" if found else _BY_NAME
    for key in (str, plain_name, _core):
        _pair(found, labels, {j: key(j) for j in drives}, key)
    _pair(found, labels, {j: _core(a) for j, a in drives.items() if a}, _core)
    _undecorated(found, labels, drives)
    _within(found, labels, drives)
    open_labels = [label for label in labels if label not in found]
    free = [j for j in drives if j not in found.values()]
    driven = [j for j in free if drives[j]]
    if open_labels and len(open_labels) in (len(free), len(driven)):
        found |= zip(open_labels, free if len(free) == len(open_labels) else driven, strict=True)
        how = "by order, which nothing here can prove: check them"
    return {label: found[label] for label in labels if label in found}, how


def one_each(names: Mapping[str, str], recordings: Sequence[Recording]) -> dict[str, str]:
    """The names without those of a joint that another label of the same channel has itself: no channel has a joint twice."""
    together = [c.labels for r in recordings for c in r.channels.values()]
    taken = {
        label for label, joint in names.items()
        if any(x != label and names.get(x) == joint for labels in together if label in labels for x in labels)
    }  # fmt: skip
    return {label: joint for label, joint in names.items() if label == joint or label not in taken}


def named_as(
    recordings: Sequence[Recording], drives: Mapping[str, str], others: Sequence[str] = ()
) -> tuple[list[Recording], list[str]]:
    """Recordings with names of the model's joints in place of their own, and notes on those that differ.

    Measured joints are found as `match_joints` does. Commands that only count (a bag's Float64MultiArray) are of those
    joints whose motion follows them, where the numbers leave no doubt. What is not found keeps its name. `others`:
    actuators that drive no single joint (a tendon of several), which commands may name.
    """
    measured = _labels(recordings, lambda name: name == "position")
    if len(drives) == 1:  # the only joint of the log is the only one of the model: see `drives.suited`
        return list(recordings), []
    notes: list[str] = []
    if any(label not in drives for label in measured):
        names, how = sure_names(measured, drives)
        recordings, more = _renamed(recordings, names, how)
        notes += more
    recordings, more = _renamed(recordings, alike_names(_labels(recordings, is_command), others), _BY_NAME)
    notes += more
    known = {*drives, *drives.values(), *others, *_labels(recordings, lambda name: name == "position")}
    told = [label for label in _labels(recordings, is_command) if label not in known]
    if told:
        names, how = _followed(recordings, told), "by the motion that follows each command"
        if len(names) < len(told):
            names, how = sure_names(_labels(recordings, is_command), drives)
        recordings, more = _renamed(recordings, names, how)
        notes += more
    return list(recordings), notes


def sure_names(labels: Sequence[str], drives: Mapping[str, str]) -> tuple[dict[str, str], str]:
    """What `match_joints` finds; by order only if the labels merely count: other names may be other joints."""
    names, how = match_joints(labels, drives)
    alike = alike_names(labels, list(drives))
    if how == _BY_NAME or all(_core(label).isdigit() for label in names if label not in alike) or _counting(labels):
        return names, how
    return alike, _BY_NAME


def alike_names(labels: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Each label to the name that is the same, or the same but for capitals and words that say nothing."""
    alike: dict[str, str] = {}
    for key in (str, plain_name, _core):
        _pair(alike, labels, {name: key(name) for name in names}, key)
    return alike


def _labels(recordings: Sequence[Recording], of: Callable[[str], bool]) -> list[str]:
    every = [c.labels for r in recordings for name, c in r.channels.items() if of(name)]
    return list(dict.fromkeys(label for labels in every for label in labels))


def _renamed(recordings: Sequence[Recording], names: Mapping[str, str], how: str) -> tuple[list[Recording], list[str]]:
    changed = {old: new for old, new in names.items() if old != new}
    if not changed:
        return list(recordings), []
    there = [{label for c in r.channels.values() for label in c.labels} for r in recordings]
    renamed = [
        r.rename({old: new for old, new in changed.items() if old in known})
        for r, known in zip(recordings, there, strict=True)
    ]
    return renamed, [f"joints of the recordings are those of the model {way}" for way in ways(changed, how)]


def ways(names: Mapping[str, str], how: str) -> list[str]:
    """For each way in which labels were found to be joints of other names, that and these: those that are alike need no
    `how` of the rest.
    """
    changed = {old: new for old, new in names.items() if old != new}
    sure = alike_names([*changed], [*changed.values()])
    parts: dict[str, list[str]] = {}
    for old, new in changed.items():
        parts.setdefault(_BY_NAME if sure.get(old) == new else how, []).append(f"{old} -> {new}")
    return [f"{way}: {', '.join(pairs)}" for way, pairs in parts.items()]


def _followed(recordings: Sequence[Recording], told: Sequence[str]) -> dict[str, str]:
    """Each commanded label to the measured joint that follows it in all recordings; {} where that leaves a doubt."""
    measured = _labels(recordings, lambda name: name == "position")
    if len(measured) < len(told):
        return {}
    apart = np.zeros((len(told), len(measured)))
    for recording in recordings:
        commands = [c for name, c in recording.channels.items() if is_command(name) and set(told) <= set(c.labels)]
        if not commands or not recording.has("position") or commands[0].unit not in ("", "rad", "m"):
            return {}
        position = recording.channel("position").select(measured)
        wanted = commands[0].select(told).at(position.time, hold=True)
        apart += np.nanmean((wanted[:, :, None] - position.values[:, None, :]) ** 2, axis=0)
    nearest = apart.argmin(axis=1)
    second = np.partition(np.column_stack([apart, np.full(len(told), np.inf)]), 1, axis=1)[:, 1]
    sure = len(set(nearest.tolist())) == len(told) and bool(np.all(apart.min(axis=1) < HALVED**2 * second))
    return {label: measured[k] for label, k in zip(told, nearest, strict=True)} if sure else {}


def _counted(labels: Sequence[str], drives: Mapping[str, str]) -> dict[str, str]:
    """Pairs of labels and joints that only count, one side from 0 and the other from 1: joint_0 is joint_1; else none."""
    counted = {_core(label): label for label in labels if _core(label).isdigit()}
    theirs = {_core(joint): joint for joint in drives if _core(joint).isdigit()}
    if len(counted) < 2 or ("0" in counted) == ("0" in theirs):
        return {}
    shift = 1 if "0" in counted else -1
    wanted = {label: f"{int(number) + shift}" for number, label in counted.items()}
    return {label: theirs[n] for label, n in wanted.items()} if set(wanted.values()) <= set(theirs) else {}


def _numbered(labels: Sequence[str], drives: Mapping[str, str]) -> dict[str, str]:
    """Pairs of labels that only count and joints of one name and a number: joint_3 is panda_joint3. All of these must be
    there; labels may go on, as of a gripper that was logged behind an arm, but not by as many again: joints 0 to 5 of an arm
    are not its wrist_1 to wrist_3 and three more.
    """
    counted = {int(_core(label)): label for label in labels if _core(label).isdigit()}
    stems: dict[str, dict[int, str]] = {}
    for joint in drives:
        if (number := _NUMBER.search(_core(joint))) is not None:
            stems.setdefault(_core(joint)[: number.start()], {})[int(number[0])] = joint
    theirs = max(stems.values(), key=len, default={})
    if len(theirs) < 2 or "" in stems or not len(theirs) <= len(counted) < 2 * len(theirs):
        return {}
    shift = min(theirs) - min(counted)
    wanted = {number - shift: joint for number, joint in theirs.items()}
    return {counted[n]: joint for n, joint in wanted.items()} if set(wanted) <= set(counted) else {}


def _counting(labels: Sequence[str]) -> bool:
    """Whether labels differ in nothing but a number, from 0 or 1 on: q1, q2, q3."""
    numbers = [int(match[0]) for label in labels if (match := _NUMBER.search(label))]
    stems = {_NUMBER.sub("", label) for label in labels}
    return len(stems) == 1 and numbers in (list(range(len(labels))), list(range(1, len(labels) + 1)))


def _undecorated(found: dict[str, str], labels: Sequence[str], drives: Mapping[str, str]) -> None:
    """Adds pairs that are alike once what all open labels begin and end with is gone, where that finds every one."""
    rest = [label for label in labels if label not in found]
    plain, joints = [plain_name(label) for label in rest], {plain_name(j): j for j in drives if j not in found.values()}
    before, after = _shared(plain), _shared([p[::-1] for p in plain])
    for start, stop in itertools.product(range(before + 1), range(after + 1)):
        cores = [p[start : len(p) - stop] for p in plain]
        if len(rest) > 1 and len(set(cores)) == len(cores) and all(core in joints for core in cores):
            found |= {label: joints[core] for label, core in zip(rest, cores, strict=True)}
            return


def _shared(words: Sequence[str]) -> int:
    """How many letters all words begin with."""
    alike = [len(set(letters)) == 1 for letters in zip(*words, strict=False)]
    return next((k for k, same in enumerate(alike) if not same), len(alike))


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


def plain_name(name: str) -> str:
    """Letters and digits of a name, capitals and small ones alike."""
    return "".join(c for c in name.casefold() if c.isalnum())


def _core(name: str) -> str:
    """A name without what many names have in common, unless nothing but a number is left."""
    return plain_name(_FILLING.sub("", name)) or plain_name(name)
