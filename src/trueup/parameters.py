# SPDX-License-Identifier: Apache-2.0
"""Parameters that may be calibrated: name, unit, nominal value, bounds, scale; and the box a search works in."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers, Mask
from trueup.errors import ParameterError, unknown_name
from trueup.rounding import TINY

SCALES = ("linear", "log")


@dataclass(frozen=True)
class Parameter:
    """One number that may be calibrated. Raises ParameterError for impossible declarations."""

    name: str
    unit: str
    nominal: float
    """Where the search starts, and the value of a frozen parameter, in `unit`."""
    lower: float
    upper: float
    scale: str = "linear"
    """'linear', or 'log' for what may be wrong by a factor."""
    frozen: bool = False
    """Frozen is not absent: the nominal value is applied to the model, the search skips it."""
    source: str = ""
    """Where nominal and bounds come from, for the report."""
    shown_by: str = ""
    """Which motion shows it ("slow reversals"), for the advice on what a recording could not tell."""
    optional: str = ""
    """Name of a structure that the model can do without ("backlash"): kept only if it lowers the held-out error."""
    absent: float | None = None
    """The value with which it is as if there were no such structure (a limit that is never met is no zero). Where it is given
    an optional structure is tried from the fit without it; None: searched with all else, then judged."""
    unidentified: float | None = None
    """The value where recordings do not identify it, if that is not the nominal one: of what nobody declared, the latter is
    no more than a place from which it is searched."""
    vanishes: bool = False
    """Whether its lower bound is as good as none of it: a delay of 0 s, friction of a model that has none."""
    requested: bool = True
    """False where it is frozen since nobody asked for it: its nominal value is what the model has, and may be wrong."""
    identifiable: bool = True
    """False where no motion of the robot tells it from others, whatever slopes say: of a joint that follows another one, to
    which a simulator's soft constraint holds it with a play that the robot does not have."""

    def __post_init__(self) -> None:
        """Checks the declaration."""
        if self.scale not in SCALES:
            raise ParameterError(f"parameter '{self.name}': scale '{self.scale}' is not one of: {', '.join(SCALES)}")
        if not all(map(math.isfinite, (self.nominal, self.lower, self.upper))):
            raise ParameterError(
                f"parameter '{self.name}': nominal {self.nominal}, bounds {self.lower} ... {self.upper} must be finite"
            )
        if not self.lower < self.upper:
            raise ParameterError(
                f"parameter '{self.name}': lower bound {self.lower} is not below the upper bound {self.upper} {self.unit}"
            )
        if self.scale == "log" and self.lower <= 0:
            raise ParameterError(
                f"parameter '{self.name}': a log scale needs a lower bound above zero, it is {self.lower} {self.unit}"
            )
        if not self.frozen and not self.lower <= self.nominal <= self.upper:
            raise ParameterError(
                f"parameter '{self.name}': nominal {self.nominal} {self.unit} lies outside its bounds "
                f"{self.lower} ... {self.upper}; widen the bounds or freeze it"
            )

    @property
    def log_range(self) -> float:
        """How far the logarithms of its bounds lie apart; 0 on a linear scale."""
        return math.log(self.upper / self.lower) if self.scale == "log" else 0.0

    def replace(self, **changes: object) -> Parameter:
        """A copy with some fields changed; checked like a new one."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class ParameterSpace:
    """An ordered set of parameters. Values are (n,) or (b, n) in the parameters' units, frozen ones included.

    The search sees only the free ones, in a unit box: (n_free,) or (b, n_free) in [0, 1].
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        """Checks that names are unique."""
        object.__setattr__(self, "parameters", tuple(self.parameters))
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise ParameterError(f"parameter '{name}' is declared twice")
            seen.add(name)

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        """The parameters, in order."""
        return iter(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def nominal(self) -> Array:
        """(n,) nominal values."""
        return np.array([p.nominal for p in self.parameters], dtype=np.float64)

    @property
    def unidentified(self) -> Array:
        """(n,) values where recordings do not identify them (see `Parameter.unidentified`)."""
        return np.array(
            [p.nominal if p.unidentified is None else p.unidentified for p in self.parameters], dtype=np.float64
        )

    @property
    def free(self) -> Mask:
        """(n,) True where the search may change the value."""
        return np.array([not p.frozen for p in self.parameters], dtype=bool)

    @property
    def kinds(self) -> Integers:
        """(n_free,) numbers of the kinds that the free parameters are of: one quantity at several places, by their names."""
        kinds = [(p.name.rpartition(".")[2], p.unit, p.scale) for p in self.parameters if not p.frozen]
        numbers = {kind: k for k, kind in enumerate(dict.fromkeys(kinds))}
        return np.array([numbers[kind] for kind in kinds], dtype=np.int64)

    def index(self, name: str) -> int:
        """The position of a parameter. Raises UnknownNameError, which lists the names."""
        try:
            return self.names.index(name)
        except ValueError:
            raise unknown_name("parameter", name, self.names, "the parameter space") from None

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[self.index(name)]

    def freeze(self, names: Iterable[str], values: Mapping[str, float] | None = None) -> ParameterSpace:
        """The same space with some parameters frozen, at their nominal or at the given values."""
        wanted = set(names)
        for name in wanted:
            self.index(name)
        given = values or {}
        return ParameterSpace(
            tuple(
                p.replace(frozen=True, nominal=float(given.get(p.name, p.nominal))) if p.name in wanted else p
                for p in self.parameters
            )
        )

    def left_open(self, names: Iterable[str]) -> ParameterSpace:
        """The same space with parameters frozen that recordings do not tell."""
        return self.freeze(names, dict(zip(self.names, self.unidentified.tolist(), strict=True)))

    def without(self, names: Iterable[str]) -> ParameterSpace:
        """The same space as if there were nothing of some parameters (see `Parameter.absent`)."""
        wanted = tuple(names)
        return self.freeze(wanted, {name: self[name].absent or 0.0 for name in wanted})

    def left_out(self, names: Iterable[str]) -> ParameterSpace:
        """The same space with parameters frozen that are not searched: as `left_open`, and proposed structures as if there
        were none, whose nominal value is no more than a place from which they are searched.
        """
        wanted = tuple(names)
        return self.left_open(wanted).without(n for n in wanted if self[n].optional and self[n].absent is not None)

    def with_nominal(self, values: ArrayLike) -> ParameterSpace:
        """The same space with other nominal values (n,), clipped into the bounds of the free ones."""
        given = self._checked(values)
        return ParameterSpace(
            tuple(
                p.replace(nominal=float(v if p.frozen else np.clip(v, p.lower, p.upper)))
                for p, v in zip(self.parameters, given, strict=True)
            )
        )

    def to_unit(self, values: ArrayLike) -> Array:
        """Values (..., n) to the unit box of the free parameters (..., n_free); out of bounds gives outside [0, 1]."""
        given = self._checked(values)[..., self.free]
        low, high, log = self._box()
        inside = np.where(log, np.log(np.maximum(given, TINY)), given)
        return (inside - low) / (high - low)

    def from_unit(self, unit: ArrayLike) -> Array:
        """Points of the unit box (..., n_free) to values (..., n); frozen parameters take their nominal value."""
        box = np.asarray(unit, dtype=np.float64)
        count = int(self.free.sum())
        if box.shape[-1] != count:
            raise ParameterError(f"a point of the unit box has {count} numbers, not {box.shape[-1]}")
        low, high, log = self._box()
        inside = low + box * (high - low)
        values = np.broadcast_to(self.nominal, (*box.shape[:-1], len(self))).copy()
        values[..., self.free] = np.where(log, np.exp(np.where(log, inside, 0.0)), inside)
        return values

    def named(self, unit: ArrayLike) -> list[dict[str, float]]:
        """Values by name of points of the unit box (b, n_free)."""
        return [dict(zip(self.names, row, strict=True)) for row in self.from_unit(unit).tolist()]

    def unit_slope(self, values: ArrayLike) -> Array:
        """(n_free,) d value / d unit at `values` (n,): turns a covariance of the unit box into the parameters' units."""
        given = self._checked(values)[self.free]
        low, high, log = self._box()
        return np.where(log, given, 1.0) * (high - low)

    def _box(self) -> tuple[Array, Array, Mask]:
        free = [p for p in self.parameters if not p.frozen]
        log = np.array([p.scale == "log" for p in free], dtype=bool)
        low = np.array([math.log(p.lower) if p.scale == "log" else p.lower for p in free])
        high = np.array([math.log(p.upper) if p.scale == "log" else p.upper for p in free])
        return low, high, log

    def _checked(self, values: ArrayLike) -> Array:
        given = np.asarray(values, dtype=np.float64)
        if given.shape[-1:] != (len(self),):
            raise ParameterError(f"expected {len(self)} values (one for each parameter), got an array of {given.shape}")
        return given


def concatenate(spaces: Sequence[ParameterSpace]) -> ParameterSpace:
    """One space of several, in order. Raises ParameterError where a name occurs twice."""
    return ParameterSpace(tuple(p for space in spaces for p in space.parameters))
