# SPDX-License-Identifier: Apache-2.0
"""What is known in proportion to masses alone: factors on all torques and what else of force and inertia was found.

A robot whose masses, rotors, friction and torques are all a times as large moves as before, on a floor too: recordings tell
nothing of a where factors on the torques are searched, and the masses in the file alone say it (M. Gautier and S. Briot, J.
Dynamic Systems, Measurement and Control 136(5), 2014: drive gains of robots need a mass that was weighed). Factors of the
motors that are off alike have one cause. It may be their torque constant, or those masses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array
from trueup.calibration import NORMAL_95, Estimate
from trueup.errors import listed
from trueup.evidence import STANDARD_ERRORS
from trueup.parameters import ParameterSpace

_RULES = 2.0
"""Times its own width from which on an interval owes more to the masses than to what was measured (as in `loop.ties`)."""


@dataclass(frozen=True)
class Proportion:
    """Parameters of a simulator, by name, and what of its masses is taken as right."""

    factors: tuple[str, ...]
    """On the torques of all motors that are searched."""
    of: Mapping[str, str]
    """All that grows with the masses, the factors too; each with the factor of its own drive, "" where it has none."""
    bodies: tuple[str, ...]
    """Whose masses are not searched."""
    most: float
    """Times that a mass may be what the file says."""

    def common(self, estimates: Sequence[Estimate]) -> tuple[float, float] | None:
        """Natural logarithm of what all factors have in common, and its standard error, where that is shown not to be one
        and masses can make up for it; None elsewhere. Motors that differ as much from one another have constants of their
        own.
        """
        found = [e for e in estimates if e.name in self.factors]
        if not self.bodies or not found or not all(e.fitted and e.low > 0.0 for e in found):
            return None
        logs = np.log([e.value for e in found])
        own = np.log([e.high / e.low for e in found]) / (2.0 * NORMAL_95)
        among = float(np.var(logs, ddof=1)) / len(logs) if len(logs) > 1 else 0.0
        mean, error = float(np.mean(logs)), float(np.sqrt(among + np.mean(own**2)))
        return (mean, error) if STANDARD_ERRORS * error < abs(mean) < np.log(self.most) else None

    def times(self, estimates: Sequence[Estimate]) -> dict[str, Array] | None:
        """How many times as large each may be if the torques are what was logged: (2,) least and most by the parameter's
        name; None where nothing says that factors are masses.
        """
        common = self.common(estimates)
        if common is None:
            return None
        mean, error = common
        about = np.exp(-mean + STANDARD_ERRORS * error * np.array([-1.0, 1.0]))
        # What a drive takes grows with the torque of its own motor, which may be off by itself, too.
        each = {e.name: np.array([*about, 1.0 / e.low, 1.0 / e.high]) for e in estimates if e.name in self.factors}
        every = np.concatenate(list(each.values()))
        ends = {name: each.get(own, every) for name, own in self.of.items()}
        return {name: np.array([t.min(), t.max()]) for name, t in ends.items()}

    def applied(self, estimates: Sequence[Estimate]) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
        """Estimates that hold whether the masses or the torques are right, with words where that rules; and a note."""
        times = self.times(estimates)
        if times is None:
            return tuple(estimates), ()
        return tuple(self._either(e, times[e.name]) if e.name in times else e for e in estimates), (
            self._said(estimates),
        )

    def _either(self, e: Estimate, times: Array) -> Estimate:
        if not e.fitted or not e.value > 0.0:
            return e
        ends = e.low * times.min(), e.high * times.max()
        low, high = max(min(e.low, ends[0]), e.lower_bound), min(max(e.high, ends[1]), e.upper_bound)
        wide = replace(e, low=float(low), high=float(high))
        if e.verdict not in ("identified", "weak") or not high - low > _RULES * (e.high - e.low):
            return wide
        other = 1.0 if e.name in self.factors else e.value * float(np.mean(times))
        note = (
            f"{e.value:.4g} [{e.low:.4g}, {e.high:.4g}] {e.unit}".rstrip()
            + f" if the masses in the file are right ({listed(self.bodies)}), about {other:.4g} if the torques are what was "
            "logged"
        )
        return replace(wide, verdict="tied", note=note)

    def _said(self, estimates: Sequence[Estimate]) -> str:
        found = [e.value for e in estimates if e.name in self.factors]
        low, high, times = min(found), max(found), float(np.exp(-np.mean(np.log(found))))
        return (
            f"factors on the motors' torques, {low:.3g} to {high:.3g}, are in proportion to the masses in the file that are "
            f"not searched ({listed(self.bodies)}), and so is what else of force and inertia was found: no motion tells "
            "whether these masses or the torques are right, and intervals hold both. If the torques are what was logged, "
            f"these bodies are about {times:.3g} times as heavy, and masses, friction, damping and inertia that were found "
            "as many times as large. Weigh one of them, and correct the file"
        )


@runtime_checkable
class Weighed(Protocol):
    """A simulator that knows what is found in proportion to masses for which its model is trusted."""

    def proportion(self, space: ParameterSpace) -> Proportion | None:
        """Of those parameters that `space` leaves free; None where something else tells how large they are."""
        ...


def proportion_of(simulator: object, space: ParameterSpace) -> Proportion | None:
    """See `Weighed`: of the simulator itself, not of an approximation or a restricted view of it."""
    while not isinstance(simulator, Weighed):
        simulator = getattr(simulator, "whole", None)
        if simulator is None:
            return None
    return simulator.proportion(space)
