# SPDX-License-Identifier: Apache-2.0
"""One way of a drive whose pose was told in several frames: odometry that was reset, a localisation that was set right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from trueup.arrays import Array, Integers, Mask
from trueup.instant import REACH
from trueup.noise import UNUSUAL
from trueup.recording import Channel
from trueup.samples import NEIGHBOURS, wrapped
from trueup.tracking.heading import WAY
from trueup.units import GRAVITY


def sudden(position: Channel, heading: Channel, good: Mask) -> list[tuple[int, int]]:
    """The good rows between which the pose jumps by more than the motion around allows: the last before, the first behind.

    In the vehicle's own frame, in which curves do not show. One sample that is off and back again is no jump. Nothing on
    wheels speeds up, brakes or turns aside harder than it would fall, by the friction of tyres.
    """
    rows = np.flatnonzero(good)
    if len(rows) <= 2 * NEIGHBOURS + 1:
        return []
    time, points, angle = position.time[rows], position.values[rows], np.unwrap(heading.values[rows, 0])
    gaps, middle = np.diff(time), 0.5 * (angle[1:] + angle[:-1])
    moved = np.diff(points, axis=0)
    ahead = np.cos(middle) * moved[:, 0] + np.sin(middle) * moved[:, 1]
    aside = np.cos(middle) * moved[:, 1] - np.sin(middle) * moved[:, 0]
    own = np.stack([ahead, aside], axis=1)
    around = sliding_window_view(
        np.pad(own / gaps[:, None], ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="edge"), 2 * NEIGHBOURS + 1, 0
    )
    off = own - np.median(around, axis=-1) * gaps[:, None]
    lasting = np.stack([np.convolve(column, np.ones(3), mode="same") for column in off.T], axis=1)
    size, kept = np.linalg.norm(off, axis=1), np.linalg.norm(lasting, axis=1)
    most = np.maximum(WAY + GRAVITY * gaps**2, UNUSUAL * np.median(size))
    found = np.flatnonzero((size > most) & (kept > np.maximum(most, 0.5 * size)))
    return [(int(rows[k]), int(rows[k + 1])) for k in found]


def there_and_back(position: Channel, jumps: Sequence[tuple[int, int]]) -> tuple[list[tuple[int, int]], Mask]:
    """The jumps of `jumps` that stay, and (T,) the rows between those that are undone by others behind: what a tracker
    mistook for a while, such as markers that changed places.

    It came back where what follows lies less than half as far aside as what was between. Where more of the drive is between
    than beside, that was the place which stays.
    """
    away = np.zeros(len(position.time), dtype=bool)
    edges = [0, *(first for _, first in jumps), len(position.time)]
    poses = np.concatenate([position.values, np.zeros((len(position.time), 1))], axis=1)
    aside = [_aside(position.time, poses, jump, (edges[k], edges[k + 2])) for k, jump in enumerate(jumps)]
    stay, k = [], 0
    while k < len(jumps):
        gone = np.cumsum(aside[k:], axis=0)
        size = np.linalg.norm(gone, axis=1)
        back = next((j for j in range(1, len(gone)) if size[j] < 0.5 * size[:j].min()), 0)
        begin, end = edges[k + 1], edges[k + 1 + back]
        since = edges[k] if not stay else max(edges[k], stay[-1][1])
        if back and end - begin < (begin - since) + (edges[k + 2 + back] - end):
            away[jumps[k][0] + 1 : end] = True
            k += back + 1
        else:
            stay.append(jumps[k])
            k += 1
    return stay, away


def _aside(time: Array, poses: Array, jump: tuple[int, int], ends: tuple[int, int]) -> Array:
    """(2,) by how much the place is set aside in a jump, seen from the rows between `ends`."""
    last, first = jump
    middle = 0.5 * (time[last] + time[first])
    before, behind = np.arange(ends[0], last + 1), np.arange(first, ends[1])
    return (_pose_at(middle, time, poses, behind) - _pose_at(middle, time, poses, before))[:2]


def end_to_end(position: Channel, jumps: Sequence[tuple[int, int]]) -> Channel:
    """The places alone, joined as `joined` does, none turned."""
    unturned = Channel("heading", ("heading",), "rad", position.time, np.zeros((len(position.time), 1)))
    return joined(position, unturned, jumps)[0]


def joined(position: Channel, heading: Channel, jumps: Sequence[tuple[int, int]]) -> tuple[Channel, Channel]:
    """Position and heading (in the sense of the axes) as the frame before the first of `jumps` would have them to the end.

    jumps: the last row before each and the first one behind it, between which nothing says where the vehicle was. A drive
    goes on as it went: lines through the poses before and behind a jump meet in its middle, and what comes behind is moved
    there as one piece, its heading too.
    """
    if not jumps:
        return position, heading
    time, poses = position.time, np.concatenate([position.values, heading.values], axis=1)
    edges = [0, *(first for _, first in jumps), len(time)]
    for k, (last, first) in enumerate(jumps):
        middle = 0.5 * (time[last] + time[first])
        here = _pose_at(middle, time, poses, np.arange(edges[k], last + 1))
        there = _pose_at(middle, time, poses, np.arange(first, edges[k + 2]))
        back = float(wrapped(here[2:] - there[2:])[0])
        rotation = np.array([[np.cos(back), -np.sin(back)], [np.sin(back), np.cos(back)]])
        poses[first:, :2] = (poses[first:, :2] - there[:2]) @ rotation.T + here[:2]
        poses[first:, 2] += back
    return position.replace(values=poses[:, :2]), heading.replace(values=poses[:, 2:])


def notes_on_jumps(position: Channel, jumps: Sequence[tuple[int, int]]) -> list[str]:
    """What to say of jumps that were joined, if anything."""
    if not jumps:
        return []
    instants = [0.5 * float(position.time[a] + position.time[b]) - float(position.time[0]) for a, b in jumps]
    shown = ", ".join(f"{t:.1f}" for t in instants[:4]) + (", ..." if len(instants) > 4 else "")
    how = "jumps" if len(instants) == 1 else f"jumps {len(instants)} times"
    return [
        f"the pose {how} ({shown} s after its first sample) while the vehicle drives on, as where odometry is reset or a "
        "localisation is set right: what comes behind is moved to where the drive went on"
    ]


def _pose_at(middle: float, time: Array, poses: Array, rows: Integers) -> Array:
    """(3,) the line through those poses of these rows (in order) that are near the middle of a jump, there."""
    known = rows[np.isfinite(poses[rows]).all(axis=1)]
    away = np.abs(time[known] - middle)
    near = known[away <= max(REACH, np.sort(away)[:2][-1])]
    table = np.stack([np.ones(len(near)), time[near] - middle], axis=1)
    values = np.column_stack([poses[near, :2], np.unwrap(poses[near, 2])])
    return np.asarray(np.linalg.lstsq(table, values, rcond=None)[0][0], dtype=np.float64)
