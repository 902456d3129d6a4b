# SPDX-License-Identifier: Apache-2.0
"""What users open, in a real browser, wide and on a telephone: nothing is cut off, nothing lies over anything else.

`make pictures` writes a screenshot of each into docs/images (see benchmarks/pages.py); nothing is written otherwise.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pages import BROWSER, checked, measured

from trueup.calibration import Calibration
from trueup.identification.estimation.result import Identification
from trueup.report import write_report
from trueup.report.identification import write_identification_report
from trueup.report.replay_page import write_replay_report


@pytest.mark.parametrize("kind", ["calibrate", "identify", "replay"])
def test_nothing_is_cut_off_or_covered_at_any_width(
    kind: str, tmp_path: Path, calibration: Calibration, found: Identification
) -> None:
    path = tmp_path / "report.html"
    if kind == "calibrate":
        write_report(calibration, path)
    elif kind == "identify":
        write_identification_report(found, path)
    else:
        write_replay_report(
            calibration.held_out(), path, model="robot.xml", against="other.xml",
            notes=("commands are held for the 20 ms between their samples",),
            context={"command": "trueup replay robot.xml " + "another_log.csv " * 20},
        )  # fmt: skip
    if reason := checked(path, tmp_path, kind):
        without_browser(reason)


def test_what_is_cut_or_covered_is_found(tmp_path: Path) -> None:
    (tmp_path / "bad.html").write_text(
        '<!DOCTYPE html><body><p style="width:1500px">wide</p><div style="height:20px">one</div>'
        '<div style="margin-top:-15px">two</div></body>'
    )
    if BROWSER is None or (found := measured(BROWSER, tmp_path / "bad.html", 390, tmp_path)) is None:
        without_browser("no Chromium that starts")
        return
    assert any(words.startswith("page: ") for words in found[0])
    assert any(words.startswith("over: ") for words in found[0])


def without_browser(reason: str) -> None:
    found_out = os.environ.get("TRUEUP_NO_BROWSER", "")
    if os.environ.get("CI") and not found_out:
        pytest.fail(f"{reason}: install Debian's chromium, or set TRUEUP_NO_BROWSER to why there can be none")
    pytest.skip(found_out or reason)
