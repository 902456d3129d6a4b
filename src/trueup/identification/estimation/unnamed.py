# SPDX-License-Identifier: Apache-2.0
"""Logs whose columns have no names: which are positions, speeds and torques of a tree's joints, told by what they do."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import IdentificationError
from trueup.identification.estimation.diagnosis import POOR
from trueup.identification.estimation.filtering import Lowpass, derivative, even, grid, slow_cutoff
from trueup.identification.estimation.quick import rough_error
from trueup.identification.estimation.torque_choice import Torque, choice
from trueup.identification.kinematic_tree import KinematicTree
from trueup.inspection.relations import CORRELATED, TOLERANCE
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.units import hardly_radians


@dataclass(frozen=True)
class _Layout:
    """Which columns (n,) of a block without names are what; `speed` is empty where none are."""

    position: tuple[int, ...]
    torque: tuple[int, ...]
    speed: tuple[int, ...] = ()


def named_by_motion(tree: KinematicTree, recording: Recording, torque: str = "") -> tuple[Recording, str]:
    """The recording with channels for the columns without names of its only channel, and a note; others as they are.

    Signals follow each other (all positions, then all speeds, ...) or joints do; a rigid arm tells which are which: with
    the right ones a rough model explains the torque. Raises IdentificationError where none of them does, or several sets
    of columns could be the torque and `torque` does not name one of them.
    """
    block = _block(recording)
    if block is None:
        return recording, ""
    tried = [
        (rough_error(arm, recording, _channels(arm, block, layout)), layout, arm)
        for arm in _arms(tree, len(block.labels))
        for layout in _layouts(block, arm.n)
    ]
    error, layout, arm = min(tried, key=lambda t: t[0], default=(np.inf, None, tree))
    if layout is not None and error <= POOR:
        layout = _wanted_layout(recording, block, arm, [(x, own) for e, own, x in tried if e <= POOR], layout, torque)
    if layout is None or error > POOR:
        raise IdentificationError(
            f"recording '{recording.name}': its {len(block.labels)} columns have no names, and none of them are positions "
            f"and torques of the {tree.n} joints of the model: say which columns are what in a mapping (`trueup inspect` "
            "writes one to edit), or lock joints that the log does not hold (--lock)"
        )
    parts = (("position", layout.position), ("speed", layout.speed), ("torque", layout.torque))
    said = ", ".join(f"{name} {_counted(block, columns)}" for name, columns in parts if columns)
    note = f"columns have no names; by what they do they were taken as {said} of {', '.join(arm.joints)}"
    return recording.replace(channels=_channels(arm, block, layout)), note


def _wanted_layout(
    recording: Recording, block: Channel, arm: KinematicTree, likely: Sequence[tuple[KinematicTree, _Layout]], best: _Layout,
    wanted: str,
) -> _Layout:  # fmt: skip
    """The layout whose torque is wanted, where several sets of columns could be it. Raises IdentificationError."""
    own = {x.torque: x for a, x in reversed(likely) if a is arm and x.position == best.position}
    titles = {f"columns {_counted(block, columns)}": columns for columns in sorted(own)}
    torques = [Torque(title, _channels(arm, block, own[x])["torque"], True) for title, x in titles.items()]
    if len(torques) < 2 and not wanted:
        return best
    named = recording.replace(channels=_channels(arm, block, best))
    return own[titles[choice(torques, named, arm, wanted).title]]


def _block(recording: Recording) -> Channel | None:
    """The channel of all columns, where none has a name."""
    channels = list(recording.channels.values())
    bare = len(channels) == 1 and len(channels[0].labels) > 1 and all(x.isdigit() for x in channels[0].labels)
    return channels[0] if bare else None


def _arms(tree: KinematicTree, width: int) -> Iterator[KinematicTree]:
    """The tree, or its hinges alone (a gripper's fingers are rarely logged), if `width` columns can be of its joints."""
    kinds = 6  # The most signals of a joint that a log is taken to hold: position, speed, torque, and what was asked of each
    slides = [j for j, slides in zip(tree.joints, np.asarray(tree.prismatic).tolist(), strict=True) if slides]
    for arm in (tree, tree.lock(slides)) if 0 < len(slides) < tree.n else (tree,):
        if width % arm.n == 0 and 2 <= width // arm.n <= kinds:
            yield arm


def _layouts(block: Channel, n: int) -> Iterator[_Layout]:
    """Pairs of a position and a torque that is no copy and no rate of change of it, signal by signal or joint by joint."""
    time, rate = grid(block.time)
    known = np.nan_to_num(np.array(block.values))
    slow = Lowpass(rate, slow_cutoff(rate))(even(block.time, known, time))
    width = slow.shape[1]
    orders = np.arange(width).reshape(-1, n), np.arange(width).reshape(n, -1).T  # (kinds, n)
    for order in orders if n > 1 else orders[:1]:
        signals = [slow[:, columns] for columns in order]
        rates = [derivative(x, rate) for x in signals]
        speeds = {(i, j) for i, j in itertools.permutations(range(len(order)), 2) if _alike(rates[i], signals[j])}
        for i, j in itertools.permutations(range(len(order)), 2):
            copies = _alike(signals[i], signals[j]) or _alike(derivative(rates[i], rate), signals[j])
            if copies or (i, j) in speeds or any(k == i for _, k in speeds):
                continue
            own = [k for k in range(len(order)) if (i, k) in speeds and _same_size(rates[i], signals[k])]
            speed = tuple(order[own[0]].tolist()) if own else ()
            yield _Layout(tuple(order[i].tolist()), tuple(order[j].tolist()), speed)


def _alike(a: Array, b: Array) -> bool:
    """Whether most columns (T, n) of one are those of the other, but for their size."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0))
    return bool(np.median(np.sum(a * b, axis=0) / np.maximum(size, TINY)) > CORRELATED)


def _same_size(a: Array, b: Array) -> bool:
    return bool(abs(np.log(np.median(np.std(b, axis=0) / np.maximum(np.std(a, axis=0), TINY)))) < TOLERANCE)


def _channels(arm: KinematicTree, block: Channel, layout: _Layout) -> dict[str, Channel]:
    """Channels in SI; hinges that turn more than arms do are in degrees."""
    place, turning = block.values[:, list(layout.position)], ~np.asarray(arm.prismatic)
    degrees = turning.any() and hardly_radians(float(np.nanmax(np.abs(place[:, turning]))))
    unit = np.where(turning & degrees, np.radians(1.0), 1.0)
    made = {
        "position": Channel("position", arm.joints, "rad", block.time, unit * place),
        "torque": Channel("torque", arm.joints, "N m", block.time, block.values[:, list(layout.torque)]),
    }
    if layout.speed:
        speed = unit * block.values[:, list(layout.speed)]
        made["velocity"] = Channel("velocity", arm.joints, "rad/s", block.time, speed)
    return made


def _counted(block: Channel, columns: tuple[int, ...]) -> str:
    """The columns' numbers: '2-8', or '2, 5, 8'."""
    numbers = [int(block.labels[k]) for k in columns]
    if numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]}-{numbers[-1]}"
    return ", ".join(map(str, numbers))
