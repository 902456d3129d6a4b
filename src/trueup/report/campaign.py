# SPDX-License-Identifier: Apache-2.0
"""The report of a campaign: its story by rounds, as one HTML file that asks nothing of the network."""

from __future__ import annotations

from pathlib import Path

from trueup.campaign.history import History
from trueup.campaign.journal import read_journal, read_times
from trueup.campaign.plan import Plan
from trueup.errors import counted
from trueup.formats.aside import write_aside
from trueup.report.campaign_sections import campaign_sections
from trueup.report.campaign_tracks import Track, tracks_of
from trueup.report.parts import page

PLAN_TEXT = "plan.toml"


def write_campaign_report(folder: Path, plan: Plan, path: Path | None = None) -> Path:
    """Writes the report of the campaign in `folder`, to folder/report.html unless `path` says otherwise; returns where.

    It may be written at any time. Raises JournalError where there is no journal, OutputError.
    """
    events = read_journal(folder)
    history = History.of(events)
    times = read_times(folder)
    text = campaign_html(
        history, plan, times=times, plan_text=_text(folder / PLAN_TEXT), tracks=tracks_of(history, folder)
    )
    where = path or folder / "report.html"
    write_aside(text, where)
    return where


def campaign_html(
    history: History, plan: Plan, *, times: dict[int, float], plan_text: str = "", tracks: tuple[Track, ...] = ()
) -> str:
    """The report as the text of an HTML document; `times` are when events were written, in s since the epoch."""
    answered = campaign_sections(history, plan, times, plan_text, tracks)
    return page("campaign.html", plan.name, _subtitle(history), answered)


def _subtitle(history: History) -> list[str]:
    runs = sum(t.planned.repeats for t in history.trials if t.done is not None)
    simulated = sum(r.tried for r in history.rounds)
    state = history.ended.reason if history.ended is not None else f"under way: {history.phase}"
    return [counted(len(history.rounds), "round"), counted(runs, "run") + " on the robot",
            counted(simulated, "candidate") + " simulated", state]  # fmt: skip


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
