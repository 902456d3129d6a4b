# SPDX-License-Identifier: Apache-2.0
"""Signals of a left and a right driven wheel: pairs of columns whose names differ in the side alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from trueup.formats.rules.names import COMMANDED, PLAINLY_MEASURED, listed, taken_apart
from trueup.formats.rules.rule import Column, Example
from trueup.inspection.relations import factor, nearest
from trueup.tracking.wheels import DUTIES, SIDES
from trueup.units import are_pulses, canonical, to_si

_SIDES: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("left", "l", "lft", "lhs", "links", "gauche", "izq", "izquierda", "sx", "sinistra"), "left"),
        **dict.fromkeys(("right", "r", "rgt", "rhs", "rechts", "droite", "der", "derecha", "dx", "destra"), "right"),
    }
)
_AXLES: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("front", "fore", "vorne", "avant"), "front"),
        **dict.fromkeys(("middle", "mid", "center", "centre"), "middle"),
        **dict.fromkeys(("rear", "back", "hind", "aft", "hinten"), "rear"),
    }
)
"""By what wheels of one side are told apart, the first that there is before those behind it."""
_CORNERS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        text: (side, axle)
        for axle, ends in (("front", "f"), ("rear", "rb"))
        for side, letter in zip(SIDES, "lr", strict=True)
        for end in ends
        for text in (end + letter, letter + end)
    }
)
"""fl, lf, rr, br and their like: side and axle; left before right where lr and rl may be either."""
_NUMBERED = (("a", "b"), ("0", "1"), ("1", "2"))
"""By what wheels are told apart where no side is said."""
_WHEELS = listed("wheel wheels track tracks ticks tick counts enc encoder encoders rpm pwm motor motors")
"""Words of which one makes a wheel's signal of whatever else stands beside the side."""
_SPEEDS = listed(
    "v vel velocity velocities vels speed speeds omega w rpm rps cps tps rate dot phidot thetadot dphi per sec hz "
    "geschwindigkeit drehzahl"
)
_TURNING = listed("omega w phidot thetadot dphi phi theta joint rpm rps")
"""Words of a speed that is the wheel's turning."""
_TRAVELS = listed(
    "pos position positions angle phi theta ticks tick counts count enc encoder encoders odometer distance dist"
)
_SHARES = listed("pwm duty power thrust throttle drive u motor motors servo esc voltage volts volt")
_DUTIES = listed("pwm duty power thrust throttle voltage voltages volt volts")
"""Words of shares of what motors can do, which are no speeds."""
_OTHERS = listed(
    "current torque effort force temperature temp load error err gain kp ki kd slip drop status accel acceleration acc "
    "steer steering brake hip knee ankle arm hand foot leg gripper amps overcurrent bumper cliff raw_error integral"
)
"""Words of what is no motion of a wheel."""
_UNITS = listed("rpm rps mps mmps cmps kmh rads radps dps degps")
"""Words that are units wherever they stand."""
_BESIDE = listed(
    "wheel wheels joint base robot drive diff controller front side of s m rad value data msg vel state states"
)
_SENSED = listed("encoder enc ticks tick counts odom odometry sensor state states fb")

