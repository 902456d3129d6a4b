# SPDX-License-Identifier: Apache-2.0
"""Where a vehicle drove backwards by its commands, and headings that are its direction of motion turned round there."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.recording import Channel, Recording
from trueup.tracking.commands import held, signals
from trueup.tracking.heading import motion, telling


def driven_back(recording: Recording, position: Channel) -> Mask:
    """(T,) at which samples of a position the vehicle goes backwards: where a speed below zero drove it.

    A vehicle that brakes still goes on, so that the command of the moment does not tell. Between two places where it stands,
    or the way turns back, it goes in one sense, that of most of what was commanded meanwhile; where it stands it keeps that.
    """
    back = np.zeros(len(position.time), dtype=bool)
    told = signals(recording).get("speed")
    rows, way = _moving(position)
    if told is None or not (told.values < 0.0).any() or not len(rows):
        return back
    parted = np.concatenate([[0], np.cumsum((np.cos(np.diff(way)) < 0.0) | (np.diff(rows) > 1))])
    meanwhile = np.bincount(parted, held(told, position.time[rows]))
    return (meanwhile[parted] < 0.0)[_last_of(rows, len(back))]


def as_heading(heading: Channel, position: Channel, back: Mask) -> tuple[Channel, list[str]]:
    """The heading (at the times of the position), and a note; of one that turns round with the way where the vehicle begins
    to go `back` (T,), a course over ground, the other way round there. While it stands the last one holds, at first the next.
    """
    rows, _ = _moving(position)
    rows = rows[np.isfinite(heading.values[rows, 0])]
    changes = np.flatnonzero(np.diff(back[rows].astype(int)))
    turned = np.cos(heading.values[rows[changes + 1], 0] - heading.values[rows[changes], 0]) < 0.0
    if not len(changes) or turned.mean() <= 0.5:
        return heading, []
    angle = np.array(heading.values)
    angle[: rows[0]] = angle[rows[0]]
    for k in changes.tolist():
        angle[rows[k] : rows[k + 1]] = angle[rows[k]]
    note = "the heading is the direction of motion: turned round where the vehicle was driven backwards"
    return heading.replace(values=angle + np.pi * back[:, None]), [note]


def _moving(position: Channel) -> tuple[Integers, Array]:
    """(K,) samples around which the vehicle goes farther than noise could feign, and the direction of that, in rad."""
    known = np.flatnonzero(np.isfinite(position.values).all(axis=1))
    if len(known) < 3:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    points = position.values[known]
    moved, sure = motion(position.time[known], points)
    sure &= np.linalg.norm(moved, axis=1) > telling(points)
    return known[sure].astype(np.int64), np.arctan2(moved[sure, 1], moved[sure, 0])


def _last_of(rows: Integers, count: int) -> Integers:
    """(count,) which of some rows (K,) is the last at or before each, or the first."""
    return np.maximum(np.searchsorted(rows, np.arange(count), side="right") - 1, 0).astype(np.int64)
