# SPDX-License-Identifier: Apache-2.0
"""The report in a real browser: the figures are drawn and nothing goes wrong. In continuous integration it must be there."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from trueup.calibration import Calibration
from trueup.film import Film
from trueup.report import write_report
from trueup.report.film_replay import write_film

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--window-size=1280,2000",
    "--virtual-time-budget=10000",
    "--dump-dom",
)


def without_browser(reason: str) -> NoReturn:
    """Skips with the reason; fails where CI is set, unless `make test` found out why there can be none (.ci/browser)."""
    found_out = os.environ.get("TRUEUP_NO_BROWSER", "")
    if os.environ.get("CI") and not found_out:
        pytest.fail(f"{reason}: install Debian's chromium, or set TRUEUP_NO_BROWSER to why there can be none")
    pytest.skip(found_out or reason)


def opened(path: Path, profile: Path) -> str:
    """The document as it stands once its scripts have run without an error."""
    if BROWSER is None:
        without_browser("no Chromium to open the report with")
    command = [str(BROWSER), *FLAGS, f"--user-data-dir={profile}", path.as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    except subprocess.TimeoutExpired:
        without_browser("the browser does not start here")
    if "</html>" not in done.stdout:
        without_browser("the browser does not start here")
    assert "CONSOLE" not in done.stderr, [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout


def test_the_figures_are_drawn_without_an_error(calibration: Calibration, tmp_path: Path) -> None:
    shown = opened(write_report(calibration, tmp_path / "report.html"), tmp_path / "profile")
    for figure in ("replay-figure", "spectrum-figure", "speed-figure", "correlation-figure", "trace-figure"):
        place = shown.index(f'id="{figure}"')
        assert "main-svg" in shown[place : place + 3000], f"{figure} is drawn"
    assert "held out, " in shown, "the title of the first replay is filled in"


def test_films_are_drawn_without_an_error(swinging: Callable[..., Film], tmp_path: Path) -> None:
    path = write_film({"Swinging": [swinging(), swinging("robot")]}, tmp_path / "film.html", title="Swinging")
    assert "http" not in path.read_text(encoding="utf-8")  # it asks nothing of the network
    shown = opened(path, tmp_path / "profile")
    assert 'max="19"' in shown  # as many instants as the film has
    assert shown.count('data-shapes="2"') == 2  # both canvases were drawn on
