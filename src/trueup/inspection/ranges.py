# SPDX-License-Identifier: Apache-2.0
"""Joints that were measured far beyond where their model lets them go: what is wrong then is more often the model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from trueup.errors import RecordingError
from trueup.inspection.scales import Way
from trueup.inspection.zeros import FAR
from trueup.recording import Recording
from trueup.units import hardly_radians, size_of


def beyond_ranges(joints: Mapping[str, Way], recordings: Sequence[Recording], *, in_degrees: bool) -> tuple[str, ...]:
    """A sentence for each of the `joints` whose measured positions lie beyond its range, with what is likely wrong.

    A simulator stops it there, and a fit would blame friction for that. `in_degrees`: whether files of the model's format
    have angles in degrees unless they say otherwise, as MJCF does.
    """
    said = []
    for joint, way, low, high in _measured_ways(joints, recordings):
        if way.slides:
            said += _slid_beyond(joint, way.ends, low, high)
            continue
        if not _turned_beyond(way, low, high):
            continue
        what = (
            f"joint '{joint}' is measured from {low:.3g} to {high:.3g} rad, beyond its range in the model, "
            + " to ".join(f"{end:.3g}" for end in way.ends)
        )
        asked = [end / size_of("deg") for end in way.ends]  # as the file has it, if that was in degrees
        meant = max(abs(end) for end in asked)
        if in_degrees and not hardly_radians(meant) and low >= asked[0] - FAR and high <= asked[1] + FAR:
            why = (
                f"the file seems to say it in rad ({asked[0]:.4g} to {asked[1]:.4g}) where degrees are read; mend it by "
                '<compiler angle="radian"/>, or write degrees'
            )
        else:
            why = "is it the same joint, with the same zero, sense and unit, or is the range too narrow?"
        said.append(f"{what} rad, where a simulator stops it: {why}")
    return tuple(said)


def check_slid(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> None:
    """Raises RecordingError for a slide that was measured beyond its range by more than half of that: no replay could follow,
    and what is fitted all the same would look as sure as ever.
    """
    for joint, way, low, high in _measured_ways(joints, recordings):
        for said in _slid_beyond(joint, way.ends, low, high) if way.slides else ():
            raise RecordingError(
                f'{said}. If the range is too narrow, mend it in the model; "--refuse ranges" goes on as it is'
            )


def turned_beyond(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> list[str]:
    """Those of the `joints` that turn, and were measured beyond their range."""
    return [
        joint for joint, way, low, high in _measured_ways(joints, recordings)
        if not way.slides and _turned_beyond(way, low, high)
    ]  # fmt: skip


def _turned_beyond(way: Way, low: float, high: float) -> bool:
    return low < way.ends[0] - FAR or high > way.ends[1] + FAR


def _measured_ways(
    joints: Mapping[str, Way], recordings: Sequence[Recording]
) -> Iterator[tuple[str, Way, float, float]]:
    """Joints that have a range and were measured, with the ends of what was measured, in rad or m."""
    for joint, way in joints.items():
        unit = "m" if way.slides else "rad"
        parts = [r.channel("position").column(joint) for r in recordings if _measured(r, joint, unit)]
        if way.range is not None and parts:
            measured = np.concatenate(parts)
            yield joint, way, float(np.nanmin(measured)), float(np.nanmax(measured))


def shorter(ends: tuple[float, float], low: float, high: float) -> list[str]:
    """Units in which a slide lies in its range that was measured, from `low` to `high` m, further beyond than it is long."""
    whole = ends[1] - ends[0]
    if low >= ends[0] - whole and high <= ends[1] + whole:
        return []
    return [u for u in ("mm", "cm") if ends[0] - whole <= low * size_of(u) and high * size_of(u) <= ends[1] + whole]


def _slid_beyond(joint: str, ends: tuple[float, float], low: float, high: float) -> list[str]:
    """A sentence where a slide was measured, from `low` to `high` m, beyond its range by more than half of that."""
    beside = 0.5 * (ends[1] - ends[0])  # an opening of two fingers is twice as much as each can go
    if low >= ends[0] - beside and high <= ends[1] + beside:
        return []
    fits = shorter(ends, low, high)
    why = (
        f"are these {' or '.join(fits)}, or was a unit of angles said for all labels? Give each label its own in the mapping "
        f'(units = ["{fits[0]}", ...])'
        if fits else "is it the same joint and unit? The opening between two fingers is twice the way of each (scale = 0.5 "
        "in the mapping, one for each label)"
    )  # fmt: skip
    return [
        f"joint '{joint}' is measured from {low:.3g} to {high:.3g} m, beyond its range in the model, {ends[0]:.3g} to "
        f"{ends[1]:.3g} m, where a simulator stops it: {why}"
    ]


def _measured(recording: Recording, joint: str, unit: str) -> bool:
    """Whether a recording has positions of a joint in a unit."""
    if not recording.has("position") or joint not in recording.channel("position").labels:
        return False
    channel = recording.channel("position")
    return channel.unit_of(joint) == unit and bool(np.isfinite(channel.column(joint)).any())
