# SPDX-License-Identifier: Apache-2.0
"""What every quantity must do, and every engine that offers attributes for quantities."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.described import StoredCopies
from trueup.articulated.model import ATTRIBUTES, WORLD, Model, Writable
from trueup.articulated.quantities.quantity import FAMILIES, Quantity
from trueup.engines.simulator import Simulator
from trueup.errors import UnknownNameError
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE, ROUNDED
from trueup.testing.broken import require
from trueup.trial import Trial


def check_quantity(
    quantity: Quantity, model: Model, recording: Recording, simulator: Callable[[Sequence[Declaration]], Simulator], *,
    of: tuple[str, ...] = ("*",), effect: bool = True, extra: Mapping[str, Sequence[str]] | None = None,
) -> None:  # fmt: skip
    """Checks the contract of a `Quantity` at elements of a model, tied to one value; `simulator` makes one of lines.

    It says what it is of, its unit and its title; its bounds hold the nominal value; what is written is read back as the
    nominal value; and a run of `recording` changes with it, or does not where `effect` is False: an honest 'no effect'.
    `extra` names channels and recordings (see `declare`). Raises ContractBrokenError (an AssertionError).
    """
    require(quantity.name.isidentifier(), f"the name '{quantity.name}' is none that a file can hold as one word")
    known = quantity.family in FAMILIES or bool(model.names(quantity.family))
    require(known, f"'{quantity.name}' is of '{quantity.family}', none of {', '.join(FAMILIES)}, nor of '{model.name}'")
    require(bool(quantity.title), f"'{quantity.name}' has no title")
    lines = [Declaration(quantity, of, tie="all")]
    space, (assignment,) = declare(model, lines, extra)
    (parameter,) = space.parameters
    require(parameter.unit in quantity.units(), f"'{quantity.name}' is in '{parameter.unit}', not {quantity.units()}")
    target = assignment.targets[0]
    lower, upper = quantity.bounds(parameter.nominal)
    require(lower <= parameter.nominal <= upper, f"nominal {parameter.nominal} of '{quantity.name}' is out of bounds")
    values = space.from_unit(np.array([[0.3], [0.7]]))
    if quantity.written:
        _check_read_back(quantity, model, target, values[:, 0])
    made = simulator(lines)
    trial = Trial.of(recording, made.observable(recording))
    (run,) = made.rollout([trial], values)
    require(len(run.failures) < len(values), f"every run with another '{quantity.name}' fails: {dict(run.failures)}")
    moved = any(not np.array_equal(c[0], c[1], equal_nan=True) for c in run.channels.values())
    require(moved or not effect, f"'{quantity.name}' at {target} changes nothing in '{recording.name}'")
    require(effect or not moved, f"'{quantity.name}' at {target} changes '{recording.name}', though it is said not to")


class _Written:
    """One row of copies as if it had been loaded so."""

    def __init__(self, model: Model, copies: StoredCopies, row: int) -> None:
        self._model, self._copies, self._row = model, copies, row
        self.name, self.width = model.name, model.width
        self.names, self.drives, self.columns = model.names, model.drives, model.columns

    def get(self, attribute: str, name: str) -> Array:
        return self._copies.get(attribute, name)[self._row : self._row + 1]


def _check_read_back(quantity: Quantity, model: Model, target: str, values: Array) -> None:
    copies = StoredCopies(model, len(values))
    quantity.write(copies, target, {quantity.name: values})
    reads = quantity.start is None or type(quantity).nominal is not Quantity.nominal
    if not reads and type(quantity).write is not Quantity.write:
        return  # relative to where the model has it
    for row, value in enumerate(values):
        view = _Written(model, copies, row)
        read = quantity.nominal(view, target) if reads else float(view.get(quantity.attributes[0], target)[0])
        require(np.isclose(read, value, rtol=1e-5), f"'{quantity.name}' is written as {value} and read as {read}")


def check_attributes(model: Model, copies: Writable, rows: int) -> tuple[str, ...]:
    """Checks what an engine offers for quantities (`articulated.model`), with copies that may be spoilt; returns the names.

    Each attribute that it offers of the first element of a family has a row for each copy, is read as it was written, in
    each copy by itself; reading hands out the caller's own array; what is not there is named. Raises ContractBrokenError
    (an AssertionError).
    """
    columns = model.columns()
    require(set(columns) == set(model.names("actuator")), f"columns {columns} are not those of the actuators")
    require(all(0 <= c < model.width for c in columns.values()), f"columns {columns} exceed the width {model.width}")
    offered = []
    for attribute in ATTRIBUTES:
        family = attribute.partition(".")[0]
        elements = {"joint": tuple(model.drives()), WORLD: (WORLD,)}.get(family) or model.names(family)
        element = next((n for n in elements if n and n != WORLD), WORLD)
        try:
            before = model.get(attribute, element)
        except UnknownNameError:
            continue
        require(len(before) == 1, f"a model is one copy, but '{attribute}' has shape {before.shape}")
        offered.append(attribute)
        _check_attribute(copies, attribute, element, before, rows)
        require(
            np.array_equal(model.get(attribute, element), before), f"writing '{attribute}' changed the loaded model"
        )
    require(bool(offered), f"model '{model.name}' offers none of the attributes that quantities write")
    try:
        model.get("joint.damping", "no such joint")
    except UnknownNameError:
        return tuple(offered)
    require(False, "an attribute of a joint that is not there is read as if it were")
    return ()


def _check_attribute(copies: Writable, attribute: str, element: str, before: Array, rows: int) -> None:
    factors = 1.1 + 0.1 * np.arange(rows).reshape(rows, *[1] * (before.ndim - 1))
    shift = 0.0 if attribute == "body.inertia" else 1e-3  # which would no longer be an inertia
    wanted = before * factors + shift * factors
    try:
        copies.set(attribute, element, wanted)
    except UnknownNameError:
        require("only read" in ATTRIBUTES[attribute] or attribute == "actuator.delay", f"'{attribute}' is not written")
        return
    read = copies.get(attribute, element)
    require(read.shape == wanted.shape, f"'{attribute}' of {rows} copies is read as {read.shape}, not {wanted.shape}")
    require(
        np.allclose(read, wanted, rtol=ROUNDED, atol=NEGLIGIBLE),
        f"'{attribute}' is written as {wanted}, read as {read}",
    )
    read += 1.0
    require(
        np.allclose(copies.get(attribute, element), wanted), f"reading '{attribute}' hands out the engine's own array"
    )
