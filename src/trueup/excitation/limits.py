# SPDX-License-Identifier: Apache-2.0
"""What the joints of an arm may do: range, speed, acceleration, torque; what a model file leaves out is assumed, and said."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup import files
from trueup.arrays import Array, Mask
from trueup.errors import ModelError, unknown_name
from trueup.typed_toml import build
from trueup.units import FURTHEST_TURN, hardly_radians

if TYPE_CHECKING:
    from trueup.identification.kinematic_tree import KinematicTree


_TO_SPEED = 0.4
"""s in which industrial arms reach their top speed; the acceleration limit where none is given."""
_SPEED, _PRISMATIC_SPEED = np.pi, 1.0
FIELDS = ("lower", "upper", "speed", "acceleration", "torque", "peak")


@dataclass(frozen=True)
class _LimitsFile:
    all: Mapping[str, float] = field(default_factory=dict)
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of n joints, each (n,): positions in rad (m), speed in rad/s, acceleration in rad/s^2, torque in N m (N)."""

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    torque: Array
    """Nominal torque, under which the root mean square of a motion's torque stays (equivalent load of intermittent duty:
    IEC 60034-1); NaN where it is not known."""
    notes: tuple[str, ...] = ()
    """What was assumed because the model file does not say it."""
    given_peak: Array | None = None
    """Torque that drives give for short times; None: no more than the nominal one."""
    sources: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Field -> where each joint's value comes from: 'model', 'assumed', a file or an option."""

    @property
    def peak(self) -> Array:
        """(n,) torque that is never exceeded."""
        return self.torque if self.given_peak is None else self.given_peak

    @property
    def middle(self) -> Array:
        """(n,) of the ranges."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> Array:
        """(n,) how far the ranges go to either side of their middle."""
        return 0.5 * (self.upper - self.lower)

    @property
    def reach(self) -> Array:
        """(n,) how far a motion about the middle may go: half of the range, half a turn at most."""
        return np.minimum(self.half, np.pi)

    def values(self) -> dict[str, Array]:
        """Field -> (n,), in the order of `FIELDS`."""
        return {name: getattr(self, name) for name in FIELDS}

    def with_peak(self, times: float) -> JointLimits:
        """Limits whose drives give `times` the nominal torque for short times, where no peak is given."""
        if times == 1.0 or self.given_peak is not None:
            return self
        sources = {**self.sources, "peak": (f"--peak {times:g}",) * len(self.joints)}
        return replace(self, given_peak=times * self.torque, sources=sources)

    @classmethod
    def of(cls, tree: KinematicTree) -> JointLimits:
        """The limits of a model file; turns without range may make one turn, and top speed is reached in 0.4 s.

        Raises ModelError for a prismatic joint without a range.
        """
        notes: list[str] = []
        prismatic = np.asarray(tree.prismatic, dtype=bool)
        endless = ~(np.isfinite(tree.lower) & np.isfinite(tree.upper))
        if (endless & prismatic).any():
            raise ModelError(
                f"prismatic joint '{_listed(tree.joints, endless & prismatic)}' has no range; the model must give one"
            )
        turned = _as_degrees(tree, ~(endless | prismatic))
        ends = (np.where(turned, np.radians(end), end) for end in (tree.lower, tree.upper))
        lower, upper = (np.where(endless, end, own) for end, own in zip((-np.pi, np.pi), ends, strict=True))
        slow = ~(np.isfinite(tree.speed) & (np.asarray(tree.speed) > 0))
        said = np.where(turned & (np.asarray(tree.speed) > FURTHEST_TURN), np.radians(tree.speed), tree.speed)
        speed = np.where(slow, np.where(prismatic, _PRISMATIC_SPEED, _SPEED), said)
        weak = ~(np.isfinite(tree.effort) & (np.asarray(tree.effort) > 0))
        if endless.any():
            notes.append(f"no range in the model, taken as +-180 deg: {_listed(tree.joints, endless)}")
        if turned.any():
            most = float(np.abs([tree.lower[turned], tree.upper[turned]]).max())
            notes.append(
                f"ranges that reach {most:.4g} rad, {most / (2.0 * np.pi):.0f} turns, are taken as degrees, as no joint of "
                f"an arm turns so far: {_listed(tree.joints, turned)}, and their speed limits above {FURTHEST_TURN:.3g} "
                "rad/s too; write rad into the model, or give lower, upper and speed with --limits"
            )
        if slow.any():
            notes.append(f"no speed limit in the model, taken as 180 deg/s (1 m/s): {_listed(tree.joints, slow)}")
        if weak.any():
            notes.append(f"no torque limit in the model: {_listed(tree.joints, weak)}")
        notes.append("acceleration limits: top speed in 0.4 s (model files hold none; give your arm's with --limits)")
        torque, every = np.where(weak, np.nan, tree.effort), np.ones_like(weak)
        unsaid = {
            "lower": endless | turned,
            "upper": endless | turned,
            "speed": slow,
            "acceleration": every,
            "torque": weak,
        }
        sources = {name: tuple("assumed" if x else "model" for x in unknown) for name, unknown in unsaid.items()}
        return cls(tuple(tree.joints), lower, upper, speed, speed / _TO_SPEED, torque, tuple(notes), sources=sources)

    def changed(self, **values: Mapping[str, float]) -> JointLimits:
        """Limits with some values replaced: `changed(acceleration={"elbow": 7.0})`. Raises UnknownNameError, ModelError."""
        fields: dict[str, Array] = {}
        for name, given in values.items():
            if name not in FIELDS:
                raise unknown_name("limit", name, FIELDS, "limits of joints")
            fields[name] = np.array(getattr(self, name))
            for joint, value in given.items():
                if joint not in self.joints:
                    raise unknown_name("joint", joint, self.joints)
                fields[name][self.joints.index(joint)] = value
        if (peak := fields.pop("peak", None)) is not None:
            fields["given_peak"] = peak
        made = replace(self, **fields)
        for k, joint in enumerate(made.joints):
            if not made.lower[k] < made.upper[k] or not made.speed[k] > 0 or not made.acceleration[k] > 0:
                raise ModelError(
                    f"limits of joint '{joint}' are impossible: range {made.lower[k]:g} ... {made.upper[k]:g}, "
                    f"speed {made.speed[k]:g}, acceleration {made.acceleration[k]:g}"
                )
            if made.peak[k] < made.torque[k]:
                raise ModelError(
                    f"joint '{joint}': peak torque {made.peak[k]:g} is below the nominal {made.torque[k]:g}"
                )
        return made

    def from_file(self, path: str | Path) -> JointLimits:
        """Limits with what a TOML file says: a table [joints.NAME], or [all], with any of `FIELDS`.

        Raises ModelError and UnknownNameError that name file and key.
        """
        file = Path(path)
        given = build(_LimitsFile, files.toml(file, ModelError), str(file), ModelError)
        tables = {joint: given.all for joint in self.joints}
        tables |= {joint: {**tables.get(joint, {}), **table} for joint, table in given.joints.items()}
        values: dict[str, dict[str, float]] = {}
        for joint, entries in tables.items():
            for name, value in entries.items():
                values.setdefault(name, {})[joint] = value
        made = self.changed(**values)
        said = tuple(n for n in made.notes if not ("acceleration" in values and n.startswith("acceleration")))
        sources = dict(made.sources)
        for name, given in values.items():
            before = sources.get(name, ("model",) * len(self.joints))
            sources[name] = tuple(str(file.name) if j in given else x for j, x in zip(self.joints, before, strict=True))
        return replace(made, notes=said, sources=sources)

    def within(self, *, range_share: float = 1.0, speed_share: float = 1.0) -> JointLimits:
        """Narrower limits: a share of each range about its middle, a share of the speeds."""
        half = np.maximum(self.half * range_share, 1e-3)
        return replace(self, lower=self.middle - half, upper=self.middle + half, speed=self.speed * speed_share)


def _as_degrees(tree: KinematicTree, ranged: Mask) -> Mask:
    """(n,) whose ranges are degrees by mistake: those that as rad are beyond what turns, and as degrees within it; where most
    of the joints with a range (n,) are, all of them. What was meant as rad is only narrowed by that.
    """
    furthest = np.where(ranged, np.maximum(np.abs(tree.lower), np.abs(tree.upper)), 0.0)
    beyond = np.array(
        [hardly_radians(f) and not hardly_radians(math.radians(f)) for f in furthest.tolist()], dtype=bool
    )
    return ranged if 2 * np.count_nonzero(beyond) > np.count_nonzero(ranged) else beyond


def _listed(names: tuple[str, ...], chosen: Mask) -> str:
    return ", ".join(name for name, one in zip(names, chosen, strict=True) if one)
