# SPDX-License-Identifier: Apache-2.0
"""A campaign goes on with the model and the task that it began with, or says that they are others."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup.campaign.beginning import begun_with
from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Begun
from trueup.campaign.folder import Folder
from trueup.campaign.journal import JOURNAL, Journal, read_journal
from trueup.campaign.parts import Parts, Silent
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.errors import JournalError
from trueup.formats import read
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Trial

Write = Callable[..., Path]


class Other:
    """A part with some of its attributes replaced."""

    def __init__(self, whole: object, **replaced: Any) -> None:
        self._whole = whole
        vars(self).update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)


class Doubtful(Silent):
    def __init__(self) -> None:
        self.doubts: list[str] = []

    def doubt(self, words: str) -> None:
        self.doubts.append(words)


def go(
    plan: Path, out: Path, change: Callable[[Parts], Parts], version: str = "0", listener: Silent | None = None
) -> None:
    folder = Folder.begin(read_plan(plan), out, None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        Campaign(folder.file.plan, folder.checksum, version, change(parts), journal, listener).run()


def stopped(parts: Parts) -> Parts:
    """A robot that performs two trials and no more."""

    def perform(trial: Trial) -> list[Recording]:
        if trial.name > "trial-002":
            raise KeyboardInterrupt
        return parts.robot.perform(trial)

    return replace(parts, robot=Other(parts.robot, perform=perform))  # type: ignore[arg-type]


def in_mm(parts: Parts) -> Parts:
    def score(rollouts: Sequence[Any]) -> Any:
        return 1e3 * parts.task.score(rollouts)

    return replace(parts, task=Other(parts.task, score=score))  # type: ignore[arg-type]


def another_range(parts: Parts) -> Parts:
    first, *others = parts.task.parameters.parameters
    space = ParameterSpace((first.replace(upper=2.0 * first.upper), *others))
    return replace(parts, task=Other(parts.task, parameters=space))  # type: ignore[arg-type]


def another_model(parts: Parts) -> Parts:
    def rollout(trials: Sequence[Trial], values: Any, controllers: Any = None) -> Any:
        return parts.simulator.rollout(trials, values * np.where(np.arange(values.shape[1]), 1.0, 1.1), controllers)

    return replace(parts, simulator=Other(parts.simulator, rollout=rollout))  # type: ignore[arg-type]


@pytest.mark.parametrize("edit", [in_mm, another_range, another_model])
def test_an_edited_model_or_task_is_not_mixed_with_what_the_journal_holds(
    write_plan: Write, tmp_path: Path, edit: Callable[[Parts], Parts]
) -> None:
    plan, out = write_plan(), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        go(plan, out, stopped)
    known = (out / JOURNAL).read_bytes()
    (tmp_path / "task.py").write_text("")
    with pytest.raises(
        JournalError, match=r"was edited \(changed since then: .*task\.py\).*out/recordings/\*\.parquet"
    ):
        go(plan, out, edit)
    assert (out / JOURNAL).read_bytes() == known
    go(plan, out, lambda parts: parts)  # put back as it was, it goes on


def test_another_version_of_trueup_may_simulate_otherwise_and_says_so(write_plan: Write, tmp_path: Path) -> None:
    plan, heard = write_plan(), Doubtful()
    with pytest.raises(KeyboardInterrupt):
        go(plan, tmp_path / "out", stopped)
    go(plan, tmp_path / "out", another_model, version="1", listener=heard)
    assert any("trueup 0 began it, this is 1" in words for words in heard.doubts)


def test_another_machine_may_simulate_otherwise_and_says_so(write_plan: Write, tmp_path: Path) -> None:
    plan, heard = write_plan(), Doubtful()
    with pytest.raises(KeyboardInterrupt):
        go(plan, tmp_path / "out", stopped)
    go(plan, tmp_path / "out", another_model, listener=heard)
    assert any("no file beside the plan was changed" in words for words in heard.doubts)


def test_a_task_that_draws_lots_of_its_own_can_be_resumed(write_plan: Write, tmp_path: Path) -> None:
    lots = np.random.default_rng(0)

    def by_chance(parts: Parts) -> Parts:
        def score(rollouts: Sequence[Any]) -> Any:
            return parts.task.score(rollouts) * lots.uniform(0.9, 1.1)

        return replace(parts, task=Other(parts.task, score=score))  # type: ignore[arg-type]

    with pytest.raises(KeyboardInterrupt):
        go(write_plan(), tmp_path / "out", lambda parts: stopped(by_chance(parts)))
    go(tmp_path / "campaign.toml", tmp_path / "out", by_chance)


def test_a_journal_of_before_has_no_samples_and_goes_on(write_plan: Write, tmp_path: Path) -> None:
    plan, out = write_plan(), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        go(plan, out, stopped)
    lines = []
    for line in (out / JOURNAL).read_text().splitlines():
        plain = json.loads(line)
        plain.pop("samples", None)
        plain.pop("check")  # as before there were check sums
        lines.append(json.dumps(plain, separators=(",", ":")))
    (out / JOURNAL).write_text("".join(line + "\n" for line in lines))
    go(plan, out, lambda parts: parts)
    assert type(read_journal(out)[-1]).__name__ == "Ended"


def logs(folder: Path, *names: str) -> list[Recording]:
    for name in names:
        rows = [f"{k / 100},{len(name) * k},{k % 7}" for k in range(50)]
        (folder / f"{name}.csv").write_text("\n".join(["time,hip_cmd,hip_pos", *rows]) + "\n")
    return read([folder / f"{name}.csv" for name in names])


def test_a_campaign_goes_on_with_the_recordings_that_it_began_with(write_plan: Write, tmp_path: Path) -> None:
    logs(tmp_path, "a", "bb")
    plan, said = write_plan(("[experiment]", 'recordings = ["*.csv"]\n[experiment]')), list[str]()
    folder = Folder.begin(read_plan(plan), tmp_path / "out", None)
    with Journal(folder.path) as journal, pytest.raises(KeyboardInterrupt):
        Campaign(
            folder.file.plan, folder.checksum, "0", stopped(parts_of(folder.file, folder.path, said.append)), journal
        ).run()
    logs(tmp_path, "ccc")
    with Journal(folder.path) as journal:
        parts = parts_of(folder.file, folder.path, said.append, past=journal.past)
        assert [r.name for r in parts.recordings] == ["a", "bb"]
        assert any("not used in it: ccc" in line for line in said)
        (tmp_path / "bb.csv").unlink()
        with pytest.raises(JournalError, match=r"bb \(gone\)"):
            parts_of(folder.file, folder.path, said.append, past=journal.past)


def test_recordings_that_only_have_another_name_are_the_same_and_edited_ones_are_not(tmp_path: Path) -> None:
    a, bb = logs(tmp_path, "a", "bb")
    past = [Begun("", 0, "0", recordings={r.name: r.provenance[f"sha256 of {r.name}.csv"] for r in (a, bb)})]
    renamed = a.replace(name="day_1_a")
    assert begun_with([renamed, bb], past, print) == [renamed, bb]
    (tmp_path / "bb.csv").write_text((tmp_path / "bb.csv").read_text().replace("0.01,", "0.011,"))
    with pytest.raises(JournalError, match=r"bb \(edited\)"):
        begun_with([a, *read([tmp_path / "bb.csv"])], past, print)
    assert begun_with([bb], [], print) == [bb]
