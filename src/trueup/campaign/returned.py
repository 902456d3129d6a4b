# SPDX-License-Identifier: Apache-2.0
"""What a robot's `perform` returned, checked before anything is made of it: drivers are users' own code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized

from trueup.errors import TrialError
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.trial import Trial


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
