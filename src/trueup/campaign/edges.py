# SPDX-License-Identifier: Apache-2.0
"""Settings that came to an end of what was searched: better ones may lie beyond."""

from __future__ import annotations

from trueup.campaign.history import History
from trueup.loop.elsewhere import EDGE


def at_edges(history: History) -> str:
    """A sentence that names the best settings that lie at an end of their range; '' where none does.

    A setting of zero at its end is none of it (no lead, no delay): there is no more to be had. Grades that were made
    beforehand end where they were made to end.
    """
    best = history.best[0]
    rows = [s.unit for r in history.rounds for s in r.scored if best and history.settings(s.unit) == best]
    if not rows or history.on_robot:
        return ""
    ends = [
        f"{name} = {history.setting(name, value)} at the {'lower' if unit < 0.5 else 'upper'} end"
        for (name, value), unit in zip(best.items(), rows[0], strict=True)
        if min(unit, 1.0 - unit) < EDGE and value != 0.0
    ]
    if not ends:
        return ""
    return (
        f"{', '.join(ends)} of what is searched: better ones may lie beyond (ranges are those of the task's parameters; a "
        "path follower's are said in the plan: [task] ranges), or it hardly matters"
    )
