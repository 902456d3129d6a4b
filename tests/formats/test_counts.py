# SPDX-License-Identifier: Apache-2.0
"""Encoder counts of servos are told from degrees by their numbers alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from trueup.formats import read


def _csv(path: Path, measured: np.ndarray, wanted: np.ndarray) -> Path:
    rows = [f"{0.02 * k:g},{int(c)},{int(p)}\n" for k, (c, p) in enumerate(zip(wanted, measured, strict=True))]
    path.write_text("t,hip.goal_position,hip.present_position\n" + "".join(rows))
    return path


def test_whole_numbers_up_to_4095_are_a_turn_around_2048(tmp_path: Path) -> None:
    angle = 0.8 * np.sin(np.arange(100) / 9.0)
    counts = np.round(angle * 4096 / (2 * np.pi) + 2048)
    (recording,) = read(_csv(tmp_path / "servo.csv", counts, counts))
    assert recording.channel("position").unit == recording.channel("command").unit == "rad"
    np.testing.assert_allclose(recording.channel("position").values[:, 0], angle, atol=np.pi / 4096)
    assert "counts of servos" in recording.provenance["guesses"]


@pytest.mark.parametrize("largest", [180, 719, 9000])
def test_other_whole_numbers_are_left_to_the_user(tmp_path: Path, largest: int) -> None:
    numbers = np.round(np.linspace(0, largest, 50))
    (recording,) = read(_csv(tmp_path / "log.csv", numbers, numbers))
    assert recording.channel("position").unit == ""


def test_counts_of_few_bits_are_left_to_the_user_with_what_they_may_be(tmp_path: Path) -> None:
    counts = np.round(240.0 * np.sin(np.arange(100) / 9.0) + 512)
    (recording,) = read(_csv(tmp_path / "ax.csv", counts, counts))
    assert recording.channel("position").unit == recording.channel("command").unit == ""
    said = recording.provenance["guesses"]
    scale, offset = (float(x) for x in re.findall(r"scale = ([\d.]+), offset = (-[\d.]+) for 1023 in 300", said)[0])
    assert scale * 512 + offset == pytest.approx(0.0, abs=0.01)
    assert scale * 1023 == pytest.approx(300.0, abs=0.01)


@pytest.mark.parametrize("count", [0.229 * 2 * np.pi / 60, 2 * np.pi / 4096])
def test_whole_speeds_beside_counts_are_those_of_the_servo_that_says_them(tmp_path: Path, count: float) -> None:
    time = 0.02 * np.arange(300)
    positions = np.round(700.0 * np.sin(3.0 * time) + 2048)
    speeds = np.round(700.0 * 3.0 * np.cos(3.0 * time) * 2 * np.pi / 4096 / count)
    rows = [f"{t:g},{int(p)},{int(v)}\n" for t, p, v in zip(time, positions, speeds, strict=True)]
    (tmp_path / "servo.csv").write_text("t,hip.present_position,hip.present_velocity\n" + "".join(rows))
    (recording,) = read(tmp_path / "servo.csv")
    assert recording.channel("velocity").unit == "rad/s"
    np.testing.assert_allclose(recording.channel("velocity").values[:, 0], speeds * count, rtol=1e-9)
    assert "counts of servos, of " in recording.provenance["guesses"]
