# SPDX-License-Identifier: Apache-2.0
"""What a robot's `perform` returned, checked before anything is made of it: drivers are users' own code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized

from trueup.errors import TrialError
from trueup.inspection.asked import lasting, missized, sized, swapped
from trueup.inspection.requested import as_observed, completed
from trueup.inspection.si import in_si
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.trial import Trial
from trueup.watched_run import is_watched

_MENDS = {
    "instant": "",
    "clock": ": channels have their time in s",
    "short": " without an end that the trial has: raise TrialAbortedError, or RobotFellError, where a run ends early",
    "long": ": hand back the run that was asked for alone",
    "order": ": labels are to be in the order of the columns",
    "unit": ": name the unit of each channel",
}
"""What whoever wrote the driver does about each kind of `Unlike`."""


def recordings_of(robot: Robot, trial: Trial, returned: object) -> list[Recording]:
    """One recording for each of the trial's repeats; of a single repeat it may come without a list around it.

    Fewer where one of them says that the robot fell or was stopped. Raises TrialError, which names class and method and shows
    what was returned and what is wanted.
    """
    if isinstance(returned, Recording) and trial.repeats == 1:
        return [returned]
    if isinstance(returned, (list, tuple)):
        recordings = [r for r in returned if isinstance(r, Recording)]
        complete = len(recordings) == trial.repeats or outcome_of(recordings) != "done"
        if complete and len(recordings) == len(returned):
            return recordings
    wanted = "one Recording" if trial.repeats == 1 else f"{trial.repeats} Recordings, one for each repeat"
    raise TrialError(
        f"{trial.name}: {type(robot).__name__}.perform(trial) returned {_described(returned)}, where a list of {wanted} is "
        "wanted: `def perform(self, trial: Trial) -> list[Recording]`. Mend the driver; `trueup resume` goes on from here"
    )


def as_asked(trial: Trial, recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings of a run that was done, in SI, with the command that was requested where they hold none.

    Raises TrialError where one lacks what the trial observes, has it in a unit of another kind, is shorter or longer than
    the run, or has its joints in another order: nothing could be scored or calibrated by it, ever.
    """
    return [
        r
        if trial.watched is not None and is_watched(r)
        else completed(trial, _checked(trial, _observed(trial, in_si(as_observed(trial, r)))))
        for r in recordings
    ]


def _observed(trial: Trial, recording: Recording) -> Recording:
    asked = {name: o.labels for name, o in trial.observed.items()}
    if trial.command is not None:
        asked |= {n: trial.command.labels for n in ("command", "command_sent") if recording.has(n)}
    for name, labels in asked.items():
        has = recording.channel(name).labels if recording.has(name) else ()
        lost = [label for label in labels if label not in has]
        if lost:
            there = ", ".join(f"{c.name} ({', '.join(c.labels)})" for c in recording.channels.values())
            how = "observed" if name in trial.observed else "commanded"
            raise _unlike(trial, f"lacks {', '.join(lost)} of channel '{name}', which is {how}; it holds {there}")
    for name, o in trial.observed.items():
        units = {recording.channel(name).unit_of(label) for label in o.labels} - {"", o.unit}
        if o.unit and units and not recording.channel(name).units:
            raise _unlike(trial, f"has channel '{name}' in {', '.join(sorted(units))}, where {o.unit} is observed")
    return recording


def _checked(trial: Trial, recording: Recording) -> Recording:
    asked = trial.command
    unlike = lasting(trial, recording) or sized(trial, recording)
    if unlike is None and asked is not None:
        unlike = swapped(asked, recording) or missized(asked, recording)
    if unlike is not None:
        raise _unlike(trial, f"is not the run that was asked for: {unlike.words}{_MENDS[unlike.kind]}")
    return recording


def _unlike(trial: Trial, words: str) -> TrialError:
    return TrialError(
        f"{trial.name}: the robot's recording {words}. Mend the driver; `trueup resume` goes on from here"
    )


def outcome_of(recordings: Sequence[Recording]) -> str:
    """'done', unless a robot says of a recording that it fell or was aborted."""
    outcomes = {r.provenance.get("outcome", "") for r in recordings}
    return next((word for word in ("fell", "aborted") if word in outcomes), "done")


def _described(returned: object) -> str:
    """The type of what was returned, and of what is in it."""
    if returned is None:
        return "None"
    if isinstance(returned, (list, tuple)):
        within = ", ".join(dict.fromkeys("None" if x is None else type(x).__name__ for x in returned))
        return f"a {type(returned).__name__} of {len(returned)}" + (f" ({within})" if within else "")
    kind = type(returned).__name__
    article = "an" if kind[0] in "aeiouAEIOU" else "a"
    if isinstance(returned, Mapping):
        return f"{article} {kind} with the keys {', '.join(map(repr, returned)) or '(none)'}"
    size = f" of {len(returned)}" if isinstance(returned, Sized) and not isinstance(returned, Recording) else ""
    return f"{article} {kind}{size}"
