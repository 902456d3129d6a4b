# SPDX-License-Identifier: Apache-2.0
"""JSON logs of every shape are read, and a fault is named by its entry, key and value."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError
from trueup.inspection.settings import setting
from trueup.recording import Recording

TIMES = [0.0, 0.01, 0.02, 0.03]


def read(path: Path, content: Any) -> Recording:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    (recording,) = formats.read(path)
    return recording


@pytest.mark.parametrize(
    "content",
    [
        {"mass": 0.49, "entries": [{"t": t, "position": 10 * t} for t in TIMES]},
        [{"t": t, "position": 10 * t} for t in TIMES],
        {"t": TIMES, "position": [10 * t for t in TIMES]},
        {"log": {"t": TIMES, "position": [10 * t for t in TIMES]}, "mass": 0.49},
        {"t": TIMES, "position": [[10 * t] for t in TIMES]},
        "\n".join(json.dumps({"t": t, "position": 10 * t}) for t in TIMES),
    ],
)
def test_one_content_in_any_shape_is_one_recording(tmp_path: Path, content: Any) -> None:
    position = read(tmp_path / "log.json", content).channel("position")
    assert position.labels == ("joint_1",)
    assert position.time == pytest.approx(TIMES)
    assert position.values[:, 0] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_nested_objects_name_the_joints(tmp_path: Path) -> None:
    entries = [{"t": t, "pos": {"hip": t, "knee": 2 * t}, "goal": {"hip": 0, "knee": 1}} for t in TIMES]
    recording = read(tmp_path / "log.json", entries)
    assert recording.channel("position").labels == recording.channel("command").labels == ("hip", "knee")


def test_a_list_of_motors_in_each_line_is_one_column_for_each_of_their_signals(tmp_path: Path) -> None:
    def motors(signal: str, t: float) -> list[dict[str, Any]]:
        return [{"mode": 10, signal: t}, {"mode": 10, signal: 2 * t}]

    bare = [{"t": t, "motorState": motors("q", t), "motorCmd": motors("q", 3 * t), "foot": [1, 2, 3, 4]} for t in TIMES]
    recording = read(tmp_path / "log.jsonl", "\n".join(json.dumps(line) for line in bare))
    assert recording.channel("position").labels == recording.channel("command").labels == ("joint_0", "joint_1")
    assert recording.channel("position").values[:, 1] == pytest.approx([2 * t for t in TIMES])
    assert recording.channel("command").values[:, 1] == pytest.approx([6 * t for t in TIMES])
    assert recording.channel("foot").labels == ("1", "2", "3", "4")


def test_objects_of_a_list_that_name_themselves_are_told_apart_by_that_name(tmp_path: Path) -> None:
    def joints(t: float, turned: bool) -> list[dict[str, Any]]:
        both = [{"name": "hip", "position": t}, {"name": "knee", "position": 2 * t}]
        return both[::-1] if turned else both

    recording = read(tmp_path / "log.json", [{"t": t, "joint_states": joints(t, t > 0.01)} for t in TIMES])
    assert recording.channel("position").labels == ("hip", "knee")
    assert recording.channel("position").column("knee") == pytest.approx([2 * t for t in TIMES])


def test_facts_beside_the_signals_are_kept(tmp_path: Path) -> None:
    entries = [{"t": t, "position": t, "state": "ok"} for t in TIMES]
    recording = read(tmp_path / "log.json", {"mass": 0.49, "motor": {"name": "xl330"}, "entries": entries})
    assert recording.provenance["mass"] == "0.49"
    assert recording.provenance["motor.name"] == "xl330"


def test_names_and_gains_in_lists_are_those_of_the_joints(tmp_path: Path) -> None:
    samples = [{"t": k / 10, "q": [k, 2 * k], "q_des": [k, k]} for k in range(5)]
    content = {"joint_names": ["hip", "knee"], "kp": [20.0, 30.0], "data": samples}
    log = read(tmp_path / "log.json", content)
    assert log.channel("position").labels == ("hip", "knee")
    assert setting(log, "kp") == {"hip": 20.0, "knee": 30.0}


def test_names_in_each_line_say_which_number_is_whose_in_whatever_order(tmp_path: Path) -> None:
    both = [{"hip": t, "knee": 2 * t} for t in TIMES]
    orders = [list(each) if k % 2 else list(each)[::-1] for k, each in enumerate(both)]
    lines = [
        {
            "stamp": t,
            "joint_states": {
                "name": order,
                "position": [each[j] for j in order],
                "effort": [3 * each[j] for j in order],
            },
        }
        for t, each, order in zip(TIMES, both, orders, strict=True)
    ]
    path = tmp_path / "log.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    (log,) = formats.read([path])
    for name, factor in (("position", 1.0), ("torque", 3.0)):
        np.testing.assert_allclose(log.channel(name).column("hip"), factor * np.array(TIMES))
        np.testing.assert_allclose(log.channel(name).column("knee"), 2.0 * factor * np.array(TIMES))


def test_an_entry_without_a_key_misses_that_sample(tmp_path: Path) -> None:
    recording = read(tmp_path / "log.json", [{"t": t, "position": t} if t else {"t": t} for t in TIMES])
    assert np.isnan(recording.channel("position").values[:, 0]).tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ('{"t": [0, 0.1', r"line 1, column 14: not valid JSON .*cut off"),
        ('{"t": [0,\n 0.1,, 2]}', r"line 2, column 6"),
        ("3", "holds 3; a list of entries"),
        ("{}", "holds no list of samples"),
        ("[]", "the list is empty"),
        ('[{"t": 0}, 7]', r"entry 2: 7 is not an object"),
        ("[" * 100_000, "nested too deeply"),
        ([{"t": t, "position": "up" if t == 0.02 else t} for t in TIMES], r"'position', entry 3: 'up' is not a number"),
        ([{"t": t, "position": [t] * (2 + (t == 0.02))} for t in TIMES], r"entry 3: .* not a list of 2 numbers"),
        ({"t": TIMES * 2, "position": [1.0] * 7, "q": [1.0] * 8}, r"'position' has 7 samples, the others 8"),
        ([{"t": t, "position": 10**400} for t in TIMES], r"entry 1: 1000.* is not a number"),
        ([[0, 1], [1, 2], [2]], r"entry 3: 1 numbers, others have 2"),
    ],
)
def test_a_fault_is_named_with_its_place_and_value(tmp_path: Path, content: Any, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read(tmp_path / "log.json", content)


def test_a_last_line_that_was_cut_off_costs_that_line_only(tmp_path: Path) -> None:
    lines = [json.dumps({"t": t, "position": t}) for t in TIMES]
    recording = read(tmp_path / "log.jsonl", "\n".join(lines)[:-5])
    assert len(recording.time) == 3
    assert "the last line (4) is cut off" in recording.provenance["warnings"]


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
def test_times_of_day_are_a_clock(tmp_path: Path, zone: str) -> None:
    stamps = [f"2026-03-04T23:59:59.98{zone}", f"2026-03-04T23:59:59.99{zone}", f"2026-03-05T00:00:00{zone}"]
    position = read(tmp_path / "log.json", [{"stamp": t, "position": 1.0} for t in stamps]).channel("position")
    assert position.time - position.time[0] == pytest.approx([0.0, 0.01, 0.02])


def test_names_that_stand_above_lists_in_every_line_are_those_of_the_joints(tmp_path: Path) -> None:
    lines = [
        {
            "t": t,
            "names": ["hip", "knee"],
            "modes": ["pos", "pos"],
            "cmd": {"q": [3 * t, t]},
            "state": {"q": [t, 2 * t]},
        }
        for t in TIMES
    ]
    recording = read(tmp_path / "log.jsonl", "\n".join(json.dumps(line) for line in lines))
    assert recording.channel("position").labels == recording.channel("command").labels == ("hip", "knee")
    assert recording.channel("command").column("hip") == pytest.approx([3 * t for t in TIMES])
