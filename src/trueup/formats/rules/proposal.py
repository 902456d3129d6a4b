# SPDX-License-Identifier: Apache-2.0
"""What a column is taken for: a role and a label, or a channel of its own name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trueup.formats.rules import joints
from trueup.formats.rules.names import AXES, axes
from trueup.formats.rules.rule import Column

_PLACES = frozenset("xyz")


@dataclass(frozen=True, eq=False)
class Proposal:
    """What a column is taken for: a role and a label; '' for the role where no rule knows."""

    column: Column
    role: str
    label: str
    unit: str


def unchanged(column: Column) -> Proposal:
    """A column under its own name; those that differ by an axis or an index go together."""
    plain = own_words(column)
    tail = [word for word in plain if word in axes(plain)]
    head = [word for word in plain if word not in tail]
    whole = "_".join(plain) or column.name
    unit = (
        joints.read(column.parts).unit or column.declared or (column.parts.tail if plain != column.parts.words else "")
    )
    return Proposal(column, "", "_".join(tail) if head and tail else whole, unit)


def own_words(column: Column) -> list[str]:
    """The words of a column's name, without the unit behind an axis (X_mm, gyro_x_dps)."""
    bare = column.parts.bare
    return bare if bare and (AXES.issuperset(bare) or bare[-1] in _PLACES) else column.parts.words


def threes(proposals: Sequence[Proposal], roles: Sequence[str]) -> list[list[Column]]:
    """Columns of these roles that are three numbers of one thing: a list of three, or numbered ones."""
    rows: dict[tuple[str, ...], list[Column]] = {}
    for p in proposals:
        if p.role in roles:
            plain = (word for word in p.column.parts.words if p.column.width > 1 or not word.isdigit())
            rows.setdefault((p.role, p.column.table.name, *plain), []).append(p.column)
    return [row for row in rows.values() if sum(column.width for column in row) == 3]
