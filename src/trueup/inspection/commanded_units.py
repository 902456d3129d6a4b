# SPDX-License-Identifier: Apache-2.0
"""Commands of servos without a unit that are no rad (counts, pulses, percent): told by how the joints follow them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.evidence import FEWEST_PARTS, STANDARD_ERRORS, jackknife
from trueup.inspection.number_scales import APART, NumberScale, Seen, groups, known_scales, spread, sure_to
from trueup.inspection.relations import CORRELATED, rate
from trueup.inspection.scales import Way, beyond
from trueup.inspection.zeros import FAR, SETTLES
from trueup.recording import Channel, Recording
from trueup.samples import correlation
from trueup.trial import COMMANDS, LOOK, command_of
from trueup.units import AS_FAR, hardly_radians

Loads = Callable[[Recording], Mapping[str, Array]]
"""By joint, (T,) torques by which its weight pulls at a recording's positions: servos sag by a share of that."""


@dataclass(frozen=True, eq=False)
class Line:
    """The numbers that a joint was told, as those at which it was: `per` a rad (or m), and `zero` where it is 0."""

    per: float
    zero: float
    per_error: float = 0.0
    """Standard deviation of `per`."""
    likeness: float = 0.0
    """The correlation of what it was told with this."""
    measured: float = 0.0
    """`per` as it was measured, before it was taken for what is known."""
    late: float = 0.0
    """In s, of the joint behind what it was told."""
    known: str = ""
    """What counts so, in words; '' where nothing known does."""

    def __str__(self) -> str:
        """Factor and zero, and how sure they are."""
        if not self.likeness:
            return f"as the others, {self.zero:.5g}, for it hardly moved"
        return f"{self.measured:.5g} +- {STANDARD_ERRORS * self.per_error:.1g}, {self.zero:.5g}, {self.likeness:.4f}"


@dataclass(frozen=True, eq=False)
class _Part:
    """What a joint was told in one recording, (T,), every `step` s; (T, 4) where it was, how fast, which way, its load."""

    command: Array
    motion: Array
    step: float


def in_units_of_positions(
    joints: Mapping[str, Way], drives: Mapping[str, str], recordings: Sequence[Recording], loads: Loads
) -> tuple[list[Recording], list[str]]:
    """Recordings whose commands without a unit are in that of the positions, where these follow them in proportion but by
    another factor than a soft servo does, and a note. `drives`: labels of commands to joints. What a servo is told is its
    target and what stiffness times the distance from it must give: weight, friction, damping (P. Corke, Robotics, Vision
    and Control, 2017, section 9.1), so that these are fitted beside the factor.
    """
    lines = _lines(joints, drives, recordings, loads)
    if not lines:
        return list(recordings), []
    return [_converted(r, lines, drives) for r in recordings], _note(lines, drives, recordings)


def check_commanded(
    joints: Mapping[str, Way], drives: Mapping[str, str], recordings: Sequence[Recording], loads: Loads
) -> None:
    """Raises RecordingError for joints whose commands have no unit and cannot be rad, or m of a slide with a range."""
    for recording, command in ((r, c) for r in recordings if (c := _without_unit(r)) is not None):
        for label in command.labels:
            way = joints.get(joint := drives.get(label, ""))
            if command.unit_of(label) or way is None or (way.slides and way.range is None):
                continue
            values = command.column(label)[np.isfinite(command.column(label))]
            if values.size and (beyond(way, values) if way.slides else hardly_radians(float(np.abs(values).max()))):
                unit, others = ("m", '"mm"') if way.slides else ("rad", '"deg", "rev"')
                raise RecordingError(
                    f"'{recording.name}': the commands of '{label}' have no unit, and from {values.min():.5g} to "
                    f"{values.max():.5g} they are no {unit}. {_followed(joint, drives, recordings, loads)}. Say what "
                    f"they are in the mapping (inspect writes one), in [channels.{command.name}]: unit = {others}, ...; for "
                    f'counts, steps, pulses or percent unit = "{unit}", scale ({unit} for each) and offset (-scale x the '
                    "number at which the joint is at zero), one for each label. If they are no positions, name the channel "
                    f'command_torque or command_velocity. "--refuse commands" takes them as {unit}'
                )


