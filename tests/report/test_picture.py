# SPDX-License-Identifier: Apache-2.0
"""Still pictures are sound SVG files that stand alone."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.calibration import Calibration, Replay
from trueup.errors import UnknownNameError
from trueup.report import before_after_picture, replay_picture, write_pictures


def texts(svg: str) -> list[str]:
    return [e.text or "" for e in ElementTree.fromstring(svg.encode()).iter() if e.tag.endswith("}text")]


def test_there_is_a_picture_of_every_held_out_recording(calibration: Calibration, tmp_path: Path) -> None:
    paths = write_pictures(calibration, tmp_path / "pictures")
    assert {p.name for p in paths} == {
        "before-after.svg",
        "replay-fast_transitions.svg",
        "replay-hold_under_gravity.svg",
    }
    for path in paths:
        root = ElementTree.parse(path).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"


def test_pictures_refer_to_nothing_outside(calibration: Calibration) -> None:
    for svg in (before_after_picture(calibration), replay_picture(calibration.replays[0])):
        assert not re.search(r"href|<script|<style|url\((?!#)", svg)


def test_every_recording_has_its_line(calibration: Calibration) -> None:
    shown = texts(before_after_picture(calibration))
    for replay in calibration.replays:
        assert replay.recording in shown


def test_a_picture_shows_the_chosen_joints_and_time_only(calibration: Calibration) -> None:
    svg = replay_picture(calibration.replays[0], labels=["elbow_flex"], start=5.0, stop=8.0)
    shown = texts(svg)
    assert "elbow_flex" in shown
    assert "gripper" not in shown
    assert {"5", "6", "7"} <= {t.removesuffix(" s").removesuffix(".0") for t in shown}


def test_an_unknown_joint_is_named_with_the_choices(calibration: Calibration) -> None:
    with pytest.raises(UnknownNameError, match="elbow_flex"):
        replay_picture(calibration.replays[0], labels=["elbow"])


def test_names_are_names_in_pictures(replay: Callable[..., Replay]) -> None:
    name = "<b>&\"'</b>"
    svg = replay_picture(replay(name, labels=(name,), seconds=2.0))
    assert name in texts(svg)


@pytest.mark.filterwarnings("error")
def test_gaps_and_runaway_models_are_drawn(replay: Callable[..., Replay]) -> None:
    whole = replay("r", labels=("a", "b"), seconds=4.0)
    measured, before = whole.measured.copy(), whole.before.copy()
    measured[:, 0] = np.nan
    measured[50:60, 1] = np.nan
    before[20:] = 1e300
    svg = replay_picture(replace(whole, measured=measured, before=before, command=None))
    ElementTree.fromstring(svg.encode())
    assert "nan" not in svg.lower().replace("nanum", "")
    assert "command" not in texts(svg)


def test_recordings_of_one_name_get_files_of_their_own(calibration: Calibration, tmp_path: Path) -> None:
    same = tuple(
        replace(r, recording=name, held_out=True) for r, name in zip(calibration.replays, ("a/b", "a b"), strict=False)
    )
    assert len({p.name for p in write_pictures(replace(calibration, replays=same), tmp_path)}) == 3
