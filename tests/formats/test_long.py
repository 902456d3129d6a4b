# SPDX-License-Identifier: Apache-2.0
"""Files with a row for each joint and instant are read as one recording with a column for each joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.formats import read

Array = NDArray[np.float64]
TIME = np.arange(0.0, 2.0, 0.02)
NAMES = ("hip", "knee", "ankle")
SKEW = 0.002  # s from joint to joint


def position(joint: int, time: Array) -> Array:
    return np.sin((2.0 + joint) * time + joint)


def written(path: Path, whose: str, rows: list[tuple[float, str, float, float]]) -> Path:
    lines = [f"{t:.6f},{who},{told:.6f},{seen:.6f}" for t, who, told, seen in rows]
    path.write_text("\n".join([f"time,{whose},goal_position,present_position", *lines, ""]))
    return path


def row(joint: int, time: float, who: str) -> tuple[float, str, float, float]:
    return time, who, float(position(joint, np.array(time + 0.1))), float(position(joint, np.array(time)))


def test_rows_at_the_same_instants_become_columns_and_lost_rows_are_missing_values(tmp_path: Path) -> None:
    rows = [row(j, t, str(j + 1)) for t in TIME for j in range(3)]
    (log,) = read(written(tmp_path / "a.csv", "servo_id", [r for k, r in enumerate(rows) if k != 31]))
    seen = log.channel("position")
    assert seen.labels == log.channel("command").labels == ("servo_1", "servo_2", "servo_3")
    assert np.argwhere(np.isnan(seen.values)).tolist() == [[10, 1]]
    np.testing.assert_allclose(seen.column("servo_3"), position(2, TIME), atol=1e-6)
    assert "one joint each" in log.provenance["warnings"]


def test_joints_read_one_after_the_other_are_brought_to_one_clock(tmp_path: Path) -> None:
    rows = [row(j, t + SKEW * j, NAMES[j]) for t in TIME for j in range(3)]
    (log,) = read(written(tmp_path / "b.csv", "name", rows))
    seen, told = log.channel("position"), log.channel("command")
    assert seen.labels == NAMES
    np.testing.assert_allclose(seen.values[1:], np.stack([position(j, TIME[1:]) for j in range(3)], axis=1), atol=1e-3)
    # A command holds: at the first joint's time the third one has that of the row before.
    np.testing.assert_allclose(told.column("ankle")[1:], position(2, TIME[:-1] + 2 * SKEW + 0.1), atol=1e-6)


def test_a_block_for_each_joint_is_a_file_of_joints_too(tmp_path: Path) -> None:
    (log,) = read(written(tmp_path / "c.csv", "joint", [row(j, t, NAMES[j]) for j in range(3) for t in TIME]))
    np.testing.assert_allclose(log.channel("position").column("knee"), position(1, TIME), atol=1e-6)


@pytest.mark.parametrize(
    "motor", [np.arange(len(TIME)) // 40, np.random.default_rng(0).integers(1500, 1504, len(TIME))]
)
def test_a_column_that_says_which_motor_moves_or_how_is_a_signal(motor: NDArray[np.int64], tmp_path: Path) -> None:
    rows = [row(0, t, f"{which}") for t, which in zip(TIME, motor, strict=True)]
    (log,) = read(written(tmp_path / "d.csv", "motor", rows))
    assert len(log.channel("position").labels) == 1
    assert len(log.time) == len(TIME)
