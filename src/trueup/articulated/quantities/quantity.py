# SPDX-License-Identifier: Apache-2.0
"""A quantity: all that is known of one kind of thing that may be calibrated, and what its values do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.changes import Changes
from trueup.articulated.laws import LawFactory
from trueup.articulated.model import WORLD, Model, Writable, servos
from trueup.errors import ModelError, UnknownNameError
from trueup.samples import SLIGHT

Bounds = Callable[[float], tuple[float, float]]

FAMILIES = ("actuator", "joint", "body", "geom", "world", "channel", "recording")
LINEAR = {
    "N m/rad": "N/m", "N m/rad3": "N/m3", "N m s/rad": "N s/m", "N m s2/rad2": "N s2/m2", "N m": "N", "kg m2": "kg",
    "rad": "m", "rad/s": "m/s", "rad/s2": "m/s2",
}  # fmt: skip
"""Units of hinges to those of slides."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One kind of thing that may be calibrated. Its values go into an attribute of the model, into signals, or act in each
    step; a subclass overrides `nominal` or `write` where that takes more than copying a number.
    """

    name: str
    family: str
    """What its targets are: one of FAMILIES, or one of an engine's own."""
    unit: str
    """At hinges; `unit_at` says it for slides."""
    title: str
    bounds: Bounds
    """(lower, upper) from a nominal value, generous: a factor where a value is usually known to a factor."""
    scale: str = "linear"
    shown_by: str = ""
    """Which motion shows it."""
    attributes: tuple[str, ...] = ()
    """What is written into the model (see `articulated.model.ATTRIBUTES`); a model file can hold what is kept there."""
    signals: tuple[str, ...] = ()
    """What is added to signals (see `changes.SIGNALS`)."""
    law: LawFactory | None = None
    """What acts in each step, for all quantities with the same law together."""
    start: float | None = 0.0
    """The nominal value; None: what the model's attribute has."""
    nothing: float | None = None
    """The value with which it is as if there were none of it (a limit: so high that nothing meets it); None: not known."""
    servos_only: bool = False
    """Of position servos, where the model has any."""
    mirrored: bool = False
    """Whether the sign changes between left and right."""
    needs: str = ""
    """What a model must be prepared with: 'slack', 'gear' (a second joint), 'limit' (of the force), 'held' (weight), 'floor',
    'shapes'."""
    group: str = ""
    """Quantities of one group are written together: `write` is called once with the values of all."""
    turn: int = 0
    """Those of a later turn are written after the others: what they write depends on what others have written."""
    reach: Callable[[Model, str], float] | None = None
    """How far beyond its usual upper bound one target may be sought, by what drives it; 0 where that is not known."""
    little: Callable[[Model, str], float] | None = None
    """What is hardly any of it at one target, where its usual lower bound may be much there."""
    origin: str = ""
    """'module:attribute' where it was named so."""

    def nominal(self, model: Model, target: str) -> float:
        """The model's own value of one target, in `unit_at`. Raises ModelError for an actuator that is no servo."""
        if self.servos_only and self.start is None:
            check_servo(model, target)
        return float(model.get(self.attributes[0], target)[0]) if self.start is None else self.start

    def least(self, model: Model, target: str, nominal: float) -> float:
        """The lower bound at one target that starts at `nominal`: the usual one, or where that may be much, hardly any."""
        little = self.little(model, target) if self.little is not None else 0.0
        usual = self.bounds(nominal)[0]
        return min(usual, little) if little > 0.0 else usual

    def begun(self, model: Model, target: str, nominal: float) -> float:
        """Where a search along a log scale begins at least: hardly any of it has hardly a slope. What a motor drives has some
        of a gear's, as much as the target moves at most; where nothing drives, it begins halfway to hardly any.
        """
        least, usual = self.least(model, target, nominal), self.bounds(nominal)[0]
        if model.drives().get(target):
            return max(least, min(usual, least / SLIGHT))
        return math.sqrt(least * usual) if 0.0 < least < usual else least

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """Writes values (b,) of the group's quantities, by their names, into a batch of models."""
        for attribute in self.attributes:
            copies.set(attribute, target, values[self.name])

    def change(self, changes: Changes, target: str, value: Array) -> None:
        """Adds a value (b,) to the signals that it changes."""
        for signal in self.signals:
            changes.add(signal, target, value)

    def choices(self, model: Model, extra: Mapping[str, Sequence[str]]) -> dict[str, str]:
        """What a user may write, to the target's name. `extra` lists names that no model has ('channel', 'recording')."""
        match self.family:
            case "actuator":
                return _actuators(model, self.servos_only)
            case "joint":
                return {n: n for n in model.drives()}
            case "world":
                return {WORLD: WORLD}
            case "channel" | "recording":
                return {n: n for n in extra.get(self.family, ())}
        return {
            n: n
            for n in model.names(self.family)
            if n and n != WORLD and (self.needs != "shapes" or _touches(model, n))
        }

    def units(self) -> tuple[str, ...]:
        """The units that it may have: at hinges, at slides."""
        return self.unit, LINEAR.get(self.unit, self.unit)

    def unit_at(self, model: Model, target: str) -> str:
        """The unit at one joint or actuator: m for rad where the joint slides."""
        slides = self.family in ("joint", "actuator") and model.get(f"{self.family}.slides", target)[0]
        return self.units()[1] if slides else self.unit

    def acts(self, values: Array) -> bool:
        """Whether it acts in each step with any of these values."""
        return self.law is not None and (self.nothing is None or bool(np.any(values != self.nothing)))

    @property
    def written(self) -> bool:
        """Whether values go into a model, in the way of `write`: not where they change signals or act in each step."""
        own = type(self).write is not Quantity.write
        return own or (bool(self.attributes) and not self.signals and self.law is None)


def _touches(model: Model, geom: str) -> bool:
    """Whether a shape can touch anything; where the engine does not say, all do."""
    try:
        return bool(model.get("geom.touches", geom)[0])
    except UnknownNameError:
        return True


def _actuators(model: Model, servos_only: bool) -> dict[str, str]:
    """Actuators also answer to the name of their joint."""
    choices = {n: n for n in model.names("actuator") if n}
    for joint, actuator in model.drives().items():
        if actuator:
            choices.setdefault(joint, actuator)
    kept = servos(model) if servos_only else ()
    return {a: n for a, n in choices.items() if n in kept} if kept else choices


def check_servo(model: Model, actuator: str) -> None:
    """Raises ModelError for an actuator that is no position servo, naming those that are."""
    if not model.get("actuator.servo", actuator)[0]:
        raise ModelError(
            f"actuator '{actuator}' is not a position servo, so it has no kp, kv or dead band; "
            f"position servos are: {', '.join(servos(model)) or 'none'}"
        )


def factor(down: float, up: float, least: float) -> Bounds:
    """Bounds a factor below and above the nominal, which counts as `least` if it is smaller (a friction of zero)."""

    def bounds(nominal: float) -> tuple[float, float]:
        size = max(nominal, least)
        return (min(size / down, nominal) if nominal > 0 else size / down), size * up

    return bounds


def around(half: float) -> Bounds:
    """Bounds `half` below and above the nominal."""
    return lambda nominal: (nominal - half, nominal + half)


def between(lower: float, upper: float) -> Bounds:
    """The same bounds for every nominal, wide enough to hold it."""
    return lambda nominal: (min(lower, nominal), max(upper, nominal))
