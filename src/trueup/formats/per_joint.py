# SPDX-License-Identifier: Apache-2.0
"""Files of one joint each, joint1.txt, joint2.txt, ...: one recording together, not one each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from trueup.formats.table import Table

_JOINT = re.compile(r"(?:.*[_\- ])?((?:joint|axis|motor|link|dof|j|a)[_\- ]?\d+)", re.IGNORECASE)


def joined(tables: Sequence[Table]) -> Table | None:
    """One table of files that hold the same columns for one joint each, told from their names; None for other files.

    Columns get the joint into their name ("torque_joint2"). Columns that are the same in all files, as time is, stay one.
    Files of other lengths or other names are runs, not joints.
    """
    found = [_JOINT.fullmatch(PurePath(table.name).stem) for table in tables]
    names = [match[1] for match in found if match]
    alike = {(tuple(t.columns), t.length) for t in tables}
    if (
        len(names) != len(tables)
        or len(set(names)) < max(2, len(tables))
        or len(alike) > 1
        or any(t.text for t in tables)
    ):
        return None
    columns, units = {}, {}
    for name in tables[0].columns:
        values = [table.columns[name] for table in tables]
        one = all(np.array_equal(values[0], other, equal_nan=True) for other in values[1:])
        for own, column in zip([name] if one else [f"{name}_{joint}" for joint in names], values, strict=False):
            columns[own] = column
            if name in tables[0].units:
                units[own] = tables[0].units[name]
    return replace(tables[0], columns=columns, units=units, warnings=tuple(w for t in tables for w in t.warnings))
