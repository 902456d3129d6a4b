# SPDX-License-Identifier: Apache-2.0
"""A recording written is the recording read, bit for bit, and a failed write leaves what was there."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trueup import formats
from trueup.errors import FormatError, OutputError
from trueup.recording import Channel, Recording

names = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=8)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    channels = {}
    for name in draw(st.lists(names, min_size=1, max_size=3, unique=True)):
        labels = draw(st.lists(names, min_size=1, max_size=3, unique=True))
        steps = draw(st.lists(st.floats(1e-4, 1.0), min_size=1, max_size=9))
        shape = (len(steps), len(labels))
        values = draw(hnp.arrays(np.float64, shape, elements=st.floats(allow_infinity=False)))
        channels[name] = Channel(name, tuple(labels), draw(names), np.cumsum(steps), values)
    return Recording(draw(names), channels, draw(st.dictionaries(names, names, max_size=3)))


def same(a: Recording, b: Recording) -> bool:
    def parts(recording: Recording) -> list[Any]:
        return [
            (c.name, c.labels, c.unit, c.time.tobytes(), np.nan_to_num(c.values, nan=1e308).tobytes())
            for c in recording.channels.values()
        ]

    return (a.name, dict(a.provenance), parts(a)) == (b.name, dict(b.provenance), parts(b))


@given(recordings())
@settings(deadline=None, max_examples=60)
def test_a_recording_written_is_the_recording_read(tmp_path_factory: pytest.TempPathFactory, made: Recording) -> None:
    path = tmp_path_factory.mktemp("round") / "run.parquet"
    formats.write(made, path)
    (back,) = formats.read(path)
    assert same(back, made)


def test_other_tools_find_plain_columns(tmp_path: Path, small_files: Any) -> None:
    table = pq.read_table(small_files.write_own_parquet(tmp_path / "run.parquet"))
    assert table.column_names == ["time", "command/hip", "command/knee", "position/hip", "position/knee"]


def test_a_table_from_elsewhere_is_read_with_lists_structs_and_dates(tmp_path: Path, small_files: Any) -> None:
    (recording,) = formats.read(small_files.write_foreign_parquet(tmp_path / "data.parquet"))
    assert recording.channel("command").values.shape == recording.channel("position").values.shape == (40, 2)
    stamps = pa.array(np.arange(40) * 10_000_000 + 1_700_000_000_000_000_000, pa.timestamp("ns"))
    state = pa.array([{"q1": 0.1 * i, "q2": 0.2 * i} for i in range(40)])
    pq.write_table(pa.table({"stamp": stamps, "state": state}), tmp_path / "dates.parquet")
    (recording,) = formats.read(tmp_path / "dates.parquet")
    assert np.diff(recording.time) == pytest.approx(0.01, abs=1e-6)
    assert recording.channel("position").labels == ("joint_1", "joint_2")


def test_instants_written_as_words_are_a_clock(tmp_path: Path) -> None:
    stamps = [f"2026-05-01T10:00:00.{k:03d}Z" for k in range(0, 500, 10)]
    pq.write_table(pa.table({"timestamp": stamps, "q1": np.arange(50.0)}), tmp_path / "log.parquet")
    (recording,) = formats.read(tmp_path / "log.parquet")
    assert np.diff(recording.time) == pytest.approx(0.01, abs=1e-6)


def test_a_newer_format_says_what_to_do(tmp_path: Path, small_files: Any) -> None:
    path = small_files.write_own_parquet(tmp_path / "run.parquet")
    table = pq.read_table(path)
    header = table.schema.metadata[b"trueup"].replace(b'"version": 1', b'"version": 9')
    pq.write_table(table.replace_schema_metadata({b"trueup": header}), path)
    with pytest.raises(FormatError, match=r"format version 9; .* update it"):
        formats.read(path)


@contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """No file can grow beyond `limit` bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_the_old_file_whole(tmp_path: Path, small_files: Any) -> None:
    path = small_files.write_own_parquet(tmp_path / "run.parquet")
    old = path.read_bytes()
    large = small_files.recording(20_000)
    with full_disk(10_000), pytest.raises(OutputError, match=r"cannot write '.*run.parquet'.* untouched"):
        formats.write(large, path)
    assert path.read_bytes() == old
    assert [file.name for file in tmp_path.iterdir()] == ["run.parquet"]


def test_a_folder_or_a_file_in_the_way_is_named(tmp_path: Path, small_files: Any) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        formats.write(small_files.recording(), tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        formats.write(small_files.recording(), tmp_path / "file" / "run.parquet")


def test_folders_on_the_way_are_made(tmp_path: Path, small_files: Any) -> None:
    formats.write(small_files.recording(), tmp_path / "a" / "b" / "run.parquet")
    assert (tmp_path / "a" / "b" / "run.parquet").stat().st_mode & 0o444 == 0o444


def test_a_name_of_another_format_is_refused(tmp_path: Path) -> None:
    time = np.arange(4.0)
    recording = Recording("run", {"position": Channel("position", ("q",), "rad", time, time[:, None])})
    with pytest.raises(OutputError, match=r"not as '\.csv'; name it 'run\.parquet'"):
        formats.write(recording, tmp_path / "run.csv")
    assert not (tmp_path / "run.csv").exists()


def test_lists_beside_the_names_of_joints_are_of_these_joints(tmp_path: Path) -> None:
    joints, angles = ["elbow", "hip"], np.random.default_rng(0).normal(size=(40, 2))
    state = [
        {"name": joints[:: 1 - 2 * (i % 2)], "position": row[:: 1 - 2 * (i % 2)].tolist()}
        for i, row in enumerate(angles)
    ]
    motors = [[{"id": "m1", "current_A": 0.1 * i}, {"id": "m2", "current_A": 0.2}] for i in range(40)]
    pq.write_table(pa.table({"time": 0.01 * np.arange(40), "state": state, "motors": motors}), tmp_path / "log.parquet")
    (recording,) = formats.read(tmp_path / "log.parquet")
    position = recording.channel("position")
    assert position.select(joints).values == pytest.approx(angles)
    assert recording.channel("current").values.shape == (40, 2)
