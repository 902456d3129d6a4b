# SPDX-License-Identifier: Apache-2.0
"""Recordings that users' own code made, in SI: files are converted where they are read, these come as they are."""

from __future__ import annotations

import numpy as np

from trueup.recording import Channel, Recording
from trueup.units import canonical, to_si


def in_si(recording: Recording) -> Recording:
    """With channels in deg, mm or rpm in rad, m and rad/s; shares (%), and units that are not known, stay as they are."""
    converted = {name: _in_si(channel) for name, channel in recording.channels.items()}
    if all(converted[name] is channel for name, channel in recording.channels.items()):
        return recording
    return recording.replace(channels=converted)


def _in_si(channel: Channel) -> Channel:
    said = channel.units or (channel.unit,) * len(channel.labels)
    found = [to_si(unit) if canonical(unit) is not None else (unit, 1.0, 0.0) for unit in (channel.unit, *said)]
    (unit, _, _), *each = [x if x[0] else (u, 1.0, 0.0) for x, u in zip(found, (channel.unit, *said), strict=True)]
    factors, offsets = (np.array([x[k] for x in each]) for k in (1, 2))
    units = tuple(x[0] for x in each) if channel.units else ()
    if np.all(factors == 1.0) and np.all(offsets == 0.0):  # m/s2 is m/s^2
        return channel if (unit, units) == (channel.unit, channel.units) else channel.replace(unit=unit, units=units)
    return channel.replace(unit=unit, units=units, values=channel.values * factors + offsets)