def _followed(joint: str, drives: Mapping[str, str], recordings: Sequence[Recording], loads: Loads) -> str:
    """How a joint follows its commands, in words."""
    parts = _parts(drives, recordings, loads)
    lines = _at_one_lag(parts) if joint in parts else {}
    if joint not in lines or lines[joint].likeness <= CORRELATED:
        alike = lines[joint].likeness if joint in lines else 0.0
        return f"How the joint follows them does not tell what they are (correlation {alike:.2f})"
    line = lines[joint]
    return (
        f"The joint follows them, {line.per:.4g} for each rad (or m) and {line.zero:.5g} at zero (correlation "
        f"{line.likeness:.3f}), but that is nothing known for sure, and a soft servo makes it more than it is"
    )


def _without_unit(recording: Recording) -> Channel | None:
    """The command of a recording where that is said to be of positions and has labels without a unit."""
    command = command_of(recording)
    if command is None or command.name not in COMMANDS[:2] or all(command.unit_of(x) for x in command.labels):
        return None
    return command


def _lines(
    joints: Mapping[str, Way], drives: Mapping[str, str], recordings: Sequence[Recording], loads: Loads
) -> dict[str, Line]:
    """By joint, of those that are told in another unit than that of their positions, of each kind that is clear."""
    parts = _parts(drives, recordings, loads)
    lines = _at_one_lag(parts)
    found: dict[str, Line] = {}
    for slides in (False, True):
        alike = {x: abs(line.per) for x, line in lines.items()
                 if line.likeness > CORRELATED and joints[x].slides == slides}  # fmt: skip
        for k, group in enumerate(groups(alike, AS_FAR)):
            told = _of_group(joints, parts, {x: lines[x] for x in group})
            found |= told
            if told and not k and not slides:
                found |= _as_the_others(joints, parts, set(lines) - set(alike), told)
    return found


def _at_one_lag(parts: Mapping[str, Sequence[_Part]]) -> dict[str, Line]:
    """The line of each joint at the lag at which they follow best, which is that of all drives, nearly."""
    each = [{x: _line(told, late) for x, told in parts.items()} for late in np.arange(0.0, SETTLES, LOOK).tolist()]
    return max(each, key=lambda found: sum(line.likeness for line in found.values()))


def _of_group(
    joints: Mapping[str, Way], parts: Mapping[str, Sequence[_Part]], lines: Mapping[str, Line]
) -> dict[str, Line]:
    """Lines of joints with one factor, as what is known counts; or as measured, where they agree so well that weight and
    friction do not move it. None where neither is so, or where the factor is one that a soft servo has in rad.
    """
    pers = np.array([abs(line.per) for line in lines.values()])
    if 1.0 / AS_FAR <= np.median(pers) <= AS_FAR:
        return {}
    seen = {}
    for x, line in lines.items():
        told = np.concatenate([part.command for part in parts[x]])
        ends = float(np.nanmin(told)), float(np.nanmax(told))
        seen[x] = Seen(joints[x], line.per, line.zero, *ends, line.per_error / abs(line.per))
    known = known_scales([*seen.values()])
    if known:
        return {x: _beginning(parts[x], replace(lines[x], known=scale.words), seen[x], scale)
                for x, scale in zip(lines, known, strict=True)}  # fmt: skip
    error = float(np.hypot(spread(np.log(pers)[:, None])[0], sure_to([*seen.values()])))
    if len(lines) < 2 or STANDARD_ERRORS * error > 0.5 * APART:
        return {}
    per = float(np.exp(np.mean(np.log(pers))))
    return {x: _beginning(parts[x], line, seen[x], NumberScale("", per, line.zero)) for x, line in lines.items()}


