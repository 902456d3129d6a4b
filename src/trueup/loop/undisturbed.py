# SPDX-License-Identifier: Apache-2.0
"""Whether something acted on the robot that the model does not have, as soon as a search has looked at all recordings."""

from __future__ import annotations

from trueup.inspection.released import LONG
from trueup.loop.disturbed import deviations_of, disturbed
from trueup.loop.stages import Run
from trueup.loop.windows import in_windows


def undisturbed(run: Run) -> None:
    """Stretches that stand out where the search is, and in replays from there that begin anew every so often, too."""
    if not run.looks or run.look.problem.duration < run.problem.duration:
        return
    problem, values = run.look.problem, run.descent.space.from_unit(run.descent.point)
    run.disturbed = disturbed(deviations_of(problem, values), lambda: deviations_of(in_windows(problem, LONG), values))
