# SPDX-License-Identifier: Apache-2.0
"""All quantities by name: trueup's own, those of installed packages, and any that is named 'module:attribute'."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from trueup.articulated.quantities.bodies import BODIES
from trueup.articulated.quantities.drives import DRIVES
from trueup.articulated.quantities.joints import JOINTS
from trueup.articulated.quantities.quantity import Quantity
from trueup.articulated.quantities.signals import SIGNALS
from trueup.articulated.quantities.world import WORLDS
from trueup.errors import ParameterError, unknown_name
from trueup.extensions import addressed, registered

GROUP = "trueup.quantities"
"""Entry points of other packages: a name and 'module:attribute' of a Quantity."""


def quantities() -> Mapping[str, Quantity]:
    """Trueup's own quantities by name."""
    return {q.name: q for q in (*DRIVES, *JOINTS, *SIGNALS, *BODIES, *WORLDS)}


def quantity(name: str, base: Path | None = None) -> Quantity:
    """One quantity, by its name or as 'module:attribute' of an installed module or one in the folder `base`.

    Raises UnknownNameError, which lists all names, and ParameterError for an address that leads to no quantity.
    """
    own = quantities()
    if name in own:
        return own[name]
    address = name if ":" in name else registered(GROUP).get(name, "")
    if not address:
        known = {*own, *registered(GROUP)}
        raise unknown_name("quantity", name, known, 'what may be calibrated (or name your own as "module:attribute")')
    there = addressed(address, base or Path(), lambda text: ParameterError(f"quantity '{name}': {text}"))
    if not isinstance(there, Quantity):
        raise ParameterError(f"quantity '{name}' is a {type(there).__name__}, not a trueup.Quantity")
    return replace(there, origin=name)
