# SPDX-License-Identifier: Apache-2.0
"""A campaign's story can be told at any moment, in any language, whatever happened in it."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Begun, Event, Scored, TrialDone, Validated
from trueup.campaign.folder import Folder
from trueup.campaign.history import History, astray
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.plan import Plan, read_plan
from trueup.campaign.resolve import parts_of
from trueup.commands.campaign_view import CampaignView
from trueup.commands.status import as_json, show_status
from trueup.recording import Channel, Recording
from trueup.report.campaign import campaign_html, write_campaign_report
from trueup.report.campaign_tracks import Track, track_figure, tracks_of

Write = Callable[..., Path]


class Balanced(HTMLParser):
    """Raises where elements are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "wbr", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An SVG element that closes itself."""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture
def told(write_plan: Write, tmp_path: Path) -> tuple[tuple[Event, ...], Plan, Path]:
    """A whole campaign's events, its plan and folder; the robot has a <strange> name for its trials."""
    folder = Folder.begin(read_plan(write_plan()), tmp_path / "out", None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        Campaign(folder.file.plan, folder.checksum, "0", parts, journal).run()
    return read_journal(folder.path), folder.file.plan, folder.path


def test_after_every_single_event_the_story_can_be_told(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, folder = told
    out = io.StringIO()
    view = CampaignView(Console(file=out, width=200), plan, folder)
    for count, event in enumerate(events, 1):
        view.saw(event, fresh=True)
        history = History.of(events[:count])
        show_status(history, plan, Console(file=io.StringIO()))
        assert json.loads(as_json(history))["phase"] in (
            "starting", "experiment", "calibrate", "optimize", "transfer", "confirm", "ended",
        )  # fmt: skip
        page = Balanced()
        page.feed(campaign_html(history, plan, times={}))
        assert page.open == []
    assert "all rounds of the plan are done" in out.getvalue()


def test_the_report_of_the_whole_shows_what_the_robot_did(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, folder = told
    text = write_campaign_report(folder, plan).read_text("utf-8")
    history = History.of(events)
    assert f"{100 * (1 - history.best[1] / history.first_score):.1f} % less" in text
    assert "with the first settings" in text
    assert text.count("<h3>Round ") == 2
    assert all(t.planned.trial in text for t in history.trials)
    assert not re.search(r"(src|href)=.https?:", text)
    rounds = text[text.index("<h3>Round 1") :]
    assert rounds.index(">proportional") < rounds.index(">feed forward")  # the task's order, not the alphabet's


def test_beside_a_path_it_is_said_that_the_logged_point_may_not_be_the_judged_one(
    told: tuple[tuple[Event, ...], Plan, Path],
) -> None:
    events, plan, folder = told
    history = History.of(events)
    tracks = tracks_of(history, folder)
    assert "of a car the front axle" not in campaign_html(history, plan, times={}, tracks=tracks)
    tracks = tuple(replace(track, wanted=np.zeros((2, 2))) for track in tracks)
    assert "of a car the front axle" in campaign_html(history, plan, times={}, tracks=tracks)


def test_a_fall_and_a_note_are_told_and_no_text_becomes_markup(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, _ = told
    changed: list[Event] = []
    for event in events:
        if isinstance(event, TrialDone) and event.trial == "trial-007":
            event = TrialDone("trial-007", "fell", (), (), "<script>alert(1)</script> & into the wall")
        if isinstance(event, Scored) and event.step == "transfer" and event.candidate == 1:
            event = Scored(event.round, event.step, 1, event.unit, (float("nan"),), True)
        changed.append(event)
    text = campaign_html(History.of(changed), plan, times={})
    assert "<script>" not in text
    assert "&amp; into the wall" in text
    assert ">fell<" in text


def test_scores_and_settings_carry_their_units(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, _ = told
    begun = events[0]
    assert isinstance(begun, Begun)
    assert set(begun.units) == {"proportional", "feed forward"}
    history = History.of([replace(begun, unit="mm", units={"proportional": "1/s"}), *events[1:]])
    shown = io.StringIO()
    show_status(history, plan, Console(file=shown, width=200))
    settings, score = history.best
    assert f"best on the robot: {score:.4g} mm" in shown.getvalue()
    assert f"proportional = {settings['proportional']:.5g} 1/s" in shown.getvalue()
    text = campaign_html(history, plan, times={})
    assert "on the robot, mm" in text
    assert "proportional, 1/s" in text


def test_a_robot_far_from_every_expectation_is_pointed_at(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, _ = told
    seen = [e for e in events if isinstance(e, Validated)]
    assert [astray(e) for e in seen] == [""] * len(seen)  # a calibrated toy is foretold well
    far = replace(seen[0], measured=tuple(0.2 * x for x in seen[0].predicted))
    assert "only 20 % of what was expected" in astray(far)
    text = campaign_html(History.of([far if e is seen[0] else e for e in events]), plan, times={})
    assert "do both runs begin alike" in text


def test_of_a_robot_with_a_free_base_the_report_shows_how_it_leans_and_how_high_it_is() -> None:
    time = np.linspace(0.0, 1.0, 20)
    channels = {
        "position": Channel("position", ("left_knee",), "rad", time, np.zeros((20, 1))),
        "base_position": Channel("base_position", ("x", "y", "z"), "m", time, np.ones((20, 3))),
        "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, np.zeros((20, 3))),
    }
    shown = str(track_figure(Track("rise", None, Recording("best", channels))))
    assert "pitch of the torso, rad" in shown
    assert "height of the torso, m" in shown
    assert "left_knee" not in shown


def test_the_best_settings_at_an_end_of_their_range_are_told(told: tuple[tuple[Event, ...], Plan, Path]) -> None:
    events, plan, _ = told
    history = History.of(events)
    best = next(s for r in history.rounds for s in r.scored if history.settings(s.unit) == history.best[0])
    for at, words in ((0.5, ""), (0.003, "lower end"), (0.998, "upper end")):
        moved = [
            replace(e, unit=(at, 0.5)) if isinstance(e, Scored) and e.unit == best.unit else e for e in events
        ]  # fmt: skip
        shown = io.StringIO()
        show_status(History.of(moved), plan, Console(file=shown, width=200))
        text = campaign_html(History.of(moved), plan, times={})
        assert (
            ("better ones may lie beyond" in text) == ("better ones may lie beyond" in shown.getvalue()) == bool(words)
        )
        assert f" at the {words}" in shown.getvalue() or not words
        assert "feed forward =" not in shown.getvalue().partition("note:")[2]
