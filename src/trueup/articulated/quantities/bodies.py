# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in bodies: mass, centre of mass, and inertia in coordinates that stay physical."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.inertia import COMPONENTS, from_log_cholesky, log_cholesky, second_moments
from trueup.articulated.model import Attributes, Model, Writable
from trueup.articulated.quantities.quantity import Bounds, Quantity, around, factor


@dataclass(frozen=True, kw_only=True)
class CentreOfMass(Quantity):
    """One coordinate of a body's centre of mass."""

    axis: int

    def nominal(self, model: Model, target: str) -> float:
        """See Quantity."""
        return float(model.get("body.com", target)[0, self.axis])

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """See Quantity."""
        com = np.array(copies.get("body.com", target))
        com[:, self.axis] = values[self.name]
        copies.set("body.com", target, com)


@dataclass(frozen=True, kw_only=True)
class InertiaComponent(Quantity):
    """One of the ten log-Cholesky coordinates of a body's pseudo-inertia; all that are declared are written at once."""

    component: int

    def nominal(self, model: Model, target: str) -> float:
        """See Quantity."""
        return float(_coordinates(model, target)[0, self.component])

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """See Quantity."""
        theta = _coordinates(copies, target)
        for name, value in values.items():
            theta[:, COMPONENTS.index(name.removeprefix("inertia_"))] = value
        mass, com, inertia = from_log_cholesky(theta)
        copies.set("body.mass", target, mass)
        copies.set("body.com", target, com)
        copies.set("body.inertia", target, inertia)


@dataclass(frozen=True, kw_only=True)
class Spread(Quantity):
    """How far from its centre of mass a body's mass lies along one of its axes (root mean square): of which its moments of
    inertia are made, so that all three, whatever they are, belong to a body that can exist.
    """

    axis: int

    def nominal(self, model: Model, target: str) -> float:
        """See Quantity."""
        return float(_spreads(model, target)[0, self.axis])

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """See Quantity."""
        before = _spreads(copies, target)
        scaled = np.ones_like(before)
        scaled[:, self.axis] = values[self.name] / before[:, self.axis]
        moments = second_moments(copies.get("body.inertia", target)) * scaled[:, :, None] * scaled[:, None, :]
        inertia = np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3) - moments
        copies.set("body.inertia", target, inertia)


def _spreads(copies: Attributes, body: str) -> Array:
    """(b, 3) in m along the body's axes; of a plate a thousandth of the largest across."""
    moments = np.diagonal(second_moments(copies.get("body.inertia", body)), axis1=1, axis2=2)
    least = 1e-6 * moments.max(axis=1, keepdims=True)
    return np.sqrt(np.maximum(moments, least) / copies.get("body.mass", body)[:, None])


def _coordinates(copies: Attributes, body: str) -> Array:
    """(b, 10) in the order of COMPONENTS."""
    return log_cholesky(copies.get("body.mass", body), copies.get("body.com", body), copies.get("body.inertia", body))


def _bounds(component: str) -> Bounds:
    """A factor of four in mass, of three in extent; a tenth of a metre of the centre of mass."""
    if component.startswith("t"):
        return around(0.1)
    if component == "alpha":
        return around(0.5 * np.log(4.0))
    return around(np.log(3.0)) if component.startswith("d") else around(0.2)


def _carried(model: Model, target: str) -> float:
    """What a body may have to carry that its file does not know: robots lift up to their own weight, whatever the part that
    a file has in place of the load weighs.
    """
    return float(sum(model.get("body.mass", body)[0] for body in model.names("body") if body))


BODIES = (
    Quantity(
        name="mass", family="body", unit="kg", title="mass (inertia scales along)", scale="log",
        bounds=factor(4, 4, 1e-3), attributes=("body.mass",), start=None, reach=_carried,
        shown_by="accelerating and holding against gravity in several poses",
    ),
    Quantity(
        name="weight_held", family="body", unit="", title="share of the weight that gravity compensation holds",
        bounds=around(0.5), attributes=("body.held",), start=None, needs="held",
        shown_by="holding and moving slowly in several poses",
    ),
    *(
        CentreOfMass(
            name=f"com_{axis}", family="body", unit="m", title=f"centre of mass, {axis} in the body frame",
            bounds=around(0.1), attributes=("body.com",), axis=i, mirrored=axis == "y",
        )
        for i, axis in enumerate("xyz")
    ),
    *(
        Spread(
            name=f"spread_{axis}", family="body", unit="m", title=f"distance of the mass from its centre along {axis}, rms",
            scale="log", bounds=factor(2, 2, 1e-4), attributes=("body.inertia",), turn=1, axis=i,
            shown_by="turning and tilting fast",
        )
        for i, axis in enumerate("xyz")
    ),
    *(
        InertiaComponent(
            name=f"inertia_{component}", family="body", unit="m" if component.startswith("t") else "",
            title=f"log-Cholesky {component} of the pseudo-inertia", bounds=_bounds(component),
            attributes=("body.mass", "body.com", "body.inertia"), group="inertia", turn=1, component=i,
            mirrored=component in ("t2", "s12", "s23"),
        )
        for i, component in enumerate(COMPONENTS)
    ),
)  # fmt: skip
