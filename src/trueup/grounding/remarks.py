# SPDX-License-Identifier: Apache-2.0
"""What whoever learns from recordings is to know of them, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.articulated.pose import ORIENTATION
from trueup.grounding.frames import step_of
from trueup.grounding.grounding import PREDICTED, Grounding
from trueup.grounding.others import telling_nothing
from trueup.grounding.rows import Inputs, Rows
from trueup.inspection.suspicions import at_odds
from trueup.instant import MISSING
from trueup.recording import Recording
from trueup.trial import command_of


def remarks(recordings: Sequence[Recording], rows: Rows, *, chosen: bool) -> tuple[str, ...]:
    """What is of another sign or unit, was held, stood still, was sampled too seldom or is not looked at.

    `chosen`: a user named the other channels.
    """
    inputs = rows.inputs
    said = [*at_odds(recordings), *_held(recordings, inputs), *_slow(recordings, inputs), *_still(rows)]
    if len(recordings) == 1:
        said.append(
            f"'{recordings[0].name}' is the only recording: parts of it are left out in place of whole runs, and may have "
            "their like among those learned from. Errors of another run may be larger: record several"
        )
    for name, why in ({} if chosen else telling_nothing(recordings)).items():
        said.append(f"'{name}' does not go in, since it {why} (--others {name}: it does)")
    return tuple(said)


def remark_of_share(grounding: Grounding, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """That a share was found by replays, of a robot with a free base: it may fall where it controls itself.

    Figures: docs/ground.md.
    """
    share = grounding.weights[1]
    if share <= PREDICTED or not all(r.has(ORIENTATION) for r in recordings):
        return ()
    return (
        f"{share:.2g} of what is predicted replays these recordings best, but was tried in no other, nor with a controller "
        "that feels what it does: of six simulated bipeds for which 0.6 or more did so, torsos of four were 1.3 to 3.3 times "
        "as far off in walks held out, and walks of three ranked worse than by the simulator as it is. "
        f"--share {PREDICTED:g} (the paper's) is the careful choice",
    )


def _held(recordings: Sequence[Recording], inputs: Inputs) -> list[str]:
    """How many commands are missing: those before them are in force."""
    missing, total, longest = 0, 0, 0.0
    for recording in recordings:
        command = command_of(recording)
        if command is None:
            continue
        command = command.select(inputs.commands)
        known = np.isfinite(command.values)
        missing, total = missing + int(np.count_nonzero(~known)), total + known.size
        for column in known.T:
            stamps = command.time[column]
            gaps = np.diff(stamps) if (~column).any() else np.zeros(0)
            longest = max(longest, float(gaps.max(initial=0.0)))
    if not missing:
        return []
    return [
        f"{missing} of {total} values of commands are missing: the one sent before is held, for {longest:.2g} s at most"
    ]


def _slow(recordings: Sequence[Recording], inputs: Inputs) -> list[str]:
    """Recordings whose samples are further apart than frames are."""
    steps = {r.name: step_of(r.channel("position").select(inputs.joints)) for r in recordings}
    slow = {name: step for name, step in steps.items() if step > MISSING * inputs.period}
    if not slow:
        return []
    most = max(slow.values())
    return [
        f"positions of {', '.join(slow)} were measured every {1e3 * most:.3g} ms only, and a frame is "
        f"{1e3 * inputs.period:.3g} ms: in between they are taken to go along lines, which is learned too. Leave "
        f"{'it' if len(slow) == 1 else 'them'} out, or take --period {most:.2g}"
    ]


def _still(rows: Rows) -> list[str]:
    still = [joint for joint, moves in zip(rows.inputs.commands, rows.moves, strict=True) if not moves]
    if not still:
        return []
    verb, it, are = ("stands", "it", "it is") if len(still) == 1 else ("stand", "them", "they are")
    where = "the recording" if len(rows.names) == 1 else f"all {len(rows.names)} recordings"
    return [
        f"{', '.join(still)} {verb} still in {where}: nothing can be learned of how commands move {it}, and {are} left out "
        "of all averages"
    ]
