# SPDX-License-Identifier: Apache-2.0
"""What does not fit together is said before the robot moves, and a robot that fails loses nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup.campaign.campaign import Campaign
from trueup.campaign.events import TrialDone, TrialPlanned, TrialStarted
from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.parts import Parts, Silent
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.ends import Ended, Fallen
from trueup.errors import PlanError, RobotFellError, TrialError
from trueup.recording import Recording
from trueup.trial import Reference, Trial

Write = Callable[..., Path]


class Doubtful(Silent):
    def __init__(self) -> None:
        self.doubts: list[str] = []

    def doubt(self, words: str) -> None:
        self.doubts.append(words)


class Wrapped:
    """A part with some of its methods replaced."""

    def __init__(self, whole: object, **methods: Any) -> None:
        self._whole = whole
        for name, method in methods.items():
            setattr(self, name, method)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)


def go(plan: Path, out: Path, change: Callable[[Parts], Parts], listener: Silent | None = None) -> None:
    folder = Folder.begin(read_plan(plan), out, None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        Campaign(folder.file.plan, folder.checksum, "0", change(parts), journal, listener).run()


def missing(rollouts: Sequence[object]) -> float:
    return {}["reward"]


@pytest.mark.parametrize(
    ("score", "words"),
    [
        (lambda rollouts: 1.0, "`score` gave shape ()"),
        (lambda rollouts: np.ones((2, 101)), "it must be (b,)"),
        (missing, "KeyError: 'reward' (test_rehearsal.py, line "),
    ],
    ids=["a number", "a table", "a mistake"],
)
def test_a_task_that_cannot_be_scored_is_named_before_the_robot_moves(
    write_plan: Write, tmp_path: Path, score: Callable, words: str
) -> None:
    with pytest.raises(PlanError) as error:
        go(write_plan(), tmp_path / "out", lambda p: replace(p, task=Wrapped(p.task, score=score)))
    assert words in str(error.value)
    assert not [e for e in read_journal(tmp_path / "out") if isinstance(e, TrialPlanned)]


def test_a_task_without_a_score_today_is_doubted_and_nothing_else(write_plan: Write, tmp_path: Path) -> None:
    heard = Doubtful()
    plan = write_plan(("rounds = 2", "rounds = 1"))
    go(plan, tmp_path / "a", lambda p: p, heard)
    assert heard.doubts == [""]

    def once(task: Any) -> Callable:
        calls: list[int] = []

        def score(rollouts: Sequence[Any]) -> Any:
            calls.append(1)
            return np.full(2, np.nan) if len(calls) == 1 else task.score(rollouts)

        return score

    go(plan, tmp_path / "b", lambda p: replace(p, task=Wrapped(p.task, score=once(p.task))), heard)
    assert "has no score" in heard.doubts[1]


@pytest.mark.parametrize(("falling", "said"), [(2, True), (1, False)])
def test_todays_settings_that_fall_in_simulation_are_doubted_before_the_robot_has_them(
    write_plan: Write, tmp_path: Path, falling: int, said: bool
) -> None:
    heard = Doubtful()

    def fallible(parts: Parts) -> Parts:
        fallen = Fallen(height=0.2)
        trials = tuple(replace(t, ends=(fallen,)) for t in parts.task.trials)

        def rollout(trials: Sequence[Trial], values: Any, controllers: Any = None) -> list[Any]:
            done = parts.simulator.rollout(trials, values, controllers)
            return [replace(r, ends={k: Ended(1.5, fallen.name) for k in range(falling)}) for r in done[:1]] + done[1:]

        task = Wrapped(parts.task, trials=trials)
        return replace(parts, task=task, simulator=Wrapped(parts.simulator, rollout=rollout))

    go(write_plan(("rounds = 2", "rounds = 1")), tmp_path / "a", fallible, heard)
    assert ("2 of 4 runs end in a fall, the first after 1.5 s" in heard.doubts[0]) == said
    unheard = Doubtful()
    searched_first = write_plan(("rounds = 2", "rounds = 1"), ("settings = 2", "settings = 0"))
    go(searched_first, tmp_path / "b", fallible, unheard)
    assert unheard.doubts[0] == ""


def test_a_limit_of_nothing_that_moves_is_refused(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("[stop]", "[limits.workspace]\nxx = [-2.0, 2.0]\n[stop]"))
    with pytest.raises(PlanError, match="'xx' is not in what the trials command"):
        go(plan, tmp_path / "out", lambda p: p)


@pytest.mark.parametrize("failing", ["raises", "lacks a channel"])
def test_a_robot_that_fails_is_named_and_its_trial_is_not_lost(write_plan: Write, tmp_path: Path, failing: str) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"

    def broken(robot: Any) -> Callable:
        def perform(trial: Trial) -> list[Recording]:
            done = robot.perform(trial)
            if trial.name == "trial-003" and failing == "raises":
                raise RuntimeError("no heartbeat from motor 3")
            if trial.name == "trial-003":
                return [Recording(r.name, {"command": r.channel("command")}) for r in done]
            return done

        return perform

    with pytest.raises(TrialError) as error:
        go(plan, out, lambda p: replace(p, robot=Wrapped(p.robot, perform=broken(p.robot))))
    said = str(error.value)
    assert "trial-003" in said
    assert "`trueup resume` goes on from here" in said
    wanted = "RuntimeError: no heartbeat from motor 3" if failing == "raises" else "lacks x of channel 'position'"
    assert wanted in said
    assert isinstance(read_journal(out)[-1], TrialStarted)
    go(plan, out, lambda p: p)  # mended
    done = [e.trial for e in read_journal(out) if isinstance(e, TrialDone)]
    assert done == sorted(set(done))
    assert "trial-003" in done


@pytest.mark.parametrize(
    ("changed", "returned"),
    [
        (lambda done: None, "None"),
        (lambda done: [None], "a list of 1 (None)"),
        (lambda done: [], "a list of 0"),
        (lambda done: [done[0], done[0]], "a list of 2 (Recording)"),
        (lambda done: {"position": done[0]}, "a dict with the keys 'position'"),
        (lambda done: "done", "a str of 4"),
    ],
    ids=["nothing", "a list of nothing", "an empty list", "two for one", "a dict", "a word"],
)
def test_what_a_driver_returns_wrongly_is_shown_with_what_is_wanted(
    write_plan: Write, tmp_path: Path, changed: Callable, returned: str
) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"

    def driver(robot: Any) -> Callable:
        return lambda trial: changed(robot.perform(trial)) if trial.name == "trial-002" else robot.perform(trial)

    with pytest.raises(TrialError) as error:
        go(plan, out, lambda p: replace(p, robot=Wrapped(p.robot, perform=driver(p.robot))))
    assert f"trial-002: Wrapped.perform(trial) returned {returned}, where a list of one Recording" in str(error.value)
    assert "`def perform(self, trial: Trial) -> list[Recording]`" in str(error.value)
    go(plan, out, lambda p: p)  # mended
    assert "trial-002" in [e.trial for e in read_journal(out) if isinstance(e, TrialDone)]


def test_a_driver_may_return_the_one_recording_of_a_trial_by_itself(write_plan: Write, tmp_path: Path) -> None:
    plan, outs = write_plan(("rounds = 2", "rounds = 1")), (tmp_path / "listed", tmp_path / "bare")
    go(plan, outs[0], lambda p: p)
    go(plan, outs[1], lambda p: replace(p, robot=Wrapped(p.robot, perform=lambda t: p.robot.perform(t)[0])))
    assert read_journal(outs[0]) == read_journal(outs[1])


def test_a_run_in_which_the_robot_stood_on_its_path_is_not_taken(write_plan: Write, tmp_path: Path) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"
    path = Reference(("x", "y"), ("m", "m"), np.stack([np.linspace(0.0, 3.0, 50), np.zeros(50)], axis=1))

    def led(parts: Parts) -> Parts:
        trials = tuple(replace(t, references={**t.references, "path": path}) for t in parts.task.trials)
        return replace(parts, task=Wrapped(parts.task, trials=trials))

    def unpowered(parts: Parts) -> Parts:
        def perform(trial: Trial) -> list[Recording]:
            (done,) = parts.robot.perform(trial)
            x = done.channel("position")
            return [done.with_channel(x.replace(labels=("x", "y"), values=np.zeros((len(x.time), 2))))]

        return replace(led(parts), robot=Wrapped(parts.robot, perform=perform))

    with pytest.raises(
        TrialError, match=r"trial-001: the robot stood all along: its position stays within 0 m, .* 3 m"
    ):
        go(plan, out, unpowered)
    assert isinstance(read_journal(out)[-1], TrialStarted)  # it has no outcome and no score
    go(plan, out, led)
    assert "trial-001" in [e.trial for e in read_journal(out) if isinstance(e, TrialDone)]


def test_what_a_robot_did_not_measure_is_said(write_plan: Write, tmp_path: Path) -> None:
    def blind(robot: Any) -> Callable:
        def perform(trial: Trial) -> list[Recording]:
            (done,) = robot.perform(trial)
            position = done.channel("position")
            unseen = (position.time >= 1.0) & (position.time < 2.0) & (trial.name == "trial-002")
            return [done.with_channel(position.replace(values=np.where(unseen[:, None], np.nan, position.values)))]

        return perform

    heard = Doubtful()
    plan = write_plan(('"toy:regression"', '"none"'), ("rounds = 2", "rounds = 1"))
    go(plan, tmp_path / "out", lambda p: replace(p, robot=Wrapped(p.robot, perform=blind(p.robot))), heard)
    (said,) = [words for words in heard.doubts if "no values" in words]
    assert said.startswith("trial-002: in its recording 'position' has no values from ")


def test_what_a_task_doubts_of_a_run_is_said_with_the_trial(write_plan: Write, tmp_path: Path) -> None:
    heard, plan = Doubtful(), write_plan(("rounds = 2", "rounds = 1"))

    def doubting(parts: Parts) -> Parts:
        return replace(parts, task=Wrapped(parts.task, doubts=lambda rollouts: [("ended early",) for _ in rollouts]))

    go(plan, tmp_path / "out", doubting, heard)
    said = [words for words in heard.doubts if "ended early" in words]
    done = [e.trial for e in read_journal(tmp_path / "out") if isinstance(e, TrialDone)]
    assert said == [f"{trial}: ended early" for trial in done]


def test_settings_that_fall_are_not_the_best_however_good_they_were_once(write_plan: Write, tmp_path: Path) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"
    best: list[dict[str, float]] = []

    def perform(robot: Any) -> Callable:
        def down(trial: Trial) -> list[Recording]:
            history = History.of(read_journal(out))
            if trial.name == "trial-011":  # the first run of the confirmation
                best.append(dict(history.best[0]))
            if best and dict(trial.settings) == best[0]:
                raise RobotFellError("on its side")
            return robot.perform(trial)

        return down

    go(plan, out, lambda p: replace(p, robot=Wrapped(p.robot, perform=perform(p.robot))))
    history = History.of(read_journal(out))
    assert best
    assert dict(history.best[0]) != best[0]
    fallen = [s for r in history.rounds for s in r.scored if s.fell]
    assert len(fallen) == 1  # it is not asked to fall again
