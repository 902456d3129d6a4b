# SPDX-License-Identifier: Apache-2.0
"""Where a logger stopped, what comes after begins anew; where only commands rest, nothing does."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.arrays import Array, Mask
from trueup.inspection.pauses import parted_at_pauses, parts_between
from trueup.inspection.stamps import Gap
from trueup.recording import PART_OF, Channel, Recording
from trueup.trial import Trial

TIME: Array = 0.01 * np.arange(800, dtype=np.float64)
MOVING = 0.5 * np.sin(2.0 * TIME)


def log(kept: Mask, command: Array = MOVING, told: Mask | None = None, late: float = 0.0) -> Recording:
    """Position and command of one joint at the instants kept, commands at those `told` and stamped `late` s."""
    told = kept if told is None else told
    channels = {"position": (TIME[kept], MOVING[kept]), "command": (TIME[told] + late, command[told])}
    return Recording("jog", {n: Channel(n, ("x",), "rad", t, v[:, None]) for n, (t, v) in channels.items()})


def without(*spans: tuple[float, float]) -> Mask:
    return ~np.any([(a - 0.001 < TIME) & (b - 0.001 > TIME) for a, b in spans], axis=0)


def test_a_log_with_a_pause_is_two_recordings_and_a_note_says_when() -> None:
    (first, second), (note,) = parted_at_pauses([log(without((3.0, 5.0)))])
    assert (first.name, second.name) == ("jog part 1", "jog part 2")
    assert first.provenance[PART_OF] == second.provenance[PART_OF] == "jog"
    assert (first.stop, second.start) == (pytest.approx(2.99), pytest.approx(5.0))
    assert second.channel("command").values[0, 0] == pytest.approx(MOVING[500])
    assert "'jog' has a pause" in note
    assert "2.99 ... 5 s" in note


def test_nothing_is_measured_behind_a_pause_while_what_was_commanded_in_it_may_act() -> None:
    (first, second), _ = parted_at_pauses([log(without((3.0, 5.0)))], late=0.1)
    assert first.stop == pytest.approx(2.99)
    assert second.channel("position").time[0] == pytest.approx(5.1)
    told = Trial.of(second).command
    assert told is not None
    assert (Trial.of(second).start, told.time[0]) == (pytest.approx(5.1), pytest.approx(5.0))


def test_parts_of_which_nothing_was_lost_know_what_was_commanded_before_them() -> None:
    whole = log(without((8.0, 9.0)))
    first, second = parts_between(whole, [Gap(3.0, 2.0)], known=1.0)
    assert first.start == 0.0
    assert second.channel("position").time[0] == pytest.approx(5.0)
    assert second.channel("command").time[0] == pytest.approx(4.0)


def test_rows_without_values_are_a_pause_too() -> None:
    kept, empty = without((3.0, 5.0)), np.where(without((3.0, 5.0)), MOVING, np.nan)
    rows = [Channel(n, ("x",), "rad", TIME, empty[:, None]) for n in ("position", "command")]
    parts, _ = parted_at_pauses([Recording("jog", {c.name: c for c in rows})])
    assert [len(p.time) for p in parts] == [300, 300]
    assert kept.sum() == 600


def test_a_short_pause_counts_where_the_command_leaps_over_it() -> None:
    still = np.where(TIME < 4.0, MOVING, MOVING[400])
    for command, parts in ((MOVING, 2), (still, 1)):
        at = (3.0, 3.1) if parts == 2 else (6.0, 6.1)
        assert len(parted_at_pauses([log(without(at), command)])[0]) == parts


def test_what_is_no_pause_leaves_the_recording_as_it_is() -> None:
    steps = np.round(MOVING)
    changes = np.append(True, np.diff(steps) != 0.0)
    logs = (
        log(without((8.0, 9.0))),
        log(without((1.0, 1.01), (3.0, 3.01), (5.0, 5.01))),
        log(without((8.0, 9.0)), steps, told=changes),  # commands that are published when they change
        log(without((3.0, 5.0)), told=without((8.0, 9.0))),  # only the measurement pauses
        log(without((3.0, 5.0))).without("command"),
    )
    kept, notes = parted_at_pauses(logs)
    assert all(a is b for a, b in zip(kept, logs, strict=True))
    assert not notes


def test_a_part_begins_with_a_command_of_its_own_and_holds_the_last_where_none_comes_soon() -> None:
    own = log(without((3.0, 5.0)), late=0.004)
    begins = parted_at_pauses([own])[0][1]
    assert begins.channel("command").values[0, 0] == pytest.approx(MOVING[500])
    steps = np.where(TIME < 2.0, 0.0, np.where(TIME < 7.0, 1.0, 2.0))
    changes = np.append(True, np.diff(steps) != 0.0)
    holds = parted_at_pauses([log(without((3.0, 5.0)), steps, told=changes)])[0][1]
    assert holds.channel("command").values[:, 0].tolist() == [1.0, 2.0]


def test_what_is_too_short_to_begin_is_left_out_unless_that_were_all() -> None:
    (first, last), _ = parted_at_pauses([log(without((2.0, 4.0), (4.05, 6.0)))])
    assert (first.stop, last.start) == (pytest.approx(1.99), pytest.approx(6.0))
    alone = log((TIME < 0.05) | (TIME > 7.955))
    assert parted_at_pauses([alone])[0] == [alone]
