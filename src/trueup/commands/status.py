# SPDX-License-Identifier: Apache-2.0
"""`trueup status`: how a campaign stands, without touching it."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.campaign.edges import at_edges
from trueup.campaign.folder import Folder
from trueup.campaign.history import History, RoundStory
from trueup.campaign.plan import Plan
from trueup.commands.console import tell
from trueup.commands.sources import add_shared
from trueup.formats.plain import finite

ABOUT = """\
Shows how the campaign in DIR stands: rounds, the best on the robot so far, and what it waits for. It only reads, so it
may be asked while the campaign runs.

  trueup status DIR
  trueup status DIR --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    add_shared(parser, "folder", "json")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Shows the state. Raises JournalError where there is no campaign. Returns the exit code."""
    folder = Folder.open(Path(args.folder))
    history = History.of(folder.events())
    if args.json:
        console.print_json(as_json(history))
    else:
        show_status(history, folder.file.plan, console)
    return 0


def show_status(history: History, plan: Plan, console: Console) -> None:
    """A table of the rounds, then the best so far, what is waited for, or why it ended."""
    table = Table(title=escape(plan.name), title_justify="left", box=None, pad_edge=False)
    for name in ("round", "runs", "replay error", "simulated", "on the robot", "same ranks"):
        table.add_column(name, justify="left" if name == "round" else "right", no_wrap=True)
    for story in history.rounds:
        table.add_row(*_row(story, history))
    console.print(table)
    settings, score = history.best
    if settings:
        first = history.first_score
        change = history.change(score) if score < first else math.nan
        share = f", {100 * abs(change):.1f} % {'more' if change > 0.0 else 'less'}" if math.isfinite(change) else ""
        before = f" (at first {history.score(first)}{share})" if math.isfinite(first) else ""
        what = f"best {history.counts} on the robot" if history.counts else "best on the robot"
        tell(console, f"{what}: {history.score(score)}{before}")
        shown = ", ".join(f"{k} = {history.setting(k, v)}" for k, v in settings.items())
        tell(console, f"  {escape(shown)}")
        if words := at_edges(history):
            tell(console, f"  note: {escape(words)}")
        for words in filter(None, (history.done_by_best, history.falls_of_best)):
            tell(console, f"  the robot {words}")
    if history.ended is not None:
        tell(console, escape(history.ended.reason))
    elif history.begun is None:
        tell(console, "not begun: nothing was asked of the robot. A plan that was mended: trueup run PLAN")
    elif history.waiting:
        names = ", ".join(t.planned.trial for t in history.waiting)
        tell(console, f"waits for {names} ({history.phase} of round {len(history.rounds)})")
    else:
        tell(console, f"stopped or busy: {history.phase} of round {len(history.rounds)}")


def as_json(history: History) -> str:
    """Where it stands, as JSON: SI units, null where there is no number."""
    settings, score = history.best
    plain: dict[str, Any] = {
        "phase": history.phase,
        "ended": None if history.ended is None else asdict(history.ended),
        "first_score": history.first_score,
        "best_score": score,
        "score_is_minus": history.counts or None,
        "best_settings": dict(settings),
        "waiting": [t.planned.trial for t in history.waiting],
        "runs": len([t for t in history.trials if t.done is not None]),
        "rounds": [_plain(r) for r in history.rounds],
    }
    return json.dumps(finite(plain), allow_nan=False)


def _plain(story: RoundStory) -> dict[str, Any]:
    done = story.calibrated
    return {
        "round": story.begun.round,
        "parameters": dict(zip(done.names, done.values, strict=True)) if done else {},
        "replay_error": done.error_after if done else math.nan,
        "simulated": story.tried,
        "predicted": list(story.chosen.predicted) if story.chosen else [],
        "measured": list(story.validated.measured) if story.validated else [],
        "rank_agreement": None if story.validated is None else [story.validated.tau, story.validated.low,
                                                                  story.validated.high],
        "best": story.ended.score if story.ended else math.nan,
    }  # fmt: skip


def _row(story: RoundStory, history: History) -> tuple[str, ...]:
    done, rank = story.calibrated, story.validated
    return (
        str(story.begun.round),
        str(sum(t.done is not None for t in story.trials)),
        f"{done.error_before:.3g} -> {done.error_after:.3g} {escape(done.unit)}" if done else "",
        f"{history.shown(story.best_simulated):.4g}" if story.tried else "",
        f"{history.shown(story.ended.score):.4g}" if story.ended else "",
        f"{rank.tau:.2f} [{rank.low:.2f}, {rank.high:.2f}]" if rank and math.isfinite(rank.tau) else "",
    )
