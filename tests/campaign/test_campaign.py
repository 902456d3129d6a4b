# SPDX-License-Identifier: Apache-2.0
"""A campaign makes a robot better, goes on where it was stopped, and does not harm what it is given."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Begun, Calibrated, Chosen, Ended, Event, Generation, Scored, TrialDone, TrialPlanned
from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import JOURNAL, Journal, read_journal, set_back
from trueup.campaign.parts import Listener, Parts, Silent
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.errors import JournalError, RobotFellError, TrialAbortedError, TrialError
from trueup.recording import Recording
from trueup.trial import Trial

Write = Callable[..., Path]


def run(
    plan: Path, out: Path, change: Callable[[Parts], Parts] | None = None, listener: Listener | None = None
) -> tuple[Event, ...]:
    """The events of a campaign run to its end."""
    folder = Folder.begin(read_plan(plan), out, None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        made = change(parts) if change else parts
        Campaign(folder.file.plan, folder.checksum, "0", made, journal, listener).run()
    return read_journal(folder.path)


def only(events: Sequence[Event], kind: type) -> list:
    return [e for e in events if isinstance(e, kind)]


class Around:
    """A robot around another, for trouble."""

    def __init__(
        self, robot: object, perform: Callable[[Trial, Callable], list[Recording]], repeatable: bool = True
    ) -> None:
        self._robot, self._perform, self.repeatable = robot, perform, repeatable

    def perform(self, trial: Trial) -> list[Recording]:
        return self._perform(trial, self._robot.perform)  # type: ignore[attr-defined]


def test_the_robot_gets_better_and_the_story_adds_up(write_plan: Write, tmp_path: Path) -> None:
    history = History.of(run(write_plan(), tmp_path / "out"))
    assert history.best[1] < 0.8 * history.first_score
    assert history.ended is not None
    assert [len(r.transferred) for r in history.rounds] == [3, 3]
    first = history.rounds[0].calibrated
    assert first is not None
    assert first.error_after < 0.5 * first.error_before
    for story in history.rounds:
        picked = story.chosen
        assert picked is not None
        assert picked.candidates[picked.incumbent] == story.begun.incumbent
    assert len(history.trials) == len({t.planned.trial for t in history.trials}) == 18
    again = history.rounds[-1].scored[-1]
    assert again.step == "confirm"  # the best of the last round is run once more before it is believed
    assert len([s for r in history.rounds for s in r.scored if s.unit == again.unit]) == 2


def test_nothing_is_handed_out_before_it_is_journaled(write_plan: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    seen: list[str] = []

    def perform(trial: Trial, go: Callable) -> list[Recording]:
        planned = [e.trial for e in read_journal(out) if isinstance(e, TrialPlanned)]
        assert trial.name in planned
        seen.append(trial.name)
        return go(trial)

    run(write_plan(), out, lambda p: replace(p, robot=Around(p.robot, perform)))
    assert seen == sorted(set(seen))


def test_stopped_after_any_event_it_goes_on_to_the_same_journal(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(('"ramps"', '"steps"'), ("rounds = 2", "rounds = 1"))
    whole = run(plan, tmp_path / "a")
    wanted = (tmp_path / "a" / JOURNAL).read_bytes()
    for count in range(1, len(whole), 3):
        out = tmp_path / "b"
        shutil.copytree(tmp_path / "a", out)
        set_back(out, count + 1)
        run(plan, out)
        assert (out / JOURNAL).read_bytes() == wanted
        shutil.rmtree(out)


@pytest.mark.parametrize("search", ["cma-es", "optuna", "genetic"])
def test_every_search_goes_on_with_the_same_candidates(write_plan: Write, tmp_path: Path, search: str) -> None:
    more = ", population = 8, generations = 3" if search == "genetic" else ""
    plan = write_plan(
        ('"toy:Nearby"', f'{{ type = "{search}"{more} }}\nevaluations = 24'), ("rounds = 2", "rounds = 1")
    )
    whole = run(plan, tmp_path / "a")
    middle = [k for k, e in enumerate(whole) if isinstance(e, Generation)]
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    set_back(tmp_path / "b", middle[len(middle) // 2] + 1)
    run(plan, tmp_path / "b")
    assert (tmp_path / "b" / JOURNAL).read_bytes() == (tmp_path / "a" / JOURNAL).read_bytes()


def test_a_finished_campaign_is_neither_overwritten_nor_run_again_and_another_one_gets_another_folder(
    write_plan: Write, tmp_path: Path
) -> None:
    plan = write_plan(("rounds = 2", "rounds = 1"))
    run(plan, tmp_path / "out")
    kept = (tmp_path / "out" / JOURNAL).read_bytes()
    again = Folder.begin(read_plan(plan), tmp_path / "out", None)
    assert (again.path, again.ended) == (tmp_path / "out", True)
    assert "has ended, so nothing is run" in again.note
    assert Folder.begin(read_plan(plan), tmp_path / "out", 99).path == tmp_path / "out-2", (
        "nothing has happened there yet"
    )
    assert (tmp_path / "out" / JOURNAL).read_bytes() == kept


def test_editing_the_plan_does_not_change_a_campaign_under_way(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan()
    begun = Folder.begin(read_plan(plan), tmp_path / "out", None)
    plan.write_text(plan.read_text().replace("rounds = 2", "rounds = 7"))
    opened = Folder.open(tmp_path / "out")
    assert opened.file.plan.stop.rounds == 2
    assert opened.checksum == begun.checksum
    parts = parts_of(begun.file, begun.path, lambda line: None)
    with Journal(begun.path) as journal:
        journal.once(Begun, lambda: Begun(begun.checksum, 3, "0"))
        Campaign(begun.file.plan, begun.checksum, "0", parts, journal)
    anew = Folder.begin(read_plan(plan), tmp_path / "out", None)
    assert anew.path == tmp_path / "out-2"
    for words in ("campaign.toml was edited", f"`trueup resume {tmp_path / 'out'}`", '["out/recordings/*.parquet"]'):
        assert words in anew.note


def test_an_edited_plan_that_has_ended_in_a_folder_of_its_own_is_not_run_again(
    write_plan: Write, tmp_path: Path
) -> None:
    begun = Folder.begin(read_plan(write_plan()), tmp_path / "out", None)
    with Journal(begun.path) as journal:  # of the plan as it was, which nobody went on with
        journal.once(Begun, lambda: Begun(begun.checksum, 3, "0"))
    plan = write_plan(("rounds = 2", "rounds = 1"), ('"ramps"', '"steps"'))
    run(plan, tmp_path / "out")
    again = Folder.begin(read_plan(plan), tmp_path / "out", None)
    assert (again.path, again.ended) == (tmp_path / "out-2", True)
    assert "was edited" not in again.note
    assert not (tmp_path / "out-3").exists()


def test_a_plan_that_could_not_be_run_leaves_its_folder_free(write_plan: Write, tmp_path: Path) -> None:
    limited = write_plan(("rounds = 2", "rounds = 2\n[limits.workspace]\nx = [-0.2, 0.2]"))
    with pytest.raises(TrialError, match="is not handed out: 'x'"):
        run(limited, tmp_path / "out")
    assert not read_journal(tmp_path / "out")
    mended = Folder.begin(read_plan(write_plan()), tmp_path / "out", None)
    assert (mended.path, mended.note) == (tmp_path / "out", "")
    assert "limits" not in Folder.open(tmp_path / "out").file.text


def test_a_journal_of_another_plan_is_refused(write_plan: Write, tmp_path: Path) -> None:
    folder = Folder.begin(read_plan(write_plan()), tmp_path / "out", None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        journal.once(Begun, lambda: Begun("another", 0, "0"))
    with Journal(folder.path) as journal, pytest.raises(JournalError, match="another plan"):
        Campaign(folder.file.plan, folder.checksum, "0", parts, journal)


def test_falls_and_aborted_runs_are_recorded_and_never_win(write_plan: Write, tmp_path: Path) -> None:
    def perform(trial: Trial, go: Callable) -> list[Recording]:
        if trial.name == "trial-007":
            raise RobotFellError("tipped over")
        if trial.name == "trial-010":
            raise TrialAbortedError("a dog")
        return go(trial)

    plan = write_plan(("candidates = 2", "candidates = 2\nagain = 0"))
    events = run(plan, tmp_path / "out", lambda p: replace(p, robot=Around(p.robot, perform)))
    done = {e.trial: e for e in only(events, TrialDone)}
    assert (done["trial-007"].outcome, done["trial-007"].note) == ("fell", "tipped over")
    assert (done["trial-010"].outcome, done["trial-010"].note) == ("aborted", "a dog")
    first = [s for s in only(events, Scored) if s.round == 1 and s.step == "transfer"]
    assert first[1].fell
    history = History.of(events)
    assert history.rounds[0].ended is not None
    assert history.rounds[0].ended.best == first[0].unit  # both new ones failed: what it had stays
    assert not history.rounds[0].ended.improved


def test_an_aborted_run_is_handed_out_again_as_a_new_trial(write_plan: Write, tmp_path: Path) -> None:
    def perform(trial: Trial, go: Callable) -> list[Recording]:
        if trial.name in ("trial-001", "trial-002", "trial-005"):
            raise TrialAbortedError("rain")
        return go(trial)

    plan = write_plan(("rounds = 2", "rounds = 1"))
    events = run(plan, tmp_path / "out", lambda p: replace(p, robot=Around(p.robot, perform)))
    planned = {e.trial: e for e in only(events, TrialPlanned)}
    assert planned["trial-005"].of == planned["trial-001"].of
    assert planned["trial-005"].settings == planned["trial-001"].settings
    first, second = [s for s in only(events, Scored) if s.step == "experiment"]
    assert first.scores[0] != first.scores[0]  # aborted twice: no score, and no third time
    assert second.scores[0] < 10.0
    assert len([e for e in planned.values() if e.step == "experiment"]) == 6


def test_the_trust_region_narrows_where_the_robot_does_not_follow(write_plan: Write, tmp_path: Path) -> None:
    """A robot that gets worse whatever is tried: the simulator's promises are not believed for long."""
    first: dict[str, float] = {}

    def perform(trial: Trial, go: Callable) -> list[Recording]:
        if not first:
            first.update(trial.settings)
        good = dict(trial.settings) == first
        (recording,) = go(replace(trial, settings=first))
        channel = recording.channel("position")
        return [recording if good else recording.with_channel(channel.replace(values=channel.values + 5.0))]

    plan = write_plan(("rounds = 2", "rounds = 5\npatience = 3"))
    history = History.of(run(plan, tmp_path / "out", lambda p: replace(p, robot=Around(p.robot, perform))))
    radii = [r.ended.radius for r in history.rounds if r.ended]
    assert radii == sorted(radii, reverse=True)
    assert radii[0] < 0.3
    assert history.ended is not None
    assert "no improvement" in history.ended.reason
    assert history.best[1] == pytest.approx(history.first_score)


