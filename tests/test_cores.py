# SPDX-License-Identifier: Apache-2.0
"""Work shared among threads: every row once, whatever the threads, and no more of them than pay."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from trueup.cores import Work, in_threads, in_turns, shares, worth
from trueup.engines.mujoco.batches import Batches


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2, 7])
@pytest.mark.parametrize("threads", [1, 2, 16])
def test_every_row_is_done_once(count: int, threads: int, timed: bool) -> None:
    done = np.zeros(count)

    def work(rows: slice) -> None:
        done[rows] += 1.0

    in_threads(work, count, threads, timed=timed)
    assert (done == 1.0).all()


def test_threads_are_taken_where_a_row_takes_long_and_not_where_it_is_quick(monkeypatch: pytest.MonkeyPatch) -> None:
    def who(spent: float) -> set[int]:
        seen, clock = set(), iter((0.0, spent))
        waiting = threading.Barrier(2, timeout=60.0)  # two threads meet there, or one alone never gets past it

        def work(rows: slice) -> None:
            seen.add(threading.get_ident())
            if spent > 1.0 and rows.start:
                waiting.wait()

        with monkeypatch.context() as patch:
            patch.setattr("trueup.cores.time", SimpleNamespace(perf_counter=lambda: next(clock)))
            in_threads(work, 9, 2, timed=True)
        return seen

    assert who(1e-6) == {threading.get_ident()}
    assert len(who(10.0)) == 3


def test_each_thread_has_twice_as_much_to_do_as_it_costs() -> None:
    assert [worth(spent, 1.0, 8) for spent in (0.1, 3.9, 4.0, 6.5, 100.0)] == [1, 1, 2, 3, 8]


def test_a_small_batch_that_is_stepped_one_by_one_waits_for_no_other_thread() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    batches = Batches(model, model, 4)
    assert batches.get(12, contacts=False, sensors=False, stepwise=True).nthread == 1
    assert batches.get(12, contacts=False, sensors=False).nthread == 4


def test_a_run_goes_on_while_the_work_of_another_is_done() -> None:
    went_on, order = threading.Event(), list[str]()

    def run(name: str, first: bool) -> Iterator[Work]:
        for k in range(2):
            order.append(f"{name}{k}")
            if not first:  # while the first one's work waits for it
                went_on.set()
            yield (lambda: order.append(str(went_on.wait(60.0)))) if first and not k else lambda: None

    in_turns([run("a", True), run("b", False)], 1)
    assert order[:2] == ["a0", "b0"]
    assert sorted(order) == ["True", "a0", "a1", "b0", "b1"]


def test_work_that_breaks_off_says_so_to_who_asked() -> None:
    def run(fails: bool) -> Iterator[Work]:
        yield lambda: None
        yield lambda: [0][1 if fails else 0]  # type: ignore[misc]

    for runs in ([True], [False, True]):
        with pytest.raises(IndexError):
            in_turns([run(fails) for fails in runs], 2)


def test_trials_with_controllers_are_parted_in_their_order() -> None:
    assert shares([False, False, True], 4) == [[0, 1, 2]]
    assert shares([False, False], 4) == [[0, 1]]
    assert shares([True] * 7, 4) == [[0, 4], [1, 5], [2, 6], [3]]
    assert shares([True, False, True, False], 2) == [[0, 1, 3], [2]]
    assert shares([True] * 3, 1) == [[0, 1, 2]]
