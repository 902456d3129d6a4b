# SPDX-License-Identifier: Apache-2.0
"""A robot of several drivers: joints that were logged by topics and clocks of their own are the robot's, too."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.inspection.scattered import gathered, seen_apart
from trueup.recording import Channel, Recording

ARM, FINGER = np.arange(0.0, 2.0, 0.01), np.arange(0.004, 2.0, 0.033)


def _log() -> Recording:
    channels = [
        Channel("position", ("hip",), "rad", ARM, np.sin(ARM)),
        Channel("position_gripper", ("finger", "palm"), "m", FINGER, np.stack([FINGER, FINGER], axis=1)),
        Channel("position_filtered", ("hip",), "rad", ARM, np.cos(ARM)),
        Channel("command", ("hip",), "rad", ARM, np.sin(ARM)),
        Channel("command_gripper", ("finger",), "m", FINGER[::20], FINGER[::20]),
        Channel("command_velocity", ("finger",), "m/s", FINGER, FINGER),
    ]
    return Recording("log", {c.name: c for c in channels})


def test_a_gripper_of_its_own_topic_is_measured_where_it_was() -> None:
    (run,), (note,) = gathered([_log()], ["hip", "finger"])
    position = run.channel("position")
    assert (position.labels, position.units) == (("hip", "finger"), ("rad", "m"))
    seen = np.isfinite(position.column("finger"))
    assert seen.sum() == pytest.approx(len(FINGER), abs=1)
    np.testing.assert_allclose(position.column("finger")[seen], ARM[seen])
    assert run.channel("position_gripper").labels == ("palm",)
    assert run.channel("position_filtered").labels == ("hip",)
    assert "finger from position_gripper" in note
    assert seen_apart([run]) == ("finger",)


def test_in_between_it_is_filled_where_that_is_asked_for() -> None:
    (run,), _ = gathered([_log()], ["hip", "finger"], filled=True)
    finger = run.channel("position").column("finger")
    np.testing.assert_allclose(finger[1:190], ARM[1:190])


def test_its_commands_stay_in_force_and_other_kinds_are_no_positions() -> None:
    (run,), _ = gathered([_log()], ["hip", "finger"])
    command = run.channel("command")
    assert command.labels == ("hip", "finger")
    np.testing.assert_allclose(command.at([0.5, 1.0], hold=True), [[np.sin(0.5), FINGER[0]], [np.sin(1.0), FINGER[20]]])
    assert run.has("command_velocity")


def test_joints_that_the_model_lacks_stay_where_they_are() -> None:
    (run,), notes = gathered([_log()], ["hip"])
    assert run.channel("position").labels == ("hip",)
    assert notes == []
    assert seen_apart([run]) == ()


def test_angles_that_are_labelled_as_a_joint_are_its_position_whatever_they_are_called() -> None:
    camera = Channel("camera", ("sway",), "rad", FINGER, FINGER)
    others = [Channel("light", ("lamp",), "rad", FINGER, FINGER), Channel("spin", ("sway",), "rad/s", FINGER, FINGER)]
    log = Recording("log", {**_log().channels, **{c.name: c for c in (camera, *others)}}, {})
    (run,), (note,) = gathered([log], ["hip", "finger", "sway"])
    seen = run.channel("position").column("sway")
    np.testing.assert_allclose(seen[np.isfinite(seen)], ARM[np.isfinite(seen)])
    assert "sway from camera" in note
    assert {"light", "spin"} <= run.channels.keys()


@pytest.mark.parametrize(("times", "labels"), [(1.0, ("hip", "finger")), (1000.0, ("hip",))])
def test_numbers_without_a_unit_are_read_with_the_others_where_they_may_be_theirs(
    times: float, labels: tuple[str, ...]
) -> None:
    channels = _log().channels
    gripper = channels["position_gripper"].replace(unit="", values=times * channels["position_gripper"].values)
    (run,), (note,) = gathered([_log().with_channel(gripper)], ["hip", "finger"])
    assert run.channel("position").labels == labels
    assert ("nothing says the unit of finger" in note) == ("finger" in labels)
