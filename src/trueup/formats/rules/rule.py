# SPDX-License-Identifier: Apache-2.0
"""A rule: names that propose a kind of signal, numbers that speak for or against it, and an example that a test runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueup.arrays import Array
from trueup.formats.rules.names import Name, taken_apart
from trueup.formats.table import Table
from trueup.units import canonical


@dataclass(frozen=True)
class Example:
    """A small log and what is to be made of it."""

    header: str
    """Names of columns, separated by commas."""
    rows: str
    """Numbers separated by blanks, lines by |."""
    expected: str
    """Channels with their unit in the mapping (units with commas) and labels: "command[rad] hip knee; current[] hip"."""


@dataclass(frozen=True)
class Rule:
    """One kind of signal."""

    kind: str
    """position, velocity, heading, ...: what it is called in channels and labels."""
    names: str
    """What people call it, separated by commas; several words of one name may stand in any order."""
    examples: tuple[Example, ...]
    unit: str = ""
    """SI unit in which it is taken where nothing says another; '' leaves it open."""
    also: tuple[str, ...] = ()
    """Other SI units that it may have, such as m for the position of a slide."""
    possible: Callable[[Array], bool] | None = None
    """Whether numbers (T,) or (T, k), all finite, can be such a signal; None for any."""

    def fits(self, unit: str) -> bool:
        """Whether a signal of this kind may have a unit in SI."""
        return unit in (self.unit, *self.also)


@dataclass(frozen=True, eq=False)
class Column:
    """One column of numbers, as rules look at it."""

    table: Table
    name: str
    read_as: str
    """The name with abbreviations written out that the other columns make clear."""
    clock: str
    """The second clock that it follows; '' for the table's main clock."""
    file: str
    """Name of its file or topic where there are several, else ''."""

    @cached_property
    def parts(self) -> Name:
        """Its name taken apart."""
        return taken_apart(self.read_as)

    @property
    def values(self) -> Array:
        """(T,), or (T, k) where a cell holds a list."""
        return self.table.columns[self.name]

    @property
    def width(self) -> int:
        """Numbers in a cell."""
        return self.table.width(self.name)

    @cached_property
    def known(self) -> Array:
        """(m,) or (m, k) its rows without a missing number."""
        values = self.values if self.values.ndim > 1 else self.values[:, None]
        kept = values[np.isfinite(values).all(axis=1)]
        return kept if self.values.ndim > 1 else kept[:, 0]

    @property
    def whole(self) -> bool:
        """Whether it has numbers, and none but whole ones."""
        return bool(self.known.size) and bool(np.all(self.known == np.round(self.known)))

    @property
    def largest(self) -> float:
        """Of its numbers without their sign."""
        return float(np.nanmax(np.abs(np.where(np.isfinite(self.values), self.values, np.nan)), initial=0.0))

    @property
    def declared(self) -> str:
        """The unit that the file declares or the name has in brackets, as `units` writes it; '' for none."""
        return self.parts.bracketed or canonical(self.table.units.get(self.name, "")) or ""


@dataclass(frozen=True, eq=False)
class Part:
    """One channel of a log as rules make it of columns."""

    channel: str
    columns: tuple[Column, ...]
    labels: tuple[str, ...]
    unit: str
    scale: tuple[float, ...]
    notes: tuple[str, ...]
    units: tuple[str, ...] = ()
    """One for each label where they differ."""
    offset: tuple[float, ...] = (0.0,)
