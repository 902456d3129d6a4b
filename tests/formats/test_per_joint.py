# SPDX-License-Identifier: Apache-2.0
"""Files of one joint each are one recording; runs that happen to have a number are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.formats import read


def save(folder: Path, names: list[str], lengths: list[int]) -> None:
    folder.mkdir()
    for k, (name, length) in enumerate(zip(names, lengths, strict=True)):
        time = np.arange(length) / 100.0
        table = np.column_stack([time, np.sin(time + k), k + np.cos(time)])
        np.savetxt(folder / name, table, header="time pos torque", comments="")


@pytest.mark.parametrize("word", ["joint", "axis_", "log_J"])
def test_files_of_one_joint_each_are_one_recording(tmp_path: Path, word: str) -> None:
    save(tmp_path / "run", [f"{word}{k + 1}.txt" for k in range(3)], [300] * 3)
    (recording,) = read(tmp_path / "run")
    assert recording.channel("position").values.shape == (300, 3)
    assert recording.channel("torque").values[0] == pytest.approx([1.0, 2.0, 3.0])
    assert len(set(recording.channel("torque").labels)) == 3


def test_files_of_runs_are_recordings_each(tmp_path: Path) -> None:
    save(tmp_path / "runs", ["run1.txt", "run2.txt"], [300, 300])
    save(tmp_path / "other", ["joint1.txt", "joint2.txt"], [300, 250])
    assert len(read(tmp_path / "runs")) == 2
    assert len(read(tmp_path / "other")) == 2