def _as_the_others(
    joints: Mapping[str, Way], parts: Mapping[str, Sequence[_Part]], rest: Collection[str], lines: Mapping[str, Line]
) -> dict[str, Line]:
    """Lines of hinges that hardly moved, or not as they were told, by the factor of the others where that is one."""
    one = next(iter(lines.values()))
    if len({abs(line.per) for line in lines.values()}) > 1:
        return {}
    zeros, found = {line.zero for line in lines.values()}, {}
    for joint in parts:
        told, motion = _held(parts[joint], 0.0)
        if joint in rest and not joints[joint].slides and len(told):
            zero = float(np.mean(told - one.per * motion[:, 0]))
            near = min(zeros, key=lambda each: abs(each - zero))
            found[joint] = replace(one, zero=near if abs(near - zero) < FAR * abs(one.per) else zero, likeness=0.0)
    return found


def _parts(drives: Mapping[str, str], recordings: Sequence[Recording], loads: Loads) -> dict[str, list[_Part]]:
    parts: dict[str, list[_Part]] = {}
    for recording in recordings:
        command, position = _without_unit(recording), recording.channels.get("position")
        if command is None or position is None or len(position.time) < 2:
            continue
        labels = [x for x in command.labels if not command.unit_of(x) and drives.get(x, "") in position.labels]
        pulls = loads(recording) if labels else {}
        step = float(np.median(np.diff(position.time)))
        for label in labels:
            joint = drives[label]
            told, there = command.select([label]).at(position.time, hold=True)[:, 0], position.column(joint)
            speed = _speed(there, position.time)
            motion = np.column_stack([there, speed, np.sign(speed), pulls.get(joint, np.zeros_like(there))])
            parts.setdefault(joint, []).append(_Part(told, motion, step))
    return parts


def _speed(values: Array, time: Array) -> Array:
    """(T,) rates of change of positions, without their noise."""
    known = np.isfinite(values)
    at, speed = rate(values[known], time[known]) if np.count_nonzero(known) > 2 else (time, np.zeros_like(time))
    return np.interp(time, at, speed)


def _line(parts: Sequence[_Part], late: float) -> Line:
    """What a joint was told `late` s before as a line of its positions, beside what a servo adds to go on, against friction,
    and, where that is seen, to hold its weight.
    """
    told, motion = _held(parts, late)
    columns = np.column_stack([motion[:, 0], np.ones_like(told), motion[:, 1:]])  # each part is to tell all of them
    if len(told) < FEWEST_PARTS * columns.shape[1] or min(np.ptp(told), np.ptp(motion[:, 0])) <= 0.0:
        return Line(1.0, 0.0, late=late)
    columns, found, error = _solved(columns, told)
    alike = correlation(told, columns @ found)
    # Noise of positions pulls the factor to zero, at most by as much as the other regression is off to the other side.
    between = abs(found[0]) * 0.5 * (1.0 / max(alike, CORRELATED) ** 2 - 1.0)
    per, zero = float(found[0]), float(found[1])
    return Line(per, zero, float(np.hypot(error[0], between)), alike, per, late)


def _beginning(parts: Sequence[_Part], line: Line, seen: Seen, scale: NumberScale) -> Line:
    """A line with the factor of a scale and its zero, unless its joint is at zero where none rests beside what it is told."""
    told, motion = _held(parts, line.late)
    per = math.copysign(scale.per, line.per)
    _, found = _solved(np.column_stack([np.ones_like(told), motion[:, 1:]]), told - per * motion[:, 0])[:2]
    zero = float(found[0])
    return replace(line, per=per, zero=scale.zero if abs(scale.zero - zero) < seen.near * scale.per else zero)


