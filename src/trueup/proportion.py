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
from trueup.calibration import Estimate
from trueup.errors import listed
from trueup.evidence import HALVED, STANDARD_ERRORS
from trueup.parameters import ParameterSpace


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
        """Natural logarithm of what all factors have in common, and half of its interval; None where masses cannot make up
        for it, or motors differ from one another as much: these have constants of their own.
        """
        found = [e for e in estimates if e.name in self.factors]
        if not self.bodies or not found or not all(e.fitted and e.low > 0.0 for e in found):
            return None
        logs = np.log([e.value for e in found])
        mean, among = float(np.mean(logs)), float(np.std(logs, ddof=1)) / len(logs) ** 0.5 if len(logs) > 1 else 0.0
        # One mass too few moves all factors alike: their own errors do not average out.
        own = float(np.sqrt(np.mean([_half(e) ** 2 for e in found])))
        shown = STANDARD_ERRORS * among < abs(mean) < np.log(self.most)
        return (mean, float(np.hypot(STANDARD_ERRORS * among, own))) if shown else None

    def applied(self, estimates: Sequence[Estimate]) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
        """Estimates that hold whether the masses or the torques are right, with words where that rules; and a note where
        both cannot be.
        """
        common = self.common(estimates)
        if common is None:
            return tuple(estimates), ()
        (mean, half), each = common, {e.name: e for e in estimates if e.name in self.factors}
        told = []
        for e in estimates:
            if e.fitted and e.value > 0.0 and e.name in self.of:
                # What a drive takes is known beside the torque of its own motor, which may be off by itself, too.
                drive = each.get(self.of[e.name])
                logs, more = ([mean], half) if drive is None else ([mean, np.log(drive.value)], _half(drive))
                e = either(e, np.exp(-np.array(logs)), more, self.bodies)
            told.append(e)
        return tuple(told), (self._sentence(estimates),) if abs(mean) > half else ()

    def _sentence(self, estimates: Sequence[Estimate]) -> str:
        found = [e.value for e in estimates if e.name in self.factors]
        low, high, times = min(found), max(found), float(np.exp(-np.mean(np.log(found))))
        return (
            f"factors on the motors' torques, {low:.3g} to {high:.3g}, are in proportion to the masses in the file that are "
            f"not searched ({listed(self.bodies)}), and so is what else of force and inertia was found: no motion tells "
            "whether these masses or the torques are right, and intervals hold both. If the torques are what was logged, "
            f"these bodies are about {times:.3g} times as heavy, and masses, friction, damping and inertia that were found "
            "as many times as large. Weigh one of them, and correct the file"
        )


def either(e: Estimate, times: Array, half: float, bodies: Sequence[str] = ()) -> Estimate:
    """An estimate that may be so many times as large, each with half of an interval on a log scale, or as it is where the
    masses of `bodies` are right; () stands for all in the file.
    """
    down, up = (float(np.hypot((end - e.value) / e.value, half)) for end in (e.low, e.high))
    low = min(e.low, max(e.value * float(times.min()) * (1.0 - down), e.lower_bound))
    high = max(e.high, min(e.value * float(times.max()) * (1.0 + up), e.upper_bound))
    wide = replace(e, low=low, high=high)
    if e.verdict not in ("identified", "weak") or not e.high - e.low < HALVED * (high - low):
        return wide
    note = (
        f"{e.value:.4g} [{e.low:.4g}, {e.high:.4g}] {e.unit}".rstrip()
        + f" if the masses in the file are right{f' ({listed(bodies)})' if bodies else ''}, about "
        f"{e.value * float(times[-1]):.4g} if the torques are what was logged"
    )
    return replace(wide, verdict="tied", note=note)


def _half(e: Estimate) -> float:
    """Of an interval, on a log scale."""
    return 0.5 * float(np.log(e.high / e.low))


@runtime_checkable
class Weighed(Protocol):
    """A simulator that knows what is found in proportion to masses for which its model is trusted."""

    def proportion(self, space: ParameterSpace) -> Proportion | None:
        """Of those parameters that `space` leaves free; None where something else tells how large they are."""
        ...

    def grown(self, space: ParameterSpace) -> Mapping[str, str]:
        """What of those grows with the masses, by name, each with the joint that it is of, "" where that is several."""
        ...


def proportion_of(simulator: object, space: ParameterSpace) -> Proportion | None:
    """See `Weighed`: of the simulator itself, not of an approximation or a restricted view of it."""
    own = weighed(simulator)
    return None if own is None else own.proportion(space)


def weighed(simulator: object) -> Weighed | None:
    """The simulator itself that knows, behind approximations and restricted views of it."""
    while not isinstance(simulator, Weighed):
        simulator = getattr(simulator, "whole", None)
        if simulator is None:
            return None
    return simulator
