# SPDX-License-Identifier: Apache-2.0
"""Which quantity of which elements each parameter is, and what values of all of them do: to models, signals, steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from trueup.arrays import Array
from trueup.articulated.changes import Changes
from trueup.articulated.laws import Law, LawFactory, Term
from trueup.articulated.model import Copies, Model, Writable
from trueup.articulated.quantities.quantity import Quantity


@dataclass(frozen=True)
class Assignment:
    """What one parameter sets: a quantity of the elements that share its value, with a sign each (mirrored sides)."""

    quantity: Quantity
    targets: tuple[str, ...]
    signs: tuple[float, ...] = ()

    @property
    def kind(self) -> str:
        """The quantity's name."""
        return self.quantity.name

    def spread(self, values: Array) -> Iterator[tuple[str, Array]]:
        """Each target and its values (b,), of those of the parameter (b,)."""
        for i, target in enumerate(self.targets):
            yield target, values * self.signs[i] if self.signs else values


def needs(assignments: Sequence[Assignment], what: str) -> tuple[str, ...]:
    """The targets for which a model must be prepared with `what` (see `Quantity.needs`)."""
    return tuple(dict.fromkeys(t for a in assignments if a.quantity.needs == what for t in a.targets))


def write(assignments: Sequence[Assignment], values: Array, copies: Writable) -> None:
    """Writes values (b, n) of the parameters into a batch of models. What is no part of a model is skipped."""
    together: dict[tuple[int, str, str], tuple[Quantity, dict[str, Array]]] = {}
    for a, column in zip(assignments, values.T, strict=True):
        for target, value in a.spread(column) if a.quantity.written else ():
            key = (a.quantity.turn, a.quantity.group or a.quantity.name, target)
            together.setdefault(key, (a.quantity, {}))[1][a.quantity.name] = value
    for (_, _, target), (quantity, named) in sorted(together.items(), key=lambda item: item[0][0]):
        quantity.write(copies, target, named)


def changes(assignments: Sequence[Assignment], values: Array) -> Changes:
    """What values (b, n) of the parameters change in signals."""
    made = Changes()
    for a, column in zip(assignments, values.T, strict=True):
        for target, value in a.spread(column):
            a.quantity.change(made, target, value)
    return made


def acts_in_each_step(assignments: Sequence[Assignment], values: Array) -> bool:
    """Whether any law acts with values (b, n)."""
    return any(law is not None for law in _acting(assignments, values))


def _acting(assignments: Sequence[Assignment], values: Array) -> set[LawFactory | None]:
    return {a.quantity.law for a, column in zip(assignments, values.T, strict=True) if a.quantity.acts(column)}


def laws(assignments: Sequence[Assignment], values: Array, model: Model, copies: Copies) -> list[Law]:
    """What acts in each step with values (b, n), once they are written: no law of which there is nothing."""
    terms: dict[LawFactory, list[Term]] = {}
    acting = _acting(assignments, values)
    for a, column in zip(assignments, values.T, strict=True):
        if a.quantity.law is not None and a.quantity.law in acting:
            terms.setdefault(a.quantity.law, []).extend(Term(a.kind, t, v) for t, v in a.spread(column))
    return [law(model, copies, found) for law, found in terms.items()]
