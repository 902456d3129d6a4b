# SPDX-License-Identifier: Apache-2.0
"""What the report promises: one whole file, no network, no hidden bad news, no text taken for markup."""

from __future__ import annotations

import errno
import json
import math
import os
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from trueup.calibration import Calibration, Replay
from trueup.errors import OutputError
from trueup.report import write_report
from trueup.report.report import report_html

HOSTILE = '</script><img src=x onerror=alert(1)> & "quoted" \u00fcn\u00efcode \x00'


class Page(HTMLParser):
    """The elements, attributes and visible text of a report."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.words: list[str] = []
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        place = {"script": self.scripts, "style": self.styles}.get(self._inside, self.words)
        place.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.words))

    @property
    def data(self) -> dict:
        return json.loads(self.scripts[0], parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def page_of(calibration: Calibration, **options: object) -> Page:
    return Page(report_html(calibration, **options))  # type: ignore[arg-type]


def with_error(replay: Replay, *, after: float, before: float = 0.03, held_out: bool = True) -> Replay:
    """The replay with sinusoidal errors of these root mean squares."""
    wave = math.sqrt(2) * np.sin(2 * np.pi * np.arange(replay.time.size) / 50)[:, None]
    measured = replay.measured
    return replace(replay, before=measured + before * wave, after=measured + after * wave, held_out=held_out)


def test_the_report_needs_no_network(calibration: Calibration, tmp_path: Path) -> None:
    page = Page(write_report(calibration, tmp_path / "report.html").read_text("utf-8"))
    for tag, attributes in page.elements:
        assert tag not in {"link", "iframe", "object", "embed", "base", "form"}
        assert "src" not in attributes, (tag, attributes)
        assert (attributes.get("href") or "#").startswith("#")
    assert not re.search(r"url\s*\(|@import", "".join(page.styles))
    own = page.scripts[-1]
    assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(", own)


def test_the_browser_is_told_to_fetch_nothing(calibration: Calibration) -> None:
    policies = [a["content"] for t, a in page_of(calibration).elements if a.get("http-equiv")]
    assert len(policies) == 1
    assert "default-src 'none'" in (policies[0] or "")
    assert "http" not in (policies[0] or "")


def test_no_button_sends_the_data_away(calibration: Calibration) -> None:
    own = page_of(calibration).scripts[-1]
    assert "modeBarButtons:" in own, "without a list of its own Plotly offers to upload the figure"
    assert "sendChartToCloud" not in own
    assert 'plotlyServerURL: ""' in own


def test_the_questions_are_answered_in_their_order(calibration: Calibration) -> None:
    text = page_of(calibration).text
    places = [text.index(q) for q in ("Is it better", "Which joint, when", "how sure", "not tell?", "How was it found")]
    assert places == sorted(places)


def test_the_headline_is_the_pooled_held_out_error(
    small: Callable[..., Calibration], replay: Callable[..., Replay]
) -> None:
    held = [with_error(replay(n, labels=("elbow",), seconds=4.0), before=0.04, after=0.010) for n in ("a", "b")]
    fitted = with_error(replay("c", labels=("elbow",)), before=0.05, after=0.001, held_out=False)
    text = page_of(small(replays=(fitted, *held))).text
    assert "On 2 recordings that the fit never saw" in text
    assert "fell from 40.0 mrad to 10.0 mrad, 0.25× as large" in text
    assert "0.90 mrad" in text, "the noise floor is said"


@pytest.mark.parametrize("held_out", [True, False])
def test_the_headline_says_where_replays_begin_anew(
    small: Callable[..., Calibration], replay: Callable[..., Replay], *, held_out: bool
) -> None:
    """A replay of a quarter of a second at a time is no replay of the recording."""
    whole = with_error(replay("a", labels=("elbow",)), before=0.04, after=0.010, held_out=held_out)
    text = page_of(small(replays=(replace(whole, window=0.256),))).text
    assert "replayed 0.26 s at a time from where the robot was, the replay error fell" in text
    assert "at a time" not in page_of(small(replays=(whole,))).text


def test_a_missing_hold_out_is_loud(small: Callable[..., Calibration]) -> None:
    page = page_of(small())
    assert "Nothing was held out." in page.text
    assert "never saw, the replay error" not in page.text
    alerts = [a for _, a in page.elements if a.get("role") == "alert"]
    assert alerts, "it is announced as an alert"


def test_a_worse_held_out_motion_is_said(calibration: Calibration, replay: Callable[..., Replay]) -> None:
    bad = with_error(replay("fast", held_out=True), before=0.010, after=0.013)
    good = with_error(replay("slow", held_out=True), before=0.050, after=0.005)
    text = page_of(replace(calibration, replays=(*calibration.training(), bad, good))).text
    assert "fell from" in text, "as a whole it is better"
    assert "worse on fast" in text
    assert "fast, elbow_flex" in text
    assert "slow, elbow_flex: " not in text


def test_a_worse_result_is_not_dressed_up(small: Callable[..., Calibration], replay: Callable[..., Replay]) -> None:
    bad = with_error(replay("fast", labels=("elbow",)), before=0.010, after=0.013)
    text = page_of(small(replays=(*small().replays, bad))).text
    assert "rose from 10.0" in text
    assert "worse than the one it started from" in text


def test_a_failed_simulation_is_said(small: Callable[..., Calibration], replay: Callable[..., Replay]) -> None:
    whole = replay("fall", labels=("elbow",), held_out=True, seconds=8.0)
    after = whole.after.copy()
    after[200:] = np.nan
    text = page_of(small(replays=(*small().replays, replace(whole, after=after)))).text
    assert "Simulation failed." in text
    assert "fall has no simulated values from 4.00 s" in text


def test_a_ratio_to_a_runaway_model_is_qualified(small: Callable[..., Calibration]) -> None:
    (replay,) = small().replays
    away = replace(replay, before=replay.before + 1e6 * np.linspace(0, 1, replay.time.size)[:, None])
    assert "before calibration did not follow" in page_of(small(replays=(away,))).text
    assert "before calibration did not follow" not in page_of(small()).text


def test_user_text_is_escaped(calibration: Calibration) -> None:
    (first, *others) = calibration.replays
    labels = (HOSTILE, *first.labels[1:])
    estimate = replace(calibration.estimates[0], name=HOSTILE, unit=HOSTILE, note=HOSTILE, verdict=HOSTILE)
    hostile = replace(
        calibration,
        model_name=HOSTILE,
        replays=(replace(first, recording=HOSTILE, labels=labels, channel=HOSTILE, unit=HOSTILE), *others),
        estimates=(estimate, *calibration.estimates[1:]),
        unidentified=(HOSTILE,),
        warnings=(HOSTILE,),
        notes=(HOSTILE,),
        trace=(replace(calibration.trace[0], stage=HOSTILE),),
    )
    page = page_of(hostile, title=HOSTILE, context={HOSTILE: HOSTILE})
    assert not [t for t, _ in page.elements if t == "img"]
    assert not [a for _, a in page.elements if "onerror" in a]
    assert sum(t == "script" for t, _ in page.elements) == 3
    labels_kept = [r["labels"][0] for r in page.data["replays"]]
    assert HOSTILE in labels_kept, "and nothing is lost on the way"


def test_every_parameter_and_verdict_is_listed(calibration: Calibration) -> None:
    page = page_of(calibration)
    rows = [a for t, a in page.elements if t == "tr" and "data-verdict" in a]
    assert [r["data-verdict"] for r in rows] == [e.verdict for e in calibration.estimates]
    for e in calibration.estimates:
        assert e.name in page.text
        assert e.note in page.text


def test_what_could_not_be_told_is_told(calibration: Calibration) -> None:
    text = page_of(calibration).text
    for sentence in (*calibration.unidentified, *calibration.warnings, *calibration.notes):
        assert sentence in text


def test_strongly_correlated_estimates_are_named_together(calibration: Calibration) -> None:
    fitted = sum(e.fitted for e in calibration.estimates)
    covariance = np.eye(fitted)
    covariance[0, 3] = covariance[3, 0] = -0.97
    names = [e.name for e in calibration.estimates if e.fitted]
    text = page_of(replace(calibration, covariance=covariance)).text
    assert f"{names[0]}{names[3]}−0.970" in text


@pytest.mark.parametrize("covariance", [np.zeros((0, 0)), np.full((5, 5), np.nan), np.zeros((3, 3))])
def test_a_missing_covariance_is_said(small: Callable[..., Calibration], covariance: np.ndarray) -> None:
    assert "No covariance was estimated" in page_of(small(covariance=covariance)).text


@pytest.mark.filterwarnings("error")
def test_missing_samples_reach_neither_the_scores_nor_the_json(calibration: Calibration) -> None:
    first = calibration.replays[-1]
    measured = first.measured.copy()
    measured[:, 0] = np.nan
    measured[100:150, 1] = np.nan
    page = page_of(replace(calibration, replays=(*calibration.replays[:-1], replace(first, measured=measured))))
    shown = next(r for r in page.data["replays"] if r["recording"] == first.recording)
    assert shown["columns"][0]["score"] == [None, None]
    assert shown["columns"][1]["score"][1] == pytest.approx(first.rmse_after()[1], rel=0.2)


@pytest.mark.filterwarnings("error")
def test_an_empty_calibration_still_makes_a_report(small: Callable[..., Calibration]) -> None:
    text = page_of(small(replays=(), estimates=(), covariance=np.zeros((0, 0)))).text
    assert "Nothing was replayed." in text


def test_context_and_title_are_shown(small: Callable[..., Calibration], tmp_path: Path) -> None:
    path = write_report(
        small(), tmp_path / "deep" / "er" / "r.html", title="Arm 7", context={"command": "trueup calibrate"}
    )
    page = Page(path.read_text("utf-8"))
    assert "Arm 7" in page.text
    assert "trueup calibrate" in page.text


def test_ten_long_recordings_can_be_mailed(
    calibration: Calibration, replay: Callable[..., Replay], tmp_path: Path
) -> None:
    one = replay("long", seconds=120.0)
    ten = tuple(replace(one, recording=f"long {i}", held_out=i > 7) for i in range(10))
    path = write_report(replace(calibration, replays=ten), tmp_path / "report.html")
    assert path.stat().st_size < 12e6


def test_an_old_report_survives_a_full_disk(
    small: Callable[..., Calibration], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    path.write_text("the old one")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=r"report\.html.*No space left.*untouched"):
        write_report(small(), path)
    assert path.read_text() == "the old one"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"], "nothing half written is left"


def test_a_place_that_cannot_be_written_is_named(small: Callable[..., Calibration], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"cannot write '.*r\.html'"):
        write_report(small(), tmp_path / "file" / "r.html")
    with pytest.raises(OutputError, match="cannot write"):
        write_report(small(), tmp_path)
