# SPDX-License-Identifier: Apache-2.0
"""Lists of numbers without names, as matrices of MATLAB or arrays of NumPy: which are the joints', and their labels."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.formats.rules import joints
from trueup.formats.rules.coherence import FAMILIES, OF_ANY_DRIVE
from trueup.formats.rules.names import words
from trueup.formats.rules.proposal import Proposal, unchanged
from trueup.formats.rules.rule import Example

EXAMPLES = (
    # Of two lists without names one is the joints': a place stands beside them.
    Example("t,q,pos,q_cmd", "0 [1;2;3;4] [5;6;7] [1;2;3;4]|.1 [2;2;3;4] [5;6;8] [1;2;3;4]|.2 [2;3;3;4] [5;7;8] [2;3;4;4]",
            "command[rad] joint_1 joint_2 joint_3 joint_4; position[rad] joint_1 joint_2 joint_3 joint_4; pos[] 1 2 3"),
)  # fmt: skip


def in_parts(group: Sequence[Proposal]) -> tuple[str, ...]:
    """Labels of the numbers in cells that hold lists: joint_1 and so on, but by its name what is a part of its own beside
    joints without a name (gripper_qpos beside joint_pos), which else would be counted among them.
    """
    plain = [frozenset(words(p.label)) for p in group]
    shared = frozenset.intersection(*plain)
    parts = ["_".join(w for w in words(p.label) if w not in shared | OF_ANY_DRIVE and not w.isdigit()) for p in group]
    parts = parts if "" in parts else [""] * len(parts)
    of = [part or "joint" for part, p in zip(parts, group, strict=True) for _ in range(p.column.width)]
    return tuple(f"{part}_{of[: i + 1].count(part)}" for i, part in enumerate(of))


def without_other_lists(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Of several lists of numbers without names that are called positions (q beside a place pos), speeds, ... one is the
    joints': one as long as what is commanded, or as most lists are; of these one called as what is commanded, else the first.

    A state that is no longer called anything is the joints' where it is as long as their commands.
    """
    lists = {p: joints.read(p.column.parts) for p in proposals if p.role and p.column.values.ndim > 1
             and p.column.name not in p.column.table.named}  # fmt: skip
    lists = {p: reading for p, reading in lists.items() if not reading.label}
    told = {p.column.width for p in lists if p.role.startswith("command")}
    words_told = {word for p in lists if p.role.startswith("command") for word in p.column.parts.words}
    usual = [p.column.width for p in lists]
    rows: dict[tuple[str, str, str], list[Proposal]] = {}
    for p in lists:
        key = (p.role, p.column.table.name, next((word for word in FAMILIES if word in p.column.parts.words), ""))
        rows.setdefault(key, []).append(p)

    def fitness(p: Proposal) -> tuple[bool, int, int, bool]:
        width = p.column.width
        return width in told, usual.count(width), width, bool(words_told & set(p.column.parts.words))

    aside = {p.column for row in rows.values() for p in row if p is not max(row, key=fitness)}
    aside |= {p.column for p, reading in lists.items()
              if p.role == "position" and not reading.kind and told and p.column.width not in told}  # fmt: skip
    return [unchanged(p.column) if p.column in aside else p for p in proposals]
