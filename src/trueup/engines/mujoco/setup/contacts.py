# SPDX-License-Identifier: Apache-2.0
"""Pairs of bodies that do not touch each other, named or not."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import mujoco


def without_contacts(given: mujoco.MjSpec, pairs: Iterable[tuple[int, int]]) -> tuple[mujoco.MjSpec, dict[int, str]]:
    """A copy of a specification in which these pairs of bodies do not touch, and the bodies' names: those without get one."""
    spec = given.copy()
    taken, names = {b.name for b in given.bodies}, dict[int, str]()
    for old, new in zip(given.bodies, spec.bodies, strict=True):
        new.name = old.name or next(n for k in itertools.count() if (n := f"body {old.id + k}") not in taken)
        taken.add(new.name)
        names[old.id] = new.name
    for first, second in pairs:
        exclude = spec.add_exclude()
        exclude.bodyname1, exclude.bodyname2 = names[first], names[second]
    return spec, names
