# SPDX-License-Identifier: Apache-2.0
"""What eyes and a stop watch tell of a run, in place of a log: when it passed lines, how far it came, how it ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trueup.errors import TrialError
from trueup.recording import Channel, Recording
from trueup.rounding import SAME_INSTANT
from trueup.trial import Ended, Trial, Watched, with_end

WATCHED = "told"
"""Channel of a recording that holds nothing else: how far ahead the robot was when, and to which side it fell."""
_LABELS, _UNITS = ("ahead", "forward", "left"), ("m", "1", "1")
SIDES = {
    "forward": (1.0, 0.0), "backward": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0), "unknown": (0.0, 0.0),
}  # fmt: skip
"""To which side a robot falls: forward and left, as the channel has it."""


@dataclass(frozen=True)
class WatchedRun:
    """One run of a trial that is `Watched`."""

    seconds: tuple[float, ...] = ()
    """Since its start, when it passed each of the lines that it came to."""
    metres: float = math.nan
    """How far it came in all; NaN where nobody measured: as far as the last line that it passed."""
    fell: str = ""
    """To which of `SIDES`; '' where it did not."""
    veered: bool = False
    late: bool = False
    """It was still on the way to a line when the trial's time was over."""

    @property
    def forward(self) -> float:
        """How likely it fell forward rather than backward; half where nobody can say."""
        return 0.5 + 0.5 * SIDES[self.fell or "unknown"][0]

    def recording(self, trial: Trial) -> Recording:
        """The same as a recording of the trial. Raises TrialError, a sentence of what cannot be."""
        watched = trial.watched
        if watched is None:
            raise TrialError(f"{trial.name} cannot be judged by eyes and a stop watch: it asks for a log")
        self._check(trial, watched)
        rows = [(t, x) for t, x in zip((0.0, *self.seconds), (0.0, *watched.lines), strict=False)]
        if math.isfinite(self.metres) and self.metres > rows[-1][1]:
            rows.append((trial.duration, self.metres))  # at the latest
        values = np.full((len(rows), len(_LABELS)), np.nan)
        values[:, 0] = [x for _, x in rows]
        if self.fell:
            values[-1, 1:] = SIDES[self.fell]
        channel = Channel(WATCHED, _LABELS, "m", np.array([t for t, _ in rows]), values, _UNITS)
        made = Recording(trial.name, {WATCHED: channel}, {"source": "told by who watched it"})
        end = self._end(watched)
        return with_end(made, Ended(rows[-1][0], end)) if end else made

    def words(self, trial: Trial) -> str:
        """What is told, for whoever is to see a slip of the pen."""
        lines = trial.watched.lines if trial.watched else ()
        came = [
            f"{'over the line' if len(lines) == 1 else f'over line {k + 1}'} after {t:.4g} s ({v:.3g} m/s)"
            for k, (t, v) in enumerate(zip(self.seconds, self._speeds(lines), strict=True))
        ]
        if math.isfinite(self.metres):
            came.append(f"came {self.metres:.4g} m")
        side = (
            ""
            if self.fell == "unknown"
            else f" to the {self.fell}"
            if self.fell in ("left", "right")
            else f" {self.fell}"
        )
        came += [f"fell{side}"] * bool(self.fell) + ["veered"] * self.veered + ["was late"] * self.late
        return ", ".join(came)

    def _speeds(self, lines: tuple[float, ...]) -> list[float]:
        """m/s from line to line."""
        spent = np.diff((0.0, *self.seconds))
        return [float(x) for x in np.diff((0.0, *lines))[: len(spent)] / np.maximum(spent, SAME_INSTANT)]

    def _end(self, watched: Watched) -> str:
        if self.fell:
            return watched.fallen
        if self.veered:
            return watched.veered
        return watched.arrived if watched.lines and len(self.seconds) == len(watched.lines) else ""

    def _check(self, trial: Trial, watched: Watched) -> None:
        if self.fell and self.fell not in SIDES:
            raise TrialError(f"fell = '{self.fell}' is not one of: {', '.join(SIDES)}")
        ends = [w for w, there in (("fell", self.fell), ("veered", self.veered), ("late", self.late)) if there]
        if len(ends) > 1:
            raise TrialError(f"a run ends in one way, and this one {' and '.join(ends)}: leave what came first")
        if self.veered and not watched.veered:
            raise TrialError(f"veered: no line bounds the way of {trial.name} to the sides")
        self._check_times(trial, watched)
        self._check_way(watched)
        count, lines = len(self.seconds), len(watched.lines)
        if lines and count < lines and not ends:
            passed = "no line" if not count else f"line {count} alone" if count == 1 else f"{count} lines"
            raise TrialError(
                f"it passed {passed} of {lines}, and nothing says how it ended: fell, veered, or late (not there after "
                f"{trial.duration:.4g} s)"
            )
        if lines and count == lines and ends:
            raise TrialError(
                f"it passed the last line, where the run is over, and {ends[0]}: leave out what came later"
            )
        if not lines and (self.late or (not ends and not math.isfinite(self.metres))):
            raise TrialError(f"say with metres how far it came in {trial.duration:.4g} s, or how it ended: fell")

    def _check_times(self, trial: Trial, watched: Watched) -> None:
        known = ", ".join(f"{t:g}" for t in self.seconds)
        if len(self.seconds) > len(watched.lines):
            asked = {0: "none is asked for", 1: "one line is asked for"}.get(
                len(watched.lines), f"{len(watched.lines)} lines are asked for"
            )
            raise TrialError(f"seconds = {known}: {len(self.seconds)} times, where {asked}")
        if not all(math.isfinite(t) and t > 0.0 for t in self.seconds):
            raise TrialError(f"seconds = {known}: times are above zero, in s since the start")
        if not all(a < b for a, b in zip(self.seconds, self.seconds[1:], strict=False)):
            raise TrialError(
                f"seconds = {known}: times of lines grow, all in s since the start and not since the line before"
            )
        if self.seconds and self.seconds[-1] >= trial.duration:
            raise TrialError(
                f"seconds = {known}: the run is over after {trial.duration:.4g} s; of one that takes longer say late = true"
            )
        fastest = (
            watched.fastest(np.array(list(trial.settings.values()))) if watched.fastest and trial.settings else math.inf
        )
        for k, speed in enumerate(self._speeds(watched.lines)):
            self._check_speed(speed, fastest, f"seconds = {known}: {speed:.3g} m/s to line {k + 1}")
        if not watched.lines and math.isfinite(self.metres):
            speed = self.metres / trial.duration
            self._check_speed(speed, fastest, f"metres = {self.metres:g}: {speed:.3g} m/s")

    def _check_speed(self, speed: float, fastest: float, what: str) -> None:
        if speed > fastest:
            raise TrialError(
                f"{what}, where these settings' steps allow {fastest:.3g} m/s at the very most: a slip of the pen?"
            )

    def _check_way(self, watched: Watched) -> None:
        if math.isnan(self.metres):
            return
        passed = ((0.0, *watched.lines)[len(self.seconds)],) if self.seconds else (0.0,)
        coming = watched.lines[len(self.seconds) :]
        if not (math.isfinite(self.metres) and self.metres >= passed[0]):
            least = f"it passed the line at {passed[0]:g} m" if passed[0] else "it is counted from the start"
            raise TrialError(f"metres = {self.metres:g}: {least}")
        if coming and self.metres >= coming[0]:
            raise TrialError(
                f"metres = {self.metres:g}: that is beyond the line at {coming[0]:g} m, whose time is not among seconds"
            )


def watched_run(recording: Recording, watched: Watched) -> WatchedRun:
    """What was told of a run that was watched so. Raises UnknownNameError for a recording that is a log."""
    channel = recording.channel(WATCHED)
    ahead, side = channel.column("ahead"), channel.values[-1, 1:]
    seconds = tuple(float(t) for t, x in zip(channel.time, ahead, strict=True) if x in watched.lines)
    fell = next((name for name, way in SIDES.items() if np.array_equal(way, side)), "")
    return WatchedRun(seconds, float(ahead[-1]), fell)


def is_watched(recording: Recording) -> bool:
    """Whether a recording holds what people saw, and no log."""
    return recording.has(WATCHED)
