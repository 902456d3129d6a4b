# SPDX-License-Identifier: Apache-2.0
"""Which files make one recording together, and where everything came from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError, MappingError
from trueup.formats import ChannelMap


def test_commands_and_states_in_two_files_are_one_recording(tmp_path: Path, small_files: Any) -> None:
    (recording,) = formats.read(small_files.write_lists(tmp_path / "run"))
    expected = small_files.recording()
    assert recording.name == "run"
    for name in ("command", "position"):
        channel = recording.channel(name)
        assert channel.labels == ("hip", "knee")  # from joint_list.txt
        assert channel.time == pytest.approx(expected.time, abs=1e-9)
        assert np.array_equal(channel.values, expected.channel(name).values)
    assert recording.provenance["events in event.csv"] == "0 EVENT START; 390000 EVENT STOP"


def test_files_alike_are_a_recording_each(tmp_path: Path, small_files: Any) -> None:
    for i in range(3):
        small_files.write_csv(tmp_path / f"run_{i}.csv")
    assert [r.name for r in formats.read(tmp_path)] == ["run_0", "run_1", "run_2"]


def test_files_alike_whose_names_tell_their_role_are_one_recording(tmp_path: Path) -> None:
    for role in ("position", "velocity", "current"):
        (tmp_path / f"{role}.csv").write_text("t,hip\n0,1\n0.1,2\n0.2,3\n")
    (recording,) = formats.read(tmp_path)
    assert set(recording.channels) == {"position", "velocity", "current"}


def test_folders_in_a_folder_are_a_recording_each(tmp_path: Path, small_files: Any) -> None:
    small_files.write_lists(tmp_path / "a")
    small_files.write_lists(tmp_path / "b")
    small_files.write_joint_bag(tmp_path / "c")
    (tmp_path / "LICENSE").write_text("free")
    assert [r.name for r in formats.read(tmp_path)] == ["a", "b", "c"]


def test_notes_beside_recordings_are_none(tmp_path: Path, small_files: Any) -> None:
    (tmp_path / "logs").mkdir()
    for run in ("first", "second"):
        small_files.write_csv(tmp_path / "logs" / f"{run}.csv")
    notes = tmp_path / "logs" / "notes.txt"
    notes.write_text("24 October, new battery.\nThe second drive was in the wet: 3 laps of 20 m.\n", encoding="utf-8")
    assert [r.name for r in formats.read(tmp_path / "logs")] == ["first", "second"]
    assert not formats.is_recording(notes)
    plain = tmp_path / "logs" / "plain.txt"
    plain.write_text("t q cmd\n" + "".join(f"{0.1 * k:.1f} {k % 3} {k % 5}\n" for k in range(20)), encoding="utf-8")
    assert formats.is_recording(plain)


def test_a_file_beside_folders_of_recordings_does_not_hide_them_silently(tmp_path: Path, small_files: Any) -> None:
    small_files.write_lists(tmp_path / "drives" / "d1")
    small_files.write_joint_bag(tmp_path / "drives" / "d2")
    (tmp_path / "drives" / "plots").mkdir()
    small_files.write_csv(tmp_path / "drives" / "stray.csv")
    (recording,) = formats.read(tmp_path / "drives")
    assert "not the folders beside them: d1, d2;" in recording.provenance["warnings"]
    formats.write(recording.replace(provenance={}), tmp_path / "drives" / "kept.parquet")
    (tmp_path / "drives" / "stray.csv").unlink()
    (recording,) = formats.read(tmp_path / "drives")
    assert "its own files (kept.parquet) were read" in recording.provenance["warnings"]


def test_several_paths_are_read_in_their_order(tmp_path: Path, small_files: Any) -> None:
    paths = [small_files.write_json(tmp_path / "z.json"), small_files.write_csv(tmp_path / "a.csv")]
    assert [r.name for r in formats.read(paths)] == ["z", "a"]


def test_provenance_names_the_files_and_their_checksums(tmp_path: Path, small_files: Any) -> None:
    path = small_files.write_csv(tmp_path / "a.csv")
    (recording,) = formats.read(path)
    assert recording.provenance["source"] == str(path)
    assert recording.provenance["sha256 of a.csv"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert recording.provenance["mapping"] == "guessed"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("run.xlsx", r"end in '.xlsx' are not known; known are: .csv.*spreadsheet"),
        ("run.pkl", r"numpy\.savez"),
        ("empty", "no file here"),
    ],
)
def test_what_cannot_be_read_lists_what_can(tmp_path: Path, name: str, message: str) -> None:
    if name == "empty":
        (tmp_path / name).mkdir()
    else:
        (tmp_path / name).write_bytes(b"MATLAB")
    with pytest.raises(FormatError, match=message):
        formats.read(tmp_path / name)


def test_a_column_in_two_files_asks_which_is_meant(tmp_path: Path, small_files: Any) -> None:
    folder = small_files.write_lists(tmp_path / "run")
    data = {
        "time": {"column": "timestamp"},
        "channels": {"command": {"columns": "positions"}, "position": {"file": "state*", "columns": "positions"}},
    }
    with pytest.raises(MappingError, match=r"its columns are in several files \(control.csv, state_motor.csv\)"):
        formats.read(folder, ChannelMap.from_dict(data))


def test_times_and_values_must_be_equally_many(tmp_path: Path, small_files: Any) -> None:
    folder = small_files.write_one_number_a_line(tmp_path / "run")
    (folder / "run_time.txt").write_text("\n".join(f"{i / 100}" for i in range(39)))
    data = {"time": {"file": "run_time.txt"}, "channels": {"q": {"file": "*positions*", "columns": "*", "width": 2}}}
    with pytest.raises(FormatError, match=r"has 39 times, but channel 'q' has 40 samples"):
        formats.read(folder, ChannelMap.from_dict(data))


def test_no_path_at_all_is_an_error() -> None:
    with pytest.raises(FormatError, match="no file was given"):
        formats.read([])


def test_a_joint_of_the_model_that_a_camera_saw_is_a_joint(tmp_path: Path) -> None:
    (tmp_path / "plc.csv").write_text("t,lift_soll_mm,lift_ist_mm\n0,1,1\n0.1,2,2\n0.2,3,3\n")
    (tmp_path / "camera.csv").write_text("timestamp,sway_deg,score\n0,1,90\n0.1,2,80\n0.2,3,70\n")
    channels = formats.guess_mapping(tmp_path, ("lift", "sway")).channels
    (seen,) = (name for name, channel in channels.items() if channel.columns == ("sway_deg",))
    assert seen.startswith("position")
    assert (channels[seen].labels, channels[seen].unit) == (("sway",), "deg")
