# SPDX-License-Identifier: Apache-2.0
"""The loop in rounds on a stand-in: the campaign of `trueup new --from stanley`, as a user has it."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Event, RoundEnded
from trueup.campaign.history import History
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.parts import Silent
from trueup.campaign.plan import Plan, PlanFile, read_plan, templates
from trueup.campaign.resolve import parts_of
from trueup.robots.robot import Robot
from trueup.typed_toml import Component


def in_rounds(
    robot: Robot, *, paths: Sequence[str] = ("hairpin",), seed: int = 0, rounds: int | None = None,
    evaluations: int | None = None, candidates: int | None = None, samples: int | None = None,
    wheelbase: float | None = None, correct: bool | None = None, within: float | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> History:  # fmt: skip
    """The shipped plan on `robot`, from its first drive to the end; its own numbers where nothing else is asked for.

    `wheelbase` in m is the declared one. `say` is given one line a round. Nothing is left on the disk.
    """
    file = read_plan(templates()["stanley"] / "campaign.toml")
    plan = _asked(file.plan, paths, seed, wheelbase)
    plan = dataclasses.replace(
        plan,
        optimize=_with(plan.optimize, evaluations=evaluations, samples=samples, correct=correct, within=within),
        transfer=_with(plan.transfer, candidates=candidates), stop=_with(plan.stop, rounds=rounds),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        parts = parts_of(PlanFile(plan, file.path, file.text), Path(folder), say)
        with Journal(Path(folder)) as journal:
            Campaign(plan, "", "", dataclasses.replace(parts, robot=robot), journal, _Told(say)).run()
        return History.of(read_journal(Path(folder)))


def _asked(plan: Plan, paths: Sequence[str], seed: int, wheelbase: float | None) -> Plan:
    """The plan with these courses, a stand-in that the caller's robot replaces, and a declared wheelbase."""
    vehicle = {} if wheelbase is None else {"wheelbase": wheelbase}
    return dataclasses.replace(
        plan, seed=seed, robot=Component("stand-in-vehicle", {}, plan.robot.where),
        task=dataclasses.replace(plan.task, options={**plan.task.options, "paths": list(paths)}),
        simulator=dataclasses.replace(plan.simulator, options={**plan.simulator.options, **vehicle}),
    )  # fmt: skip


def _with(table: Any, **asked: float | None) -> Any:
    return dataclasses.replace(table, **{k: v for k, v in asked.items() if v is not None})


class _Told(Silent):
    """Says what the robot's score has become, round by round."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def saw(self, event: Event, *, fresh: bool) -> None:
        """One line at the end of a round."""
        if isinstance(event, RoundEnded):
            best = f"{1e3 * event.score:.1f} mm from its path"
            self._say(f"round {event.round}: the robot's best is {best}, as it measures itself")