def test_a_robot_is_told_which_of_the_tasks_trials_it_performs(write_plan: Write, tmp_path: Path) -> None:
    told: dict[str, str] = {}

    def perform(trial: Trial, go: Callable) -> list[Recording]:
        told[trial.name] = trial.performs
        return go(trial)

    plan = write_plan(("rounds = 2", "rounds = 1"))
    events = run(plan, tmp_path / "out", lambda p: replace(p, robot=Around(p.robot, perform)))
    assert told == {e.trial: e.of for e in only(events, TrialPlanned)}
    assert len(set(told.values())) == 2


def test_it_ends_when_the_robot_is_good_enough(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("rounds = 2", "rounds = 9\nsuccess = 10.0"))
    (ended,) = only(run(plan, tmp_path / "out"), Ended)
    assert ended.success
    assert "round 1" in ended.reason


def test_a_task_that_is_done_or_not_ends_the_campaign_when_the_robot_does_it(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("toy:Follow", "toy:Arrive"), (', "ramps"', ""), ("rounds = 2", "rounds = 9"))
    events = run(plan, tmp_path / "out")
    shares = [(s.step, s.done) for s in only(events, Scored)]
    assert shares[0] == ("experiment", 0.0)  # nobody is near the target with the gains at first
    assert shares[-1] == ("confirm", 1.0)
    history = History.of(events)
    assert history.ended is not None
    assert history.ended.success
    assert "(done)" in history.ended.reason
    assert history.done_by_best.startswith("did it in 2 of 2 runs")


