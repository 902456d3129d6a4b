# SPDX-License-Identifier: Apache-2.0
"""NumPy files are read as signals, whichever way round their arrays are, and nothing in them is executed."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError

TIME = np.arange(50) / 100.0
POSITION = np.stack([np.sin(TIME), np.cos(TIME)], axis=1)


def test_arrays_by_name_are_channels_with_the_names_that_stand_beside_them(tmp_path: Path, small_files: Any) -> None:
    (recording,) = formats.read(small_files.write_npz(tmp_path / "run.npz"))
    assert recording.channel("position").labels == recording.channel("command").labels == ("hip", "knee")
    expected = small_files.recording()
    assert np.array_equal(recording.channel("command").values, expected.channel("command").values)


def test_rows_and_columns_may_be_exchanged(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, q=POSITION)
    np.savez(tmp_path / "b.npz", t=TIME, q=POSITION.T)
    (a,), (b,) = formats.read(tmp_path / "a.npz"), formats.read(tmp_path / "b.npz")
    assert np.array_equal(a.channel("position").values, b.channel("position").values)


def test_three_numbers_of_an_accelerometer_are_along_its_axes_and_no_joints(tmp_path: Path) -> None:
    still = np.tile([0.0, 0.0, 9.81], (20, 1))
    np.savez(tmp_path / "leg.npz", t=np.arange(20) / 100, joint_pos=np.cumsum(np.ones((20, 4)), axis=0), accel=still)
    channels = formats.guess_mapping(tmp_path / "leg.npz").channels
    assert channels["accel"].labels == ("x", "y", "z")
    assert "acceleration" not in channels


def test_single_numbers_are_facts_and_odd_arrays_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", t=TIME, q=POSITION, mass=1.5, image=np.zeros((7, 9)))
    (recording,) = formats.read(tmp_path / "run.npz")
    assert recording.provenance["mass"] == "1.5"
    assert "'image' of shape (7, 9)" in recording.provenance["warnings"]


def test_one_array_alone_is_a_table_without_names(tmp_path: Path) -> None:
    np.save(tmp_path / "run.npy", np.column_stack([TIME, POSITION]))
    mapping = formats.ChannelMap.from_dict(
        {"time": {"column": "column_1"}, "channels": {"position": {"columns": ["column_2", "column_3"], "unit": "rad"}}}
    )
    (recording,) = formats.read(tmp_path / "run.npy", mapping)
    assert np.array_equal(recording.channel("position").values, POSITION)


def test_objects_are_refused_and_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "ran",))

    (tmp_path / "run.npy").write_bytes(pickle.dumps(Trap()))
    array = np.empty(1, dtype=object)
    array[0] = Trap()
    np.savez(tmp_path / "run.npz", q=array)
    for name in ("run.npy", "run.npz"):
        with pytest.raises(FormatError, match="Python objects"):
            formats.read(tmp_path / name)
    assert not (tmp_path / "ran").exists()


def test_a_damaged_archive_is_named(tmp_path: Path, small_files: Any) -> None:
    path = small_files.write_npz(tmp_path / "run.npz")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FormatError, match=r"run.npz: cannot be read as a NumPy file"):
        formats.read(path)
