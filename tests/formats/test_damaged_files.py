# SPDX-License-Identifier: Apache-2.0
"""However a file is damaged, reading it gives sound recordings or a named error, and never a traceback."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trueup import formats
from trueup.errors import FormatError, TrueupError
from trueup.inspection import inspect

Damage = Callable[[bytes], bytes]

TEXT = ("columns.csv", "blanks.txt", "semicolons.csv", "lists", "numbers", "entries.json", "lines.jsonl")
BINARY = ("arrays.npz", "own.parquet", "foreign.parquet")
BAGS = ("bag_sqlite", "bag_mcap")

pytestmark = pytest.mark.filterwarnings("error")

places = st.floats(0.0, 1.0, allow_nan=False)
WORDS = "nan inf abc 1e999 [ ] [1,2 # , ; - é 1,5 {} null true 2024-01-01 0x1F 1_0 [[[ -1 1e-320 \\ud800 [1,2,3] {"
words = st.sampled_from([*WORDS.split(), "", '"', "\x00", "\n", "\t", "9" * 400, "[" * 2000])


@st.composite
def text_damages(draw: st.DrawFn) -> Damage:
    """One way to damage a text file."""
    kind = draw(st.sampled_from(["cut", "flip", "delete line", "repeat line", "swap lines", "swap cells", "insert"]))
    at, other, word = draw(places), draw(places), draw(words)
    bit = draw(st.integers(0, 7))

    def damage(data: bytes) -> bytes:
        if kind == "cut":
            return data[: int(at * len(data))]
        if kind == "flip":
            return _flipped(data, at, bit)
        if kind == "insert":
            i = int(at * len(data))
            return data[:i] + word.encode() + data[i:]
        lines = data.split(b"\n")
        i, k = (min(int(x * len(lines)), len(lines) - 1) for x in (at, other))
        if kind == "delete line":
            del lines[i]
        elif kind == "repeat line":
            lines.insert(k, lines[i])
        elif kind == "swap lines":
            lines[i], lines[k] = lines[k], lines[i]
        else:
            lines[i] = b",".join(reversed(lines[i].split(b",")))
        return b"\n".join(lines)

    return damage


@st.composite
def binary_damages(draw: st.DrawFn) -> Damage:
    """One way to damage a binary file."""
    kind = draw(st.sampled_from(["cut", "flip", "zero", "delete", "insert"]))
    at, length, bit = draw(places), draw(st.integers(1, 64)), draw(st.integers(0, 7))

    def damage(data: bytes) -> bytes:
        i = int(at * len(data))
        if kind == "cut":
            return data[:i]
        if kind == "flip":
            return _flipped(data, at, bit)
        if kind == "zero":
            return data[:i] + bytes(min(length, len(data) - i)) + data[i + length :]
        if kind == "delete":
            return data[:i] + data[i + length :]
        return data[:i] + b"\xff" * length + data[i:]

    return damage


def _flipped(data: bytes, at: float, bit: int) -> bytes:
    if not data:
        return data
    i = min(int(at * len(data)), len(data) - 1)
    return data[:i] + bytes([data[i] ^ (1 << bit)]) + data[i + 1 :]


def check(sound: Path, where: Path, damages: list[Damage], which: float) -> None:
    """Damages a copy of a file (or one file of a folder) and reads it."""
    copy = where / sound.name
    if sound.is_dir():
        shutil.copytree(sound, copy, dirs_exist_ok=True)
        files = sorted(file for file in copy.iterdir() if file.is_file())
        target = files[min(int(which * len(files)), len(files) - 1)]
    else:
        shutil.copy(sound, copy)
        target = copy
    data = target.read_bytes()
    for damage in damages:
        data = damage(data)
    target.write_bytes(data)
    try:
        recordings = formats.read(copy)
    except TrueupError as error:
        str(error).encode()  # can be printed anywhere
        return
    assert recordings
    for recording in recordings:
        for channel in recording.channels.values():
            assert channel.values.shape == (len(channel.time), len(channel.labels))
            assert np.all(np.diff(channel.time) > 0.0)
            assert not np.any(np.isinf(channel.values))
        assert all(isinstance(value, str) for value in recording.provenance.values())
        inspect(recording).findings()


@pytest.fixture(scope="module")
def sound_files(tmp_path_factory: pytest.TempPathFactory, small_files: Any) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    small_files.write_csv(folder / "columns.csv")
    small_files.write_csv(folder / "blanks.txt", " ")
    small_files.write_csv(folder / "semicolons.csv", ";")
    small_files.write_lists(folder / "lists")
    small_files.write_one_number_a_line(folder / "numbers")
    small_files.write_json(folder / "entries.json")
    small_files.write_json(folder / "lines.jsonl")
    small_files.write_npz(folder / "arrays.npz")
    small_files.write_own_parquet(folder / "own.parquet")
    small_files.write_foreign_parquet(folder / "foreign.parquet")
    small_files.write_joint_bag(folder / "bag_sqlite")
    small_files.write_joint_bag(folder / "bag_mcap", mcap=True)
    return folder


@pytest.mark.parametrize("name", [*TEXT, *BINARY, *BAGS])
def test_the_files_are_sound_before_they_are_damaged(sound_files: Path, name: str) -> None:
    (recording,) = formats.read(sound_files / name)
    assert recording.has("position")


common = settings(
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@given(name=st.sampled_from(TEXT), damages=st.lists(text_damages(), min_size=1, max_size=3), which=places)
@settings(common, max_examples=300)
def test_a_damaged_text_file_is_read_or_named(
    sound_files: Path, tmp_path_factory: pytest.TempPathFactory, name: str, damages: list[Damage], which: float
) -> None:
    check(sound_files / name, tmp_path_factory.mktemp("text"), damages, which)


@given(name=st.sampled_from(BINARY), damages=st.lists(binary_damages(), min_size=1, max_size=2))
@settings(common, max_examples=200)
def test_a_damaged_binary_file_is_read_or_named(
    sound_files: Path, tmp_path_factory: pytest.TempPathFactory, name: str, damages: list[Damage]
) -> None:
    check(sound_files / name, tmp_path_factory.mktemp("binary"), damages, 0.0)


@given(name=st.sampled_from(BAGS), damages=st.lists(binary_damages(), min_size=1, max_size=2), which=places)
@settings(common, max_examples=60)
def test_a_damaged_bag_is_read_or_named(
    sound_files: Path, tmp_path_factory: pytest.TempPathFactory, name: str, damages: list[Damage], which: float
) -> None:
    check(sound_files / name, tmp_path_factory.mktemp("bag"), damages, which)


@pytest.mark.parametrize("line", ["time,cmd_1,q1", "Zeit [ms];Soll_yaw [deg];Ist_yaw [deg]", "t [s],q1 [rad]\n"])
def test_a_file_that_only_names_columns_is_said_to_have_no_rows(tmp_path: Path, line: str) -> None:
    (tmp_path / "log.csv").write_text(line)
    with pytest.raises(FormatError, match="no rows; its only line names columns: "):
        formats.read(tmp_path / "log.csv")
