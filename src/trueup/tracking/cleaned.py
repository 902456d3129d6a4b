# SPDX-License-Identifier: Apache-2.0
"""Makes a tracked pose usable: what the tracker mistook for the car is taken out, the throttle is cut where it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Mask
from trueup.instant import usual_step
from trueup.recording import Channel, Recording, with_warnings
from trueup.rounding import PRINTED
from trueup.samples import wrapped
from trueup.tracking.commands import effective
from trueup.tracking.heading import backing, course, heading_of, samples_in, told_by, turned_with
from trueup.tracking.joined import end_to_end, joined, notes_on_jumps, sudden, there_and_back
from trueup.tracking.place import fresh, place_of, tells_place
from trueup.tracking.reversing import as_heading, driven_back
from trueup.tracking.sense import Moves, Sense, Source, aligned, heading_source
from trueup.units import GRAVITY

_NOISE, _TURN = 0.03, 0.15  # m, rad: more from one sample to the next, beyond what the speed explains, is a jump
_LATE, _FEW = 0.05, 10  # s; samples that tell what is usual
_CONTRADICTED = 0.2  # share of the poses; where wheels agree with fewer, their speed is not to be relied on
_ELSEWHERE = (
    "the recorded heading goes with the way driven in neither sense and from no zero, as that of wheel odometry where wheels "
    "skid, and is not used"
)
_DISAGREES = 0.3  # m/s between tracked and wheel speed, of a whole piece


def cleaned(
    recording: Recording,
    enabled_by: str = "",
    middle: tuple[float, float] = (0.0, 0.0),
    full: tuple[float, float] | None = None,
    wheelbase: float = 1.0,
    *,
    backs: bool = True,
    headings: Mapping[Source, Sense] | None = None,
) -> Recording:
    """The recording with NaN where position and heading are not the car's, and no throttle where it was cut.

    A tracker that loses the car shows something else: the pose jumps there and back. Pieces between jumps are kept where
    their speed is that of the wheels, or, where no wheel speed was recorded, where they follow on the longest
    one. A log without heading gets the direction of motion in its place, one without position the way that speed and
    turn rate add up to (see `place_of`). Commands count from `middle` in units of `full`; `wheelbase` (m) makes angles of
    turn rates. Where a vehicle that is simulated forward only (not `backs`) backs off is left out. What was taken out is
    said in the provenance's warnings. Raises RecordingError without pose or command.
    """
    position, heading, measured, good, jumps, notes = _tracked(recording)
    missing, turned = "no heading was recorded" if heading is None else _ELSEWHERE, list[str]()
    if heading is not None:
        heading, turned = aligned(position, heading, good, (headings or {}).get(heading_source(recording)))
    if heading is None:
        notes += [*_lost(measured & ~good), *notes_on_jumps(position, jumps)]
        back = driven_back(recording, position)
        gyro = recording.channel("yaw_rate") if recording.has("yaw_rate") else None
        heading = None if gyro is None else turned_with(position, gyro, good, back)
        source = "the direction of motion stands" if heading is None else "turn rate and direction of motion stand"
        notes.append(f"{missing}: {source} for it")
        heading = heading or course(position, good, back)
        good &= np.isfinite(heading.values[:, 0])
    else:
        every, away = there_and_back(position, sorted({*jumps, *sudden(position, heading, good)}))
        position, heading = joined(position, heading, every)
        good &= ~away
        notes += [*_lost(measured & ~good), *turned, *notes_on_jumps(position, every)]
        back = backing(position, heading, good) & (not backs)
        good &= ~back
        share = f"{100 * float(back.mean()):.1f} % of the poses are of driving backwards and were left out"
        notes += [f"{share}: a throttle below zero is taken for the brake"] if back.any() else []
    angle = np.full((len(good), 1), np.nan)
    angle[good, 0] = np.unwrap(heading.values[good, 0])
    kept = recording.with_channel(position.replace(values=np.where(good[:, None], position.values, np.nan)))
    kept = kept.with_channel(heading.replace(values=angle, labels=("heading",)))
    kept = kept.with_channel(effective(recording, enabled_by, middle, full, wheelbase))
    return kept.replace(provenance=with_warnings(recording.provenance, notes))


def _lost(away: Mask) -> list[str]:
    """What to say of poses that were measured and are not believed, if anything."""
    share = 100.0 * float(np.mean(away))
    return [f"{share:.1f} % of the poses jump away or contradict the wheels and were left out"] if share else []


def heading_senses(recordings: Sequence[Recording]) -> dict[Source, Sense]:
    """In which sense headings grow, by what recordings that were logged alike show together; without those added up."""
    drives: dict[Source, list[Moves]] = {}
    for recording in recordings:
        if not (recording.has("position") and tells_place(recording.channel("position")) and told_by(recording)):
            continue
        position, heading, _, good, _, _ = _tracked(recording)
        if heading is not None:
            drives.setdefault(heading_source(recording), []).append(Moves.of(position, heading, good))
    return {source: Sense.of(moves) for source, moves in drives.items() if len(moves) > 1}


def _tracked(recording: Recording) -> tuple[Channel, Channel | None, Mask, Mask, list[tuple[int, int]], list[str]]:
    """Position, the heading as recorded at the same times, (T,) which of both were measured and which are believed, the rows
    between which these jump, and notes. Places go on where they jump; whether they do so turned, the heading's sense must
    tell first.
    """
    position, heading, notes = place_of(recording)
    heading = heading or heading_of(recording)
    position, heading = fresh(position), heading and fresh(heading)
    if heading is not None and (
        len(position.time) != len(heading.time) or np.abs(position.time - heading.time).max() > PRINTED
    ):
        heading = heading.replace(time=position.time, values=_turned(heading, position.time))
    if heading is not None:
        heading, more = as_heading(heading, position, driven_back(recording, position))
        notes = [*notes, *more]
    seen = position.values if heading is None else np.concatenate([position.values, heading.values], axis=1)
    measured = np.asarray(np.isfinite(seen).all(axis=1))
    good, jumps = _of_the_car(recording, position, heading)
    jumps, away = there_and_back(position.replace(values=np.where(good[:, None], position.values, np.nan)), jumps)
    good &= ~away
    believed = position.replace(values=np.where(good[:, None], position.values, np.nan))
    return end_to_end(believed, jumps), heading, measured, good, jumps, notes


def _turned(heading: Channel, times: Array) -> Array:
    """(T, 1) the heading at other times, interpolated on the circle."""
    known = np.isfinite(heading.values[:, 0])
    whole = heading.replace(time=heading.time[known], values=np.unwrap(heading.values[known], axis=0))
    return whole.at(times)


def _of_the_car(recording: Recording, position: Channel, heading: Channel | None) -> tuple[Mask, list[tuple[int, int]]]:
    """(T,) which poses are believed, and the rows between which these jump: the last before, the first behind."""
    angle = heading.values[:, 0] if heading is not None else np.zeros(len(position.time))
    known = np.isfinite(position.values).all(axis=1) & np.isfinite(angle)
    rows = np.flatnonzero(known)
    good = np.zeros(len(known), dtype=bool)
    if len(rows) < 10:
        return good, []
    time, points = position.time[rows], position.values[rows]
    noise, fastest = _usual_motion(time, points)
    gone_on = _gone_on(time, points, noise, fastest)
    rows, time, points = rows[gone_on], time[gone_on], points[gone_on]
    pieces = _pieces(time, points, angle[rows], noise, fastest)
    believed = _agreeing(recording, position, rows, pieces) if recording.has("speed") else []
    if sum(b - a for a, b in believed) < _CONTRADICTED * len(rows):  # no wheel speed, or not in m/s
        believed = _following(time, points, pieces, noise, fastest)
    for start, stop in believed:
        good[rows[start:stop]] = True
    ends = [(stop - 1, start) for (_, stop), (start, _) in pairwise(believed)]
    usual = usual_step(time)
    ways = [(time[[*e]], points[[*e]], angle[rows[[*e]]]) for e in ends]
    # Of two that follow at once one jumped: that parts pieces.
    apart = [e for e, w in zip(ends, ways, strict=True) if e[0] + 1 == e[1] or _jumps(*w, noise, fastest, usual)[0]]
    return good, [(int(rows[last]), int(rows[first])) for last, first in apart]


def usual_speed(position: Channel) -> float:
    """The speed in m/s that the tracked point exceeds a seventh of the time; NaN where too little is known."""
    good = np.isfinite(position.values).all(axis=1)
    return _often(position.time[good], position.values[good])


def _often(time: Array, points: Array) -> float:
    if len(time) < 3:
        return float("nan")
    lag = max(1, round(samples_in(0.3, time)))
    if len(time) <= 2 * lag:
        return float("nan")
    moved = np.linalg.norm(points[lag:] - points[:-lag], axis=1) / (time[lag:] - time[:-lag])
    return float(np.percentile(moved, 85))


def _usual_motion(time: Array, points: Array) -> tuple[float, float]:
    """Noise of the points in m, and a speed in m/s beyond which they jump: well above those of the samples."""
    bends = np.abs(np.diff(points, n=2, axis=0))
    noise = max(_NOISE, 4.0 * float(np.median(bends)))
    usual = np.linalg.norm(points[1:] - points[:-1], axis=1) / np.diff(time)
    fastest = 3.0 + 4.0 * float(np.median(usual))
    often = _often(time, points)  # also where the car stands most of the time
    return noise, max(fastest, 2.0 * often) if np.isfinite(often) else fastest


def _gone_on(time: Array, points: Array, noise: float, fastest: float) -> Mask:
    """(T,) without what repeats a place to the last digit until the next one is far away: no fix came, nothing stood."""
    same = np.concatenate([[False], np.all(points[1:] == points[:-1], axis=1)])
    begun = np.flatnonzero(~same)
    stops = np.append(begun[1:], len(points))
    lost = np.zeros(len(points), dtype=bool)
    far = np.flatnonzero(np.append(_jumps(time, points, np.zeros(len(time)), noise, fastest, usual_step(time)), False))
    for k in np.searchsorted(stops, far, side="right").tolist():
        lost[begun[k] + 1 : stops[k]] = True
    return ~lost


def _pieces(time: Array, points: Array, angle: Array, noise: float, fastest: float) -> list[tuple[int, int]]:
    """Where the pose goes on without a jump; pieces of fewer than 10 samples, or 0.2 s, are left out."""
    usual = usual_step(time)
    jump = _jumps(time, points, angle, noise, fastest, usual)
    edges = [0, *(np.flatnonzero(jump) + 1).tolist(), len(time)]
    least = min(10, max(2, round(0.2 / max(usual, 1e-3))))
    return [(a, b) for a, b in pairwise(edges) if b - a >= least]


def _jumps(time: Array, points: Array, angle: Array, noise: float, fastest: float, usual: float) -> Mask:
    """(T - 1,) from which pose to the next nothing drives or turns; `usual` is the step in s from one to the next."""
    gaps = np.diff(time)
    way = np.where(_out_of_line(time, points), np.inf, np.linalg.norm(np.diff(points, axis=0), axis=1))
    turn = np.abs(wrapped(np.diff(angle)))
    return (way > noise + fastest * gaps) | (turn > _TURN + 10.0 * np.maximum(gaps - usual, 0.0) + 4.0 * usual)


def _out_of_line(time: Array, points: Array) -> Mask:
    """(T - 1,) which steps lead on neither from the one before nor to the one behind: farther off than noise, an instant that
    was written late, and the hardest braking and turning make. What jumps between slow fixes goes no faster than it drives.
    """
    out = np.zeros(max(len(time) - 1, 0), dtype=bool)
    if len(out) < _FEW:
        return out
    gaps, steps = np.diff(time), np.diff(points, axis=0)
    speeds, gap = steps / gaps[:, None], gaps[1:-1]
    off, going = np.inf, np.inf
    for beside in (speeds[:-2], speeds[2:]):
        off = np.minimum(off, np.linalg.norm(steps[1:-1] - beside * gap[:, None], axis=1))
        going = np.minimum(going, np.linalg.norm(beside, axis=1))  # of two one may be the way there, or back
    usual = max(_NOISE, 4.0 * float(np.median(off)))
    out[1:-1] = off > usual + np.minimum(2.0 * gap, _LATE) * going + GRAVITY * gap**2
    return out


def _agreeing(
    recording: Recording, position: Channel, rows: NDArray[np.intp], pieces: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Pieces whose speed is that of the wheels in the median."""
    speed = recording.channel("speed")
    time, points = position.time[rows], position.values[rows]
    believed = []
    for a, b in pieces:
        ahead = max(1, min((b - a) // 2, round(samples_in(0.2, time[a:b]))))
        shown = np.linalg.norm(points[a + ahead : b] - points[a : b - ahead], axis=1) / (
            time[a + ahead : b] - time[a : b - ahead]
        )
        middle = 0.5 * (time[a + ahead : b] + time[a : b - ahead])
        wheels = np.abs(np.interp(middle, speed.time, np.nan_to_num(speed.values[:, 0])))
        if np.median(np.abs(shown - wheels)) < _DISAGREES + 0.15 * np.median(wheels):
            believed.append((a, b))
    return believed


def _following(
    time: Array, points: Array, pieces: list[tuple[int, int]], noise: float, fastest: float
) -> list[tuple[int, int]]:
    """The chain of pieces, each within reach of the one before, that holds most samples."""
    best: list[tuple[int, int]] = []  # samples, piece before
    for k, (a, b) in enumerate(pieces):
        before = (0, -1)
        for j, (_, stop) in enumerate(pieces[:k]):
            reach = noise + max(5.0, 0.75 * fastest) * (time[a] - time[stop - 1])
            if np.linalg.norm(points[a] - points[stop - 1]) < reach:
                before = max(before, (best[j][0], j))
        best.append((b - a + before[0], before[1]))
    chain, k = [], int(np.argmax([count for count, _ in best])) if best else -1
    while k >= 0:
        chain.append(pieces[k])
        k = best[k][1]
    return chain[::-1]