def test_one_lucky_run_is_no_success(write_plan: Write, tmp_path: Path) -> None:
    lucky: list[str] = []

    def perform(trial: Trial, go: Callable) -> list[Recording]:
        (recording,) = go(trial)
        if trial.name != "trial-003":
            return [recording]
        lucky.append(trial.name)
        target = trial.references["target"].values[:, 1:]
        return [recording.with_channel(recording.channel("position").replace(values=target))]

    plan = write_plan(("settings = 2", "settings = 1"), (', "ramps"', ""), ("rounds = 2", "rounds = 2\nsuccess = 0.1"))
    history = History.of(run(plan, tmp_path / "out", lambda p: replace(p, robot=Around(p.robot, perform))))
    assert lucky
    assert len(history.rounds) == 2
    assert history.rounds[0].scored[-1].step == "confirm"
    assert history.ended is not None
    assert not history.ended.success


def test_it_never_runs_the_robot_more_often_than_allowed(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("rounds = 2", "rounds = 9\ntrials = 13\npatience = 9"))
    events = run(plan, tmp_path / "out")
    assert len(only(events, TrialPlanned)) <= 13
    assert "budget" in only(events, Ended)[0].reason


class Operator(Silent):
    """Says what became of interrupted trials, and counts what it was asked."""

    def __init__(self, answer: Literal["repeat", "unknown"]) -> None:
        self.answer: Literal["repeat", "unknown"] = answer
        self.asked: list[str] = []
        self.confirmed = 0

    def unknown(self, trial: Trial) -> Literal["repeat", "unknown"]:
        self.asked.append(trial.name)
        return self.answer

    def confirm(self, trials: Sequence[Trial], expected: Sequence[str]) -> None:
        self.confirmed += len(trials)


