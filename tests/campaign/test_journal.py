# SPDX-License-Identifier: Apache-2.0
"""The journal gives back what was written, forgives a torn last line and nothing else."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from trueup.campaign.events import Begun, Event, Generation, RoundBegun, TrialDone
from trueup.campaign.journal import JOURNAL, TIMES, Journal, read_journal, read_times, set_back
from trueup.errors import JournalError

EVENTS: tuple[Event, ...] = (
    Begun("abc", 3, "0.1", "m", {"gain": "1/s"}),
    RoundBegun(1, (0.1 + 0.2, 1 / 3), 0.5),
    Generation(1, ((0.1, 1e-17), (2.0, 5e-324)), (1.5, math.nan), (1.0, math.nan), (0.5, math.nan)),
    TrialDone("trial-001", "done", ("trial-001.parquet",), ("ff",), "wind — 3 Bft"),
)


def written(folder: Path, events: tuple[Event, ...] = EVENTS) -> Path:
    with Journal(folder) as journal:
        for event in events:
            journal.once(type(event), lambda e=event: e)
    return folder / JOURNAL


def untimed(folder: Path) -> None:
    """When an event was written is noted after it is safe: of a torn line nothing is."""
    times = folder / TIMES
    times.write_text("".join(times.read_text().splitlines(keepends=True)[: len(EVENTS) - 1]))


def same(a: tuple[Event, ...], b: tuple[Event, ...]) -> bool:
    return repr(a) == repr(b)  # NaN is NaN


def test_every_number_comes_back_bit_for_bit(tmp_path: Path) -> None:
    written(tmp_path)
    assert same(read_journal(tmp_path), EVENTS)
    assert sorted(read_times(tmp_path)) == [0, 1, 2, 3]


def test_a_journal_torn_at_any_byte_of_its_last_line_goes_on_before_it(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    last = whole[:-1].rindex(b"\n") + 1
    for cut in range(last, len(whole)):
        path.write_bytes(whole[:cut])
        untimed(tmp_path)
        with Journal(tmp_path) as journal:
            assert same(journal.past, EVENTS[:-1])
            for event in EVENTS:
                journal.once(type(event), lambda e=event: e)
        assert path.read_bytes() == whole


def test_a_power_cut_that_left_zeros_is_a_torn_line(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    last = whole[:-1].rindex(b"\n") + 1
    path.write_bytes(whole[:last] + b"\0" * (len(whole) - last))
    assert same(read_journal(tmp_path), EVENTS[:-1])


@pytest.mark.parametrize("line", [0, 1, 2])
def test_damage_before_the_last_line_is_an_error_that_names_the_line(tmp_path: Path, line: int) -> None:
    path = written(tmp_path)
    lines = path.read_bytes().splitlines(keepends=True)
    lines[line] = lines[line][:10] + b"\n"
    path.write_bytes(b"".join(lines))
    with pytest.raises(JournalError, match=f"line {line + 1}: .*damaged.*--from-line {line + 1}"):
        Journal(tmp_path)


def test_a_missing_line_is_damage(tmp_path: Path) -> None:
    path = written(tmp_path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:1] + lines[2:]))
    with pytest.raises(JournalError, match="line 2"):
        read_journal(tmp_path)


def test_two_processes_cannot_write_one_journal(tmp_path: Path) -> None:
    with Journal(tmp_path), pytest.raises(JournalError, match="another process"):
        Journal(tmp_path)
    Journal(tmp_path).close()  # and the lock goes with its holder


def test_what_is_there_is_not_made_again(tmp_path: Path) -> None:
    written(tmp_path)

    def never() -> Begun:
        raise AssertionError("made again")

    with Journal(tmp_path) as journal:
        assert journal.once(Begun, never) == EVENTS[0]


def test_another_kind_of_event_than_was_written_is_an_error(tmp_path: Path) -> None:
    written(tmp_path)
    with Journal(tmp_path) as journal, pytest.raises(JournalError, match="Begun where this version"):
        journal.once(RoundBegun, lambda: RoundBegun(1, (), 0.1))


def test_an_event_of_another_version_is_not_guessed_at(tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_text('{"number":0,"event":"Begun","plan":"x"}\n{"number":1}\n')
    with pytest.raises(JournalError, match="another version"):
        read_journal(tmp_path)


def test_any_altered_character_is_seen(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    for at in range(len(whole)):
        changed = bytearray(whole)
        changed[at] = ord("7") if changed[at] != ord("7") else ord("8")
        path.write_bytes(bytes(changed))
        with pytest.raises(JournalError):
            Journal(tmp_path)


def test_lines_lost_at_the_end_are_seen(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:2]))
    with pytest.raises(JournalError, match=r"2 whole lines where 4 were written.*--from-line 3"):
        Journal(tmp_path)


def test_an_empty_journal_beside_outcomes_of_trials_is_refused(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "trial-001.json").write_text("{}")
    with pytest.raises(JournalError, match=r"trial-001\.json"):
        Journal(tmp_path)


def test_a_journal_without_check_sums_is_read_and_guarded_from_there_on(tmp_path: Path) -> None:
    path = written(tmp_path)
    old = re.sub(rb',"check":"[0-9a-f]+"', b"", path.read_bytes())
    path.write_bytes(old)
    with Journal(tmp_path) as journal:
        assert same(journal.past, EVENTS)
        for event in EVENTS:
            journal.once(type(event), lambda e=event: e)
        journal.once(RoundBegun, lambda: RoundBegun(2, (), 0.1))
    assert same(read_journal(tmp_path), (*EVENTS, RoundBegun(2, (), 0.1)))
    path.write_bytes(path.read_bytes().replace(b'"seed":3', b'"seed":4'))
    with pytest.raises(JournalError, match="line 5: altered"):
        read_journal(tmp_path)


def test_a_journal_set_back_goes_on_from_its_good_lines_and_keeps_the_old_one(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    damaged = whole.replace(b"1e-17", b"1e-16")
    path.write_bytes(damaged)
    with pytest.raises(JournalError, match="line 3"):
        set_back(tmp_path, 4)  # the damage would stay in it
    aside = set_back(tmp_path, 3)
    assert aside.read_bytes() == damaged
    with Journal(tmp_path) as journal:
        assert same(journal.past, EVENTS[:2])
        for event in EVENTS:
            journal.once(type(event), lambda e=event: e)
    assert path.read_bytes() == whole
