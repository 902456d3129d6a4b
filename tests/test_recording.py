# SPDX-License-Identifier: Apache-2.0
"""A recording is immutable, keeps what it has through every change, and cannot be made of parts that do not fit."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.errors import RecordingError, UnknownNameError
from trueup.recording import Channel, Recording

TIME = np.arange(0.0, 2.0, 0.1)


def channel(name: str = "position", time: Any = TIME, labels: tuple[str, ...] = ("hip", "knee")) -> Channel:
    time = np.asarray(time)
    values = np.stack([np.sin(time + k) for k in range(len(labels))], axis=1)
    return Channel(name, labels, "rad", time, values)


def recording(*channels: Channel) -> Recording:
    return Recording("run", {c.name: c for c in channels or (channel("command"), channel())}, {"source": "robot"})


def test_changing_the_arrays_it_was_made_from_does_not_change_a_channel() -> None:
    values = np.ones((3, 1))
    made = Channel("position", ("hip",), "rad", np.arange(3.0), values)
    values[0] = 7.0
    assert made.values[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        made.values[0] = 7.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": np.array([0.0, 2.0, 1.0])}, r"sample 2: 2 s is followed by 1 s"),
        ({"time": np.array([0.0, 1.0, 1.0])}, r"sample 2: 1 s is followed by 1 s"),
        ({"time": np.array([0.0, np.nan, 1.0])}, "time of sample 1 is nan"),
        ({"time": np.arange(4.0)}, r"\(4,\).*\(3, 2\)"),
        ({"labels": ("hip",)}, "1 labels for 2 columns"),
        ({"labels": ("hip", "hip")}, "'hip' is used 2 times"),
        ({"time": np.zeros(0), "values": np.zeros((0, 2))}, "no samples"),
        ({"values": np.array([["a", "b"]] * 3)}, "not numbers"),
    ],
)
def test_parts_that_do_not_fit_are_refused_by_name(changes: dict[str, Any], message: str) -> None:
    sound = Channel("position", ("hip", "knee"), "rad", np.arange(3.0), np.zeros((3, 2)))
    with pytest.raises(RecordingError, match=message):
        sound.replace(**changes)


def test_a_name_that_does_not_exist_lists_those_that_do() -> None:
    with pytest.raises(UnknownNameError, match=r"channel 'postion' .*did you mean 'position'.*command, position"):
        recording().channel("postion")
    with pytest.raises(UnknownNameError, match=r"label 'elbow' .*hip, knee"):
        channel().column("elbow")


def test_select_gives_the_columns_in_the_order_asked_for() -> None:
    swapped = channel().select(["knee", "hip"])
    assert np.array_equal(swapped.column("knee"), channel().column("knee"))
    assert np.array_equal(swapped.values, channel().values[:, ::-1])


def test_interpolation_is_exact_for_lines_and_missing_outside() -> None:
    line = Channel("position", ("hip",), "rad", TIME, 3.0 * TIME[:, None] - 1.0)
    assert line.at([0.25, 1.234])[:, 0] == pytest.approx([-0.25, 2.702])
    assert np.isnan(line.at([-0.1, 2.5])).all()


def test_a_held_command_stays_in_force_until_the_next_one() -> None:
    command = Channel("command", ("hip",), "rad", [0.0, 1.0, 2.0], [[5.0], [6.0], [7.0]])  # pyright: ignore
    assert command.at([-1.0, 0.0, 0.999, 1.0, 1.5, 9.0], hold=True)[:, 0].tolist() == [5.0, 5.0, 5.0, 6.0, 6.0, 7.0]


def test_an_instant_that_differs_by_rounding_is_the_same_instant() -> None:
    command = Channel("command", ("hip",), "rad", TIME, np.arange(20.0)[:, None])
    assert np.array_equal(command.at(TIME - 1e-13, hold=True), command.values)
    assert not np.isnan(command.at([TIME[-1] + 1e-13])).any()


def test_a_missing_sample_is_not_made_up() -> None:
    gap = Channel("position", ("hip",), "rad", [0.0, 1.0, 2.0, 3.0], [[0.0], [np.nan], [2.0], [3.0]])  # pyright: ignore
    assert np.isnan(gap.at([0.5, 1.5])).all()
    assert gap.at([2.0, 2.5])[:, 0] == pytest.approx([2.0, 2.5])


@given(st.floats(0.0, 1.9), st.floats(0.0, 1.9))
def test_slices_keep_the_samples_inside_and_everything_else(a: float, b: float) -> None:
    start, stop = sorted((a, b))
    whole = recording()
    inside = TIME[(start - 1e-9 <= TIME) & (stop + 1e-9 >= TIME)]
    if not inside.size:
        return
    part = whole.slice(start, stop)
    assert np.array_equal(part.time, inside)
    assert list(part.channels) == list(whole.channels)
    assert part.provenance == whole.provenance
    assert part.channel("position").unit == "rad"


def test_a_slice_between_two_commands_keeps_the_one_in_force() -> None:
    rare = Channel("command", ("hip",), "rad", [0.0, 1.5], [[1.0], [2.0]])  # pyright: ignore
    part = recording(rare, channel()).slice(0.55, 1.2)
    assert part.channel("command").values[:, 0].tolist() == [1.0]
    assert part.channel("command").at(part.time, hold=True)[:, 0] == pytest.approx(1.0)


def test_a_command_that_is_missing_is_the_last_one_sent() -> None:
    nan = np.nan
    rare = Channel("command", ("hip", "knee"), "rad", np.arange(4.0), [[nan, 5.0], [1.0, nan], [nan, 6.0], [2.0, nan]])  # pyright: ignore
    held = rare.at([0.5, 1.5, 2.5, 3.5], hold=True)
    assert held.tolist() == [[1.0, 5.0], [1.0, 5.0], [1.0, 6.0], [2.0, 6.0]]
    part = recording(rare, channel(time=np.arange(4.0))).slice(2.0, 3.0)
    assert part.channel("command").values[0].tolist() == [1.0, 6.0]
    never = Channel("command", ("hip",), "rad", np.arange(2.0), [[nan], [nan]])  # pyright: ignore
    assert np.isnan(never.at([0.5], hold=True)).all()


def test_a_channel_without_samples_in_a_slice_is_named() -> None:
    rare = Channel("temperature", ("hip",), "K", [0.0], [[300.0]])  # pyright: ignore
    part = recording(channel(), rare).slice(1.0, 1.5)
    assert not part.has("temperature")
    assert "temperature" in part.provenance["warnings"]


def test_a_slice_where_nothing_was_recorded_says_how_long_the_recording_is() -> None:
    with pytest.raises(RecordingError, match=r"no samples from 5 to 6 s; it lasts from 0 to 1.9 s"):
        recording().slice(5.0, 6.0)


def test_resampling_brings_all_channels_to_common_instants() -> None:
    slow = channel("command", TIME[::2])
    both = recording(slow, channel()).resample(50.0)
    assert np.array_equal(both.channel("command").time, both.channel("position").time)
    assert np.diff(both.time) == pytest.approx(0.02)
    assert both.time[-1] == pytest.approx(1.9)
    assert set(both.channel("command").values[:, 0]) == set(slow.values[:, 0])  # held, never blended
    assert both.channel("position").column("hip") == pytest.approx(np.sin(both.time), abs=2e-3)


def test_resampling_at_its_own_instants_changes_nothing() -> None:
    again = recording().resample(TIME)
    assert np.array_equal(again.channel("position").values, channel().values)


@pytest.mark.parametrize("rate", [0.0, -5.0, np.nan, np.inf])
def test_an_impossible_rate_is_refused(rate: float) -> None:
    with pytest.raises(RecordingError, match="must be positive"):
        recording().resample(rate)


def test_aligning_moves_only_the_channels_named() -> None:
    moved = recording().align({"command": 0.25})
    assert moved.channel("command").time == pytest.approx(TIME + 0.25)
    assert np.array_equal(moved.channel("position").time, TIME)
    with pytest.raises(UnknownNameError, match="channel 'torque'"):
        recording().align({"torque": 1.0})


def test_renaming_reaches_every_channel() -> None:
    renamed = recording().rename({"hip": "FL_hip"})
    assert {c.labels for c in renamed.channels.values()} == {("FL_hip", "knee")}
    with pytest.raises(UnknownNameError, match="label 'ankle'"):
        recording().rename({"ankle": "x"})


def test_adding_and_removing_channels_gives_new_recordings() -> None:
    whole = recording()
    assert whole.without("command").with_channel(channel("torque")).channels.keys() == {"position", "torque"}
    assert whole.channels.keys() == {"command", "position"}
    with pytest.raises(RecordingError, match="no channels"):
        whole.without("command").without("position")


def test_the_clock_of_a_recording_is_that_of_its_positions() -> None:
    both = recording(channel("command", TIME[::2]), channel())
    assert np.array_equal(both.time, TIME)
    assert (both.start, both.stop, both.duration) == pytest.approx((0.0, 1.9, 1.9))


def test_a_recording_survives_a_trip_to_another_process() -> None:
    copy = pickle.loads(pickle.dumps(recording()))
    assert np.array_equal(copy.channel("position").values, channel().values)
    assert dict(copy.provenance) == {"source": "robot"}


def test_a_heading_that_was_logged_between_minus_and_plus_pi_has_no_jumps_and_is_read_off_between_samples() -> None:
    turning = np.linspace(3.0, -9.0, 60)
    logged = np.angle(np.exp(1j * turning))
    logged[7] = np.nan
    heading = Channel("heading", ("heading",), "rad", np.arange(60.0), logged)
    known = np.isfinite(logged)
    np.testing.assert_allclose(heading.values[known, 0], turning[known], atol=1e-12)
    between = heading.at(np.arange(8.0, 59.0) + 0.5)[:, 0]
    np.testing.assert_allclose(between, 0.5 * (turning[8:-1] + turning[9:]), atol=1e-12)
    assert heading.replace(labels=("yaw",)).values is heading.values  # whole already: copies share it


def test_positions_of_joints_and_headings_in_degrees_are_kept_as_they_are() -> None:
    values = np.array([[3.1], [-3.1], [3.1]])
    for name, unit in (("position", "rad"), ("heading", "deg")):
        np.testing.assert_array_equal(Channel(name, ("a",), unit, np.arange(3.0), values).values, values)