@pytest.mark.parametrize("answer", ["repeat", "unknown"])
def test_a_driver_s_interrupted_trial_is_repeated_only_if_somebody_says_so(
    write_plan: Write, tmp_path: Path, answer: Literal["repeat", "unknown"]
) -> None:
    performed: list[str] = []

    def perform(trial: Trial, go: Callable) -> list[Recording]:
        performed.append(trial.name)
        if performed == ["trial-001", "trial-002"]:
            raise KeyboardInterrupt  # the robot moves on; nobody knows how far
        return go(trial)

    def wrapped(parts: Parts) -> Parts:
        return replace(parts, robot=Around(parts.robot, perform, repeatable=False))

    plan, operator = write_plan(("rounds = 2", "rounds = 1")), Operator(answer)
    with pytest.raises(KeyboardInterrupt):
        run(plan, tmp_path / "out", wrapped, operator)
    assert operator.asked == []
    done = {e.trial: e for e in only(run(plan, tmp_path / "out", wrapped, operator), TrialDone)}
    assert operator.asked == ["trial-002"]
    assert performed.count("trial-002") == (2 if answer == "repeat" else 1)
    assert done["trial-002"].outcome == ("done" if answer == "repeat" else "unknown")
    assert operator.confirmed >= len(done)


def test_limits_are_checked_before_anything_is_handed_out(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("rounds = 2", "rounds = 2\n[limits.workspace]\nx = [-0.2, 0.2]"))
    with pytest.raises(TrialError, match=r"trial 'steps'.*'x' of reference 'target' reaches 1 m .allowed: -0.2 to 0.2"):
        run(plan, tmp_path / "out")
    assert not only(read_journal(tmp_path / "out"), TrialPlanned)


def test_candidates_that_would_leave_the_workspace_in_simulation_are_passed_over(
    write_plan: Write, tmp_path: Path
) -> None:
    plan = write_plan(("rounds = 2", "rounds = 1\n[limits.joints.x]\nspeed = 6.0"))
    events = run(plan, tmp_path / "out")
    assert only(events, Chosen)[0].unsafe > 0
    limited = [max(abs(e.settings["proportional"]) for e in only(events, TrialPlanned))]
    free = [max(abs(e.settings["proportional"]) for e in only(run(write_plan(), tmp_path / "free"), TrialPlanned))]
    assert limited < free


def test_without_calibration_the_simulator_is_as_unsure_as_its_ranges(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(('"toy:regression"', '"none"'), ("rounds = 2", "rounds = 1"))
    events = run(plan, tmp_path / "out")
    assert not only(events, Calibrated)
    calibrated = run(write_plan(("rounds = 2", "rounds = 1")), tmp_path / "with")
    assert only(events, Chosen)[0].spreads[1] > 3 * only(calibrated, Chosen)[0].spreads[1]


def test_scores_of_the_robot_correct_what_is_foretold_and_a_stopped_campaign_foretells_the_same(
    write_plan: Write, tmp_path: Path
) -> None:
    def wrong(events: Sequence[Event]) -> float:
        last, round_ = only(events, Chosen)[-1], max(e.round for e in only(events, Scored))
        shown = next(e for e in only(events, Scored) if e.round == round_ and e.step == "transfer")
        return abs(last.predicted[last.incumbent] - shown.scores[0])

    plain = run(write_plan(('"toy:regression"', '"none"')), tmp_path / "plain")
    plan = write_plan(('"toy:regression"', '"none"'), ("samples = 4", "samples = 4\ncorrect = true"))
    told = run(plan, tmp_path / "told")
    assert wrong(told) < 0.5 * wrong(plain)  # of the incumbent, which the robot ran before
    middle = [k for k, e in enumerate(told) if isinstance(e, Generation)]
    shutil.copytree(tmp_path / "told", tmp_path / "again")
    set_back(tmp_path / "again", middle[-2] + 1)
    run(plan, tmp_path / "again")
    assert (tmp_path / "again" / JOURNAL).read_bytes() == (tmp_path / "told" / JOURNAL).read_bytes()


def test_a_damaged_journal_is_not_begun_anew_elsewhere(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("rounds = 2", "rounds = 1"))
    run(plan, tmp_path / "out")
    journal = tmp_path / "out" / JOURNAL
    journal.write_bytes(journal.read_bytes().replace(b'"round":1', b'"round":2', 1))
    with pytest.raises(JournalError, match=r"line \d+: altered.*--from-line"):
        Folder.begin(read_plan(plan), tmp_path / "out", None)