def _held(parts: Sequence[_Part], late: float) -> tuple[Array, Array]:
    """(n,) what was told so long before, and (n, 4) motions, of all recordings."""
    rows = [np.zeros((0, 5))]
    for part in parts:
        shift = round(late / part.step)
        row = np.column_stack([part.command[: max(len(part.command) - shift, 0)], part.motion[shift:]])
        rows.append(row[np.isfinite(row).all(axis=1)])
    every = np.concatenate(rows)
    return every[:, 0], every[:, 1:]


def _solved(columns: Array, values: Array) -> tuple[Array, Array, Array]:
    """Columns (n, k), the last one left out where it is not seen in the values, their (k,) coefficients by least squares, and
    the standard deviations of these.
    """
    found, error = _least_squares(columns, values)
    if abs(found[-1]) > STANDARD_ERRORS * error[-1]:
        return columns, found, error
    return columns[:, :-1], *_least_squares(columns[:, :-1], values)


def _least_squares(columns: Array, values: Array) -> tuple[Array, Array]:
    """(k,) coefficients and their standard deviations, with stretches of time left out in turn."""
    pairs = zip(np.array_split(columns, FEWEST_PARTS), np.array_split(values, FEWEST_PARTS), strict=True)
    squares, sides = (np.array(each) for each in zip(*((c.T @ c, c.T @ v) for c, v in pairs), strict=True))
    scale = np.sqrt(np.maximum(np.diag(squares.sum(axis=0)), np.finfo(float).tiny))  # rad beside ones

    def solve(square: Array, side: Array) -> Array:
        return np.linalg.lstsq(square / np.outer(scale, scale), side / scale, rcond=None)[0] / scale

    whole, beside = squares.sum(axis=0), sides.sum(axis=0)
    without = np.array([solve(whole - a, beside - b) for a, b in zip(squares, sides, strict=True)])
    return solve(whole, beside), jackknife(without)


def _converted(recording: Recording, lines: Mapping[str, Line], drives: Mapping[str, str]) -> Recording:
    command, position = _without_unit(recording), recording.channels.get("position")
    if command is None or position is None:
        return recording
    values, units = np.array(command.values), [command.unit_of(x) for x in command.labels]
    for k, label in enumerate(command.labels):
        line = lines.get(drives.get(label, ""))
        if line is not None and not units[k] and drives[label] in position.labels:
            values[:, k] = (values[:, k] - line.zero) / line.per
            units[k] = position.unit_of(drives[label])
    most = max(dict.fromkeys(units), key=units.count)
    return recording.with_channel(
        command.replace(values=values, unit=most, units=tuple(units) if len(set(units)) > 1 else ())
    )


def _note(lines: Mapping[str, Line], drives: Mapping[str, str], recordings: Sequence[Recording]) -> list[str]:
    """One sentence: the factors and how sure they are, what is known to count so, and what to write into the mapping."""
    commands = [c for c in map(_without_unit, recordings) if c is not None]
    labels = list(dict.fromkeys(x for c in commands for x in c.labels if drives.get(x) in lines))
    told = "; ".join(f"{x} {lines[drives[x]]}" for x in labels)
    known = list(dict.fromkeys(line.known for line in lines.values()))
    count = f"taken as {known[0]}" if len(known) == 1 and known[0] else "taken so"
    doubt = "" if all(known) else ", by the factor that was measured, since nothing known counts so"
    scale, offset = ([f(lines[drives[x]]) for x in labels] for f in (lambda z: 1.0 / z.per, lambda z: -z.zero / z.per))
    written = [", ".join(f"{v:.6g}" for v in (each[:1] if len(set(each)) == 1 else each)) for each in (scale, offset)]
    return [
        f"commands have no unit and are no rad; joints follow them in proportion (for each rad or m, at zero, correlation:"
        f" {told}): {count}{doubt}. If they are anything else, say so in the mapping, in [channels.{commands[0].name}]; this "
        f'is unit = "rad", scale = [{written[0]}] and offset = [{written[1]}], for {", ".join(labels)}'
    ]
