# SPDX-License-Identifier: Apache-2.0
"""What `ros2 topic echo --csv` prints of joint states: no names of columns, the joints' own names in each row."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from trueup.formats.table import Table
from trueup.units import to_si

_PARTS = ("position", "velocity", "effort")
"""Of sensor_msgs/JointState, in its order; the last ones may be empty."""


def with_names(table: Table) -> Table:
    """The table with names, where it has none and is seconds, nanoseconds, a frame, k names and k, 2 k or 3 k numbers."""
    places = {name: match for name in (*table.columns, *table.text) if (match := re.fullmatch(r"column_(\d+)", name))}
    if len(places) < len(table.columns) + len(table.text):
        return table
    order = sorted(places, key=lambda name: int(places[name][1]))
    numbers = [name for name in order if name in table.columns and table.columns[name].ndim == 1]
    words = [name for name in order if name in table.text]
    if len(numbers) < 3 or numbers[:2] != order[:2] or not _is_stamp(table, numbers[:2]):
        return table
    rest, frame = numbers[2:], 3
    names = [name for name in words if int(places[name][1]) > frame]
    joints = [table.text[name][0].strip() for name in names]
    fixed = all(len(set(table.text[name])) == 1 for name in names)
    follows = [int(places[name][1]) for name in (*names, *rest)] == list(
        range(frame + 1, frame + 1 + len(names) + len(rest))
    )
    if (
        not fixed
        or not follows
        or len(set(joints)) != len(joints)
        or len(rest) not in (len(joints) * k for k in (1, 2, 3))
    ):
        return table
    called = [f"{part}/{joint}" for part in _PARTS for joint in joints]
    named = dict(zip(numbers, ["stamp.sec", "stamp.nanosec", *called], strict=False))
    return replace(table, columns={named[name]: table.columns[name] for name in numbers}, text={})


def _is_stamp(table: Table, names: list[str]) -> bool:
    """Whether two columns are seconds and the nanoseconds beside them."""
    seconds, rest = (table.columns[name] for name in names)
    whole = all(np.all(values == np.round(values)) for values in (seconds, rest))
    return whole and bool(np.all(np.diff(seconds) >= 0.0) and rest.min() >= 0.0 and rest.max() * to_si("ns")[1] < 1.0)
