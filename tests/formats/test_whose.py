# SPDX-License-Identifier: Apache-2.0
"""Lists of ROS messages that were spread over columns belong to the joints that each row names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from trueup.formats import read

TIME = np.arange(0.0, 2.0, 0.02)
NAMES = ("knee", "ankle", "hip")


def position(joint: str, time: float) -> float:
    return float(np.sin((1.0 + len(joint)) * time))


def written(path: Path, spelled: str, rows: Sequence[tuple[float, tuple[str, ...]]], width: int = 3) -> Path:
    """A file with a row for each instant, of the joints that the row names; what is beyond them is empty."""
    lists = ("name", "position", "velocity")
    head = ["time", *(spelled.format(each, k) for each in lists for k in range(width))]
    lines = [",".join(head)]
    for time, names in rows:
        blank = [""] * (width - len(names))
        seen = [f"{position(n, time):.6f}" for n in names]
        lines.append(",".join([f"{time:.3f}", *names, *blank, *seen, *blank, *(f"{len(n)}.5" for n in names), *blank]))
    path.write_text("\n".join([*lines, ""]))
    return path


@pytest.mark.parametrize(
    "spelled", ["field.{}{}", "{}_{}", "{}[{}]", "/joint_states/{}[{}]", "/joint_states/{}.{}", "{}/{}"]
)
def test_numbers_are_of_the_joint_that_stands_at_their_place(tmp_path: Path, spelled: str) -> None:
    (log,) = read(written(tmp_path / "log.csv", spelled, [(t, NAMES) for t in TIME]))
    for joint in NAMES:
        expected = [position(joint, t) for t in TIME]
        np.testing.assert_allclose(log.channel("position").column(joint), expected, atol=1e-6)
        np.testing.assert_allclose(log.channel("velocity").column(joint), len(joint) + 0.5)


def test_rows_may_name_their_joints_in_another_order(tmp_path: Path) -> None:
    rows = [(t, NAMES[k % 3 :] + NAMES[: k % 3]) for k, t in enumerate(TIME)]
    (log,) = read(written(tmp_path / "log.csv", "field.{}{}", rows))
    for joint in NAMES:
        np.testing.assert_allclose(log.channel("position").column(joint), [position(joint, t) for t in TIME], atol=1e-6)


def test_what_a_row_does_not_name_is_missing_there(tmp_path: Path) -> None:
    rows = [(t, NAMES if k % 4 else NAMES[:2]) for k, t in enumerate(TIME)]
    (log,) = read(written(tmp_path / "log.csv", "field.{}{}", rows))
    hip = log.channel("position").column("hip")
    assert np.flatnonzero(np.isnan(hip)).tolist() == list(range(0, len(TIME), 4))
    np.testing.assert_allclose(log.channel("position").column("knee"), [position("knee", t) for t in TIME], atol=1e-6)


def test_words_beside_lists_of_another_length_name_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{t:.3f},left,right,{t},{2 * t},{3 * t}" for t in TIME]
    path.write_text("\n".join(["time,name0,name1,q0,q1,q2", *rows, ""]))
    (log,) = read(path)
    assert log.channel("position").labels == ("joint_0", "joint_1", "joint_2")
