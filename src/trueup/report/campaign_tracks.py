# SPDX-License-Identifier: Apache-2.0
"""What the robot did, as a picture: its first run beside its best, as tracks on the floor or curves over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.campaign.history import History, TrialStory
from trueup.campaign.journal import reference_file
from trueup.errors import TrueupError
from trueup.formats import read
from trueup.inspection.repeats import BASE
from trueup.recording import Recording
from trueup.report.drawing import LINE, SAMPLES
from trueup.report.markup import Markup, join, tag
from trueup.report.plots import AFTER, BEFORE, FAINT, Plot, span
from trueup.rounding import TINY
from trueup.samples import thinned

POSITION, ORIENTATION = BASE
_BASE = {"pitch": "pitch of the torso", "roll": "roll of the torso", "z": "height of the torso"}


@dataclass(frozen=True)
class Track:
    """The same of the task's trials, run with the first settings and with the best."""

    of: str
    first: Recording | None
    best: Recording
    wanted: Array | None = None
    """(N, 2) x and y of the path that was to be followed, in m; None where there was none."""


def tracks_of(history: History, folder: Path) -> tuple[Track, ...]:
    """One for each of the task's trials that the best settings were run with; recordings that cannot be read are left out."""
    best, first = _latest(history, history.best[0]), _latest(history, _first_settings(history))
    found = []
    for of, story in best.items():
        after = _recording(story, folder)
        before = _recording(first[of], folder) if of in first and first[of] is not story else None
        if after is not None:
            found.append(Track(of, before, after, _wanted(folder, of)))
    return tuple(found)


def track_figure(track: Track) -> Markup:
    """A map where positions are x and y, else over time how a free base leans and how high it is, or the first columns."""
    if track.best.has(ORIENTATION) and track.best.has(POSITION):
        shown = ((ORIENTATION, "pitch"), (ORIENTATION, "roll"), (POSITION, "z"))
        return tag("div", tag("h4", track.of), join(_over_time(track, *c) for c in shown if _has(track.best, *c)))
    channel = track.best.channel("position") if track.best.has("position") else next(iter(track.best.channels.values()))
    labels = tuple(channel.labels)
    if {"x", "y"} <= set(labels):
        picture = _map(track)
    else:
        picture = join(_over_time(track, channel.name, label) for label in labels[:3])
    return tag("div", tag("h4", track.of), picture)


def _has(recording: Recording, channel: str, label: str) -> bool:
    return label in recording.channel(channel).labels


def _map(track: Track) -> Markup:
    lines = [(r, c) for r, c in ((track.first, BEFORE), (track.best, AFTER)) if r is not None and r.has("position")]
    points = [(thinned(r.channel("position").select(("x", "y")).values, SAMPLES), c) for r, c in lines]
    everything = np.concatenate([p for p, _ in points])
    wide, high = (float(np.nanmax(everything[:, k]) - np.nanmin(everything[:, k])) for k in (0, 1))
    height = int(np.clip(58 + 760 * high / max(wide, TINY), 160, 560))
    plot = Plot(span(everything[:, 0]), span(everything[:, 1]), "x, m", "y, m", width=860, height=height, equal=True)
    if track.wanted is not None:
        plot.line(thinned(track.wanted, SAMPLES), FAINT, width=3 * LINE)
    for p, colour in points:
        plot.line(p, colour)
    return plot.svg(f"Where the robot went in {track.of}: at first, and with the best settings")


def _over_time(track: Track, channel: str, label: str) -> Markup:
    lines = []
    for recording, colour in ((track.first, BEFORE), (track.best, AFTER)):
        if recording is not None and recording.has(channel) and label in recording.channel(channel).labels:
            c = recording.channel(channel)
            lines.append((thinned(np.stack([c.time - c.time[0], c.column(label)], axis=1), SAMPLES), c.unit, colour))
    everything = np.concatenate([p for p, _, _ in lines])
    title = f"{_BASE.get(label, label) if channel in (ORIENTATION, POSITION) else label}, {lines[0][1]}"
    plot = Plot(span(everything[:, 0], margin=0.0), span(everything[:, 1]), "time, s", title, width=860, height=200)
    for p, _, colour in lines:
        plot.line(p, colour, width=LINE)
    return plot.svg(f"{channel} of {label} in {track.of}: at first, and with the best settings")


def _latest(history: History, settings: object) -> dict[str, TrialStory]:
    """Task's trial -> the last trial done with these settings."""
    return {
        t.planned.of: t
        for t in history.trials
        if t.done is not None and t.done.outcome == "done" and dict(t.planned.settings) == settings
    }


def _first_settings(history: History) -> dict[str, float]:
    done = [t for t in history.trials if t.done is not None and t.done.outcome == "done"]
    return dict(done[0].planned.settings) if done else {"": math.nan}


def _wanted(folder: Path, of: str) -> Array | None:
    """The path of a task's trial, as the campaign kept it."""
    try:
        head, *rows = reference_file(folder, of, "path").read_text(encoding="utf-8").splitlines()
        labels = [label.split(" [")[0] for label in head.split(",")]
        table = np.array([[float(v) for v in row.split(",")] for row in rows])
        return table[:, [labels.index("x"), labels.index("y")]]
    except (OSError, ValueError, IndexError):
        return None


def _recording(story: TrialStory, folder: Path) -> Recording | None:
    if story.done is None or not story.done.recordings:
        return None
    try:
        (found,) = read(folder / "recordings" / story.done.recordings[0])
    except TrueupError:
        return None
    return found
