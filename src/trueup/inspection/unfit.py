# SPDX-License-Identifier: Apache-2.0
"""Positions without a unit that fit none which joints of the model can be in: refused, with what to write."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.errors import RecordingError, listed
from trueup.inspection.relations import CORRELATED
from trueup.inspection.scales import OTHER_UNIT, Way, beyond, inside, shares, unsaid, within
from trueup.recording import Recording
from trueup.samples import correlation
from trueup.trial import command_of
from trueup.units import hardly_radians, size_of

_SAY_UNITS = (
    'say what they are in the mapping (trueup inspect writes one): "deg", "mm", "rev", ...; for counts of an encoder '
    'unit = "rad" and scale = 6.2832 / counts of a turn, or unit = "m" and scale = metres of one count; units, scale and '
    "offset may each be a list, one for each label"
)


def check_units(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> None:
    """Raises RecordingError for hinges whose positions have no unit and go further in rad and in degrees than they can."""
    for recording in (r for r in recordings if r.has("position") and not r.channel("position").unit):
        channel = recording.channel("position")
        for label in (j for j in channel.labels if j in joints and not joints[j].slides):
            times = _times_as_far(recording, label)
            if times > OTHER_UNIT:
                turn = math.tau * times
                raise RecordingError(
                    f"'{recording.name}': positions have no unit, and '{label}' moves {times:.4g} times as far as it is "
                    f'commanded in rad: say what they are in the mapping (trueup inspect writes one): "deg" (57.3 times), '
                    f'"rev", ...; for counts of an encoder unit = "rad" and scale = 6.2832 / counts of a turn, which seem to '
                    f"be about {turn:.0f} here (the nearest power of two: {2 ** round(math.log2(turn))})"
                )
        for label in (j for j in channel.labels if j in joints and not joints[j].slides):
            most = float(np.nanmax(np.abs(channel.column(label)), initial=0.0))
            if hardly_radians(most) and not within(joints, channel.select([label]), size_of("deg")):
                low, high = joints[label].ends
                so_far = (
                    f"is beyond its range in the model ({low:.3g} to {high:.3g} rad) in rad and in degrees"
                    if joints[label].range else "would turn many times in rad and in degrees"
                )  # fmt: skip
                raise RecordingError(
                    f"'{recording.name}': positions have no unit, and '{label}', which reaches {most:.4g}, {so_far}: "
                    f"{_SAY_UNITS}"
                )


def check_slides(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> None:
    """Raises RecordingError for slides whose positions have no unit and are no lengths (see `no_lengths`)."""
    if said := no_lengths(joints, recordings):
        raise RecordingError(said)


def no_lengths(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> str:
    """A sentence on the first slide whose positions have no unit and are far beyond its range in m and in mm, and no shares
    of it; '' where there is none.
    """
    slides = {j: way for j, way in joints.items() if way.slides and way.range is not None}
    without = [r for r in recordings if r.has("position") and not r.channel("position").unit]
    in_shares = shares(slides, without)
    for slide in (j for j in slides if j not in in_shares):
        metres = unsaid(without, slide)
        if len(metres) and beyond(slides[slide], metres) and not inside(slides[slide], metres):
            (low, high), most = slides[slide].ends, float(np.abs(metres).max())
            return (
                f"{listed(tuple(r.name for r in without))}: positions have no unit, and '{slide}', which reaches {most:.4g}, "
                f"is far beyond its range in the model ({low:.3g} to {high:.3g} m) in m and in mm: {_SAY_UNITS}"
            )
    return ""


def _times_as_far(recording: Recording, label: str) -> float:
    """How many times as far a joint moves as it is told to in rad, which it follows; 0 where it does not, or is not told."""
    command, position = command_of(recording), recording.channel("position")
    if command is None or label not in command.labels or command.unit_of(label) != "rad":
        return 0.0
    told, seen = command.select([label]).at(position.time, hold=True)[:, 0], position.column(label)
    good = np.isfinite(told) & np.isfinite(seen)
    if correlation(told, seen) < CORRELATED:
        return 0.0
    return float(np.std(seen[good]) / np.std(told[good]))