EXAMPLES = (
    Example("t,left_wheel_cmd,right_wheel_cmd,x,y,theta", "0 1 2 0 0 0|.1 2 2 .1 0 0|.2 2 1 .2 0 .1",
            "command[] left right; position[m] x y; heading[rad] heading"),
    Example("t,cmd_left_mps,cmd_right_mps,x,y,yaw", "0 1 2 0 0 0|.1 2 2 .1 0 0|.2 2 1 .2 0 .1",
            "command[m/s] left right; position[m] x y; heading[rad] heading"),
    Example("time,wheel_left_velocity_command,wheel_right_velocity_command,wheel_left_velocity,wheel_right_velocity",
            "0 1 2 1 2|.1 2 2 2 2|.2 2 1 2 1", "command[] left right; wheel_speed[] left right"),
    Example("millis,pwm_left,pwm_right,ticks_l,ticks_r", "0 90 99 0 0|20 90 99 5 6|40 80 99 9 13",
            "command[] left_duty right_duty; wheel_angle[] left right"),
    Example("t,rpm_left_target,rpm_right_target,rpmLeft,rpmRight", "0 9 9 1 2|.1 9 8 3 4|.2 7 8 5 6",
            "command[rad/s] left right; wheel_speed[rad/s] left right"),
    Example("t,v_l_ref,v_r_ref,enc_left,enc_right", "0 1 1 0 0|.1 1 2 5 6|.2 2 2 9 13",
            "command[m/s] left right; wheel_angle[] left right"),
    Example("t,wL_ref,wR_ref,phi_l_rad,phi_r_rad,x,y,th", "0 1 2 0 0 0 0 0|.1 2 2 1 1 .1 0 0|.2 2 1 2 2 .2 0 .1",
            "command[rad/s] left right; wheel_angle[rad] left right; position[m] x y; heading[rad] heading"),
    Example("t,ML,MR,x,y,theta", "0 9 9 0 0 0|.1 9 8 .1 0 0|.2 7 8 .2 0 .1",
            "command[] left right; position[m] x y; heading[rad] heading"),
    Example("t,fl_cmd,fr_cmd,rl_cmd,rr_cmd,x,y,theta", "0 1 2 1 2 0 0 0|.1 2 2 2 2 .1 0 0|.2 2 1 2 1 .2 0 .1",
            "command[] left right rear_left rear_right; position[m] x y; heading[rad] heading"),
    Example("t,front_left_wheel_rpm_cmd,front_right_wheel_rpm_cmd,rear_left_wheel_rpm_cmd,rear_right_wheel_rpm_cmd,x,y",
            "0 1 2 1 2 0 0|.1 2 2 2 2 .1 0|.2 2 1 2 1 .2 0",
            "command[rad/s] left right rear_left rear_right; position[m] x y"),
    Example("t,left_knee_cmd,right_knee_cmd,left_knee_pos,right_knee_pos", "0 .1 .2 .1 .2|.1 .2 .2 .2 .2|.2 .1 .2 .1 .2",
            "command[rad] left_knee right_knee; position[rad] left_knee right_knee"),
    Example("t,q_lf_coxa,q_rf_coxa,q_lm_coxa,q_rm_coxa,q_lh_coxa,q_rh_coxa", "0 .1 .2 .1 .2 .1 .2|.1 .2 .3 .1 .2 .2 .2",
            "position[rad] lf_coxa rf_coxa lm_coxa rm_coxa lh_coxa rh_coxa"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pair:
    """The same of both wheels."""

    columns: tuple[Column, Column]
    """Left, right."""
    kind: str
    """'speed', 'travel' (an angle, a way or counts that add up) or 'share' (of a motor's full command)."""
    unit: str
    """In SI, as the names say it: 'm/s', 'rad/s', 'm', 'rad'; '' where they do not."""
    scale: float
    """What one of its numbers is in that unit."""
    commanded: bool
    measured: bool
    """Whether its words say so."""
    of_wheels: bool
    """Whether its words say that it is wheels' at all."""
    sided: bool = True
    """Whether its names say which is the left one."""
    behind: tuple[tuple[str, tuple[Column, Column]], ...] = ()
    """The same of further axles, each by its name."""

    @property
    def every(self) -> tuple[Column, ...]:
        """The columns of all axles, left before right."""
        return (*self.columns, *(column for _, both in self.behind for column in both))

    @property
    def swapped(self) -> Pair:
        """With left and right in each other's place."""
        return replace(self, columns=self.columns[::-1], behind=tuple((axle, both[::-1]) for axle, both in self.behind))

    @property
    def labels(self) -> tuple[str, str]:
        """What both are called in a channel."""
        return DUTIES if self.duty else SIDES

    @property
    def every_label(self) -> tuple[str, ...]:
        """What the columns of all axles are called."""
        return (*self.labels, *(f"{axle}_{label}" for axle, _ in self.behind for label in self.labels))

    @property
    def duty(self) -> bool:
        """Whether its words call it a share of what motors can do (PWM, power, voltage), whatever numbers that is in."""
        words = {rest for w in self.columns[0].parts.words for rest in (w, *_split(w)[1])}
        return self.kind == "share" and (in_pulses(self) or self.scale != 1.0 or bool(_DUTIES & words))


def pairs(columns: Sequence[Column]) -> list[Pair]:
    """What is there of two wheels, or of several on each side, commands with a unit first."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, dict[str, Column]]] = {}
    for column in columns:
        side, axle, plain = _sided(column.parts.words)
        if side and column.values.ndim == 1:
            found.setdefault((column.clock, tuple(plain)), {}).setdefault(axle, {}).setdefault(side, column)
    read = []
    for (_, plain), axles in found.items():
        there = [
            (axle, (axles[axle]["left"], axles[axle]["right"]))
            for axle in ("", *dict.fromkeys(_AXLES.values()))
            if len(axles.get(axle, ())) == len(SIDES)
        ]
        there = [(axle, both) for axle, both in there if _as_many_as_wheels(*both, columns)]
        pair = _read(there[0][1], list(plain)) if there else None
        read += [replace(pair, behind=tuple(there[1:]))] if pair else []
    return _units_alike(sorted(read, key=lambda p: (p.kind == "share", not p.unit)))


def _as_many_as_wheels(left: Column, right: Column, columns: Sequence[Column]) -> bool:
    """Whether no more than four columns are named like both but for the side: a robot has more legs than that."""
    most, own, other = 4, left.parts.words, right.parts.words
    sides = {k for k, (word, beside) in enumerate(zip(own, other, strict=False)) if word != beside}
    if len(own) != len(other) or len(own) == len(sides):  # nothing but a side is told
        return True
    like = {
        words
        for words in (tuple(c.parts.words) for c in columns)
        if len(words) == len(own) and all(k in sides or word == own[k] for k, word in enumerate(words))
    }
    return len(like) <= most


def numbered(columns: Sequence[Column]) -> list[Pair]:
    """Pairs that names number or call A and B, where there are two of a kind and no more: motors, wheels, commands."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, Column]] = {}
    ends = {end for both in _NUMBERED for end in both} | {str(n) for n in range(10)}
    for column in columns:
        words = column.parts.words
        numbers = [word for word in words if word in ends]
        if len(numbers) == 1 and column.values.ndim == 1:
            plain = tuple("motor" if word == "m" else word for word in words if word != numbers[0])
            found.setdefault((column.clock, plain), {})[numbers[0]] = column
    return [
        replace(pair, sided=False) for (_, plain), both in found.items()
        if tuple(sorted(both)) in _NUMBERED and (_WHEELS | COMMANDED) & set(plain)
        and (pair := _read((both[min(both)], both[max(both)]), list(plain))) is not None
    ]  # fmt: skip


def _sided(words: Sequence[str]) -> tuple[str, str, list[str]]:
    """The side that a name says, '' for none or two, the axle, and its other words: "vl" is v of the left."""
    sides, axles, plain = [], [], []
    for word in words:
        side, rest = _split(word)
        sides += [side] if side else []
        axles += [_AXLES[w] for w in rest if w in _AXLES]
        plain += [w for w in rest if w not in _AXLES]
    return (sides[0] if len(sides) == 1 else ""), (axles[0] if axles else ""), plain


def _split(word: str) -> tuple[str, list[str]]:
    """The side that a word says, '' for none, and what else."""
    if word in _SIDES:
        return _SIDES[word], []
    if word in _CORNERS:
        return _CORNERS[word][0], [_CORNERS[word][1]]
    known = _WHEELS | _SPEEDS | _TRAVELS | _SHARES | COMMANDED | {"m"}
    said = {**{text: (side, []) for text, side in _SIDES.items()}, **{t: (s, [a]) for t, (s, a) in _CORNERS.items()}}
    for text, (side, axle) in said.items():
        for rest, there in (
            (word.removesuffix(text), word.endswith(text)),
            (word.removeprefix(text), word.startswith(text)),
        ):
            if there and rest in known:
                return side, [*axle, "motor" if rest == "m" else rest]
    return "", [word]


def _read(columns: tuple[Column, Column], plain: list[str]) -> Pair | None:
    """What both columns say, by the words that they share."""
    last = [word for word in plain if word in _UNITS]  # rpm_left_target
    name = taken_apart(" ".join(["of", *(word for word in plain if word not in _UNITS), *last]))
    tail = "" if plain and plain[-1] in ("a", "c", "k", "n", "v") else {"ms": "m/s"}.get(name.tail, name.tail)
    declared = columns[0].declared or canonical(tail) or ""
    words = set(name.bare if tail else name.words) - {"of"}
    everything = words | set(name.words)
    unit, scale, _ = to_si(declared) if declared else ("", 1.0, 0.0)
    wheels, commanded = bool(_WHEELS & everything), bool(COMMANDED & words)
    known = _WHEELS | _SPEEDS | _TRAVELS | _SHARES | COMMANDED | PLAINLY_MEASURED | _SENSED | _BESIDE
    if _OTHERS & everything or not (wheels or words <= known):
        return None
    measured = bool((PLAINLY_MEASURED | _SENSED) & words)
    if unit in ("rad", "m") or (_TRAVELS & words and not _SPEEDS & everything and unit not in ("m/s", "rad/s")):
        kind, commanded = "travel", False
        if COMMANDED & words or unit not in ("rad", "m", ""):
            return None
        if not unit and not {"ticks", "tick", "counts", "count"} & words and not all(c.whole for c in columns):
            unit = "m" if {"distance", "dist", "odometer"} & words else "rad"
    elif unit in ("m/s", "rad/s") or ((_SPEEDS & everything or not words) and not unit):
        kind = "speed"
        unit = unit or ("rad/s" if _TURNING & words else "m/s" if words - COMMANDED - _BESIDE == {"v"} else "")
    elif unit in ("", "V") and (_SHARES & words or commanded or declared == "%"):
        kind, unit, commanded = "share", "", commanded or not measured
        scale = scale if declared == "%" else 1.0
    else:
        return None
    return Pair(columns, kind, unit, scale, commanded and not measured, measured, wheels)


def _units_alike(found: list[Pair]) -> list[Pair]:
    """Speeds without a unit that go with others as one to one have theirs."""
    out = []
    for pair in found:
        beside = next((p for p in found if pair.kind == p.kind == "speed" and p.unit and not pair.unit), None)
        if beside is not None:
            times = [factor(c.values, o.values) for c, o in zip(pair.columns, beside.columns, strict=True)
                     if len(c.values) == len(o.values)]  # fmt: skip
            same = len(times) == len(SIDES) and all(t is not None and nearest(t, {"1": 1.0}) for t in times)
            pair = replace(pair, unit=beside.unit, scale=beside.scale) if same else pair
        out.append(pair)
    return out


def in_pulses(pair: Pair) -> bool:
    """Whether commands are the microseconds of a servo's pulse."""
    return pair.kind == "share" and are_pulses(np.concatenate([c.known for c in pair.columns]))
