# SPDX-License-Identifier: Apache-2.0
"""Positions without a unit are degrees where only that fits the joints' ranges; slides are in metres beside hinges."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from trueup import formats
from trueup.calibration import Replay, by_unit
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.setup.drives import suited
from trueup.errors import RecordingError
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_ARM = """<mujoco><worldbody><body><joint name="j" axis="0 1 0" range="-100 100"/><geom size=".05"/></body></worldbody>
<actuator><position joint="j"/></actuator></mujoco>"""


def test_counts_of_an_encoder_are_refused_with_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_ARM)
    time = np.arange(0.0, 2.0, 0.02)
    counts = np.round(2e5 * np.sin(3.0 * time))[:, None]
    run = Recording("run", {name: Channel(name, ("j",), "", time, counts) for name in ("position", "command")})
    with pytest.raises(RecordingError, match=r"'j', which reaches 2e\+05, is beyond its range .* counts of an encoder"):
        prepare(tmp_path / "arm.xml", [run])


def test_counts_of_a_joint_without_a_range_are_refused_beside_commands_in_rad_with_how_many_make_a_turn(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.xml").write_text(_ARM.replace('range="-100 100"', ""))
    time = np.arange(0.0, 4.0, 0.02)
    swing = 0.3 * np.sin(3.0 * time)[:, None]
    counts = np.round(0.97 * 8192 / (2.0 * np.pi) * 0.3 * np.sin(3.0 * (time - 0.02)))[:, None]
    run = Recording("run", {"command": Channel("command", ("j",), "rad", time, swing),
                            "position": Channel("position", ("j",), "", time, counts)})  # fmt: skip
    with pytest.raises(RecordingError, match=r"'j' moves 12\d\d times as far .* scale .* power of two: 8192"):
        prepare(tmp_path / "arm.xml", [run])


def test_counts_of_slides_and_of_joints_that_nothing_commands_are_refused_with_what_to_write(tmp_path: Path) -> None:
    cart = (
        '<mujoco><worldbody><body><joint name="s" type="slide" axis="1 0 0" range="-.5 .5"/><geom size=".05"/><body>'
        '<joint name="p" axis="0 1 0"/><geom size=".02" pos="0 0 -.2"/></body></body></worldbody>'
        '<actuator><motor joint="s"/></actuator></mujoco>'
    )
    (tmp_path / "cart.xml").write_text(cart)
    time = np.arange(0.0, 2.0, 0.02)
    push = Channel("command_torque", ("s",), "N", time, np.sin(3.0 * time)[:, None])
    counts = np.round(np.stack([12000.0 + 6000.0 * np.sin(3.0 * time), 1400.0 * np.sin(5.0 * time)], axis=1))

    def run(labels: tuple[str, ...], scale: float, unit: str = "") -> Recording:
        seen = Channel("position", ("s", "p"), unit, time, scale * counts).select(labels)
        return Recording("run", {c.name: c for c in (push, seen)})

    with pytest.raises(RecordingError, match=r"'s', which reaches 1\.8e\+04, is far beyond .* metres of one count"):
        suited(load(tmp_path / "cart.xml"), [run(("s", "p"), 1.0)])
    with pytest.raises(RecordingError, match=r"'p', which reaches 1\d\d\d, would turn many times"):
        suited(load(tmp_path / "cart.xml"), [run(("p",), 1.0)])
    for taken in (run(("s",), 2e-5), run(("s",), 0.02), run(("p",), 1e-3), run(("s",), 1.0, "m")):  # m, mm, rad, told
        suited(load(tmp_path / "cart.xml"), [taken])


def test_numbers_within_the_range_in_degrees_are_degrees(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_ARM)
    time = np.arange(0.0, 2.0, 0.02)
    swing = 90.0 * np.sin(3.0 * time)[:, None]
    channels = [Channel("position", ("j",), "", time, swing), Channel("command", ("j",), "", time, swing),
                Channel("velocity", ("j",), "", time, 3.0 * swing)]  # fmt: skip
    (found,), notes = suited(load(tmp_path / "arm.xml"), [Recording("run", {c.name: c for c in channels})])
    assert found.channel("position").unit == found.channel("command").unit == "rad"
    assert notes
    np.testing.assert_allclose(found.channel("command").values, np.radians(swing))
    np.testing.assert_allclose(found.channel("velocity").values, np.radians(3.0 * swing))


@pytest.mark.parametrize("degrees", [False, True])
def test_a_wheel_that_turns_on_and_on_says_no_unit_of_a_leg_that_stays_in_its_range(
    tmp_path: Path, degrees: bool
) -> None:
    wheel = '<body><joint name="w" axis="0 1 0"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "leg.xml").write_text(_ARM.replace("</worldbody>", wheel).replace("-100 100", "-60 60"))
    time = np.arange(0.0, 5.0, 0.02)
    values = np.stack([0.5 * np.sin(3.0 * time), 4.0 * time], axis=1)
    channel = Channel("position", ("j", "w"), "", time, np.degrees(values) if degrees else values)
    (found,), notes = suited(load(tmp_path / "leg.xml"), [Recording("run", {"position": channel})])
    np.testing.assert_allclose(found.channel("position").values, values)
    assert bool(notes) == degrees


def test_errors_of_hinges_and_slides_are_never_pooled(tmp_path: Path) -> None:
    slide = '<body><joint name="s" type="slide"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "arm.xml").write_text(_ARM.replace("</worldbody>", slide))
    time = np.arange(0.0, 1.0, 0.01)
    values = np.stack([np.sin(time), 0.01 * time], axis=1)
    channel = Channel("position", ("j", "s"), "rad", time, values)
    (run,), _ = suited(load(tmp_path / "arm.xml"), [Recording("run", {"position": channel})])
    assert [run.channel("position").unit_of(label) for label in ("j", "s")] == ["rad", "m"]
    assert run.channel("position").select(["s"]).units == ("m",)
    whole = Replay("run", False, "position", ("j", "s"), "rad", time, values, values + 0.2, values + np.array((0.1, 1e-3)),
                   noise=np.array([0.1, 0.001]))  # fmt: skip
    for replay in (
        whole,
        dataclasses.replace(whole, recording="run part 2"),
    ):  # a part that the calibration made itself
        hinge, slide_only = by_unit([replay], [run])
        assert (hinge.labels, hinge.unit, slide_only.labels, slide_only.unit) == (("j",), "rad", ("s",), "m")
        assert slide_only.rmse_after() == pytest.approx(0.001)
        assert slide_only.noise == pytest.approx(0.001)


@pytest.mark.parametrize(("whole", "unit"), [(1.0, "rad"), (100.0, "rad"), (100.0, "")])
def test_openings_of_a_gripper_in_shares_become_lengths(tmp_path: Path, whole: float, unit: str) -> None:
    finger = '<body><joint name="s" type="slide" range=".002 .037"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "arm.xml").write_text(_ARM.replace("</worldbody>", finger))
    time = np.arange(0.0, 1.0, 0.01)
    channel = Channel("position", ("j", "s"), unit, time, np.stack([time, whole * time], axis=1))
    barely = channel.replace(values=channel.values * [1.0, 0.01])
    (run, other), notes = suited(load(tmp_path / "arm.xml"), [Recording(n, {"position": c}) for n, c in
                                                        (("opens", channel), ("barely", barely))])  # fmt: skip
    np.testing.assert_allclose(run.channel("position").column("s"), 0.002 + 0.035 * time)
    np.testing.assert_allclose(other.channel("position").column("s"), 0.002 + 0.00035 * time)
    np.testing.assert_allclose(run.channel("position").column("j"), time)
    assert "shares of their joints' ranges" in notes[0]


@pytest.mark.parametrize("turned", [1.0, 60.0])  # hinges in rad, in degrees
def test_slides_without_a_unit_are_in_mm_where_only_that_fits_their_ranges(tmp_path: Path, turned: float) -> None:
    slides = (
        '<body><joint name="rail" type="slide" range="-.6 .6"/><geom size=".05"/></body>'
        '<body><joint name="finger" type="slide" range="0 .04"/><geom size=".01"/></body></worldbody>'
    )
    (tmp_path / "arm.xml").write_text(_ARM.replace("</worldbody>", slides))
    time = np.arange(0.0, 4.0, 0.02)
    values = np.stack([turned * np.sin(time), 200.0 * np.sin(time), 20.0 + 15.0 * np.sin(time)], axis=1)
    log = Recording("run", {c: Channel(c, ("j", "rail", "finger"), "", time, values) for c in ("position", "command")})
    (run,), notes = suited(load(tmp_path / "arm.xml"), [log])
    assert any("of rail, finger are taken as mm" in note for note in notes)
    assert not any("beyond its range" in note or "shares" in note for note in notes)
    for channel in (run.channel("position"), run.channel("command")):
        assert [channel.unit_of(label) for label in channel.labels] == ["rad", "m", "m"]
        np.testing.assert_allclose(channel.select(["rail", "finger"]).values, 1e-3 * values[:, 1:])


def test_a_slide_whose_unit_is_said_keeps_it_beside_hinges_whose_unit_is_told_from_their_ranges(tmp_path: Path) -> None:
    slide = '<body><joint name="s" type="slide" range="-.2 .2"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "arm.xml").write_text(_ARM.replace("</worldbody>", slide))
    rows = [f"{t:.2f},{90.0 * np.sin(3.0 * t):.3f},{90.0 + 9.0 * np.sin(t):.3f}" for t in np.arange(0.0, 2.0, 0.02)]
    (tmp_path / "log.csv").write_text("\n".join(["t,j_encoder,s_height_mm", *rows]))
    (log,) = formats.read(tmp_path / "log.csv")
    (run,), _ = suited(load(tmp_path / "arm.xml"), [log.rename({"s_height": "s"})])
    channel = run.channel("position")
    assert [channel.unit_of(label) for label in ("j", "s")] == ["rad", "m"]
    assert np.abs(channel.values).max(axis=0) == pytest.approx([np.pi / 2, 0.099], rel=0.01)


_TWO = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="a" axis="0 1 0" range="-2 2"/><geom size=".05"/>
<body><joint name="b" axis="0 1 0" range="-2 2"/><geom size=".05"/></body></body></worldbody>
<actuator><position joint="a"/><position joint="b"/></actuator></mujoco>"""


@pytest.mark.parametrize(("quiet", "mixed"), [(np.degrees(2.0 * np.pi / 4096), False), (2.0 * np.pi / 4096, True)])
def test_a_joint_in_rad_beside_one_in_degrees_is_told_from_one_that_hardly_moves(
    tmp_path: Path, quiet: float, mixed: bool
) -> None:
    (tmp_path / "arm.xml").write_text(_TWO)
    time, step = np.arange(0.0, 20.0, 0.02), np.array([np.degrees(2.0 * np.pi / 4096), quiet])
    values = step * np.round(np.stack([60.0 * np.sin(time), np.sin(0.7 * time)], axis=1) / step)
    channels = [Channel(name, ("a", "b"), "", time, values) for name in ("position", "command")]
    _, notes = suited(load(tmp_path / "arm.xml"), [Recording("run", {c.name: c for c in channels})])
    assert ('units = ["deg", "rad"]' in notes[0]) == mixed


@pytest.mark.parametrize(
    ("times", "edit"), [(-1.0, "sign = [1, -1] for one"), (180.0 / np.pi, 'units = ["rad", "deg"]')]
)
def test_a_joint_that_was_logged_otherwise_than_it_was_commanded_is_named_before_a_fit_with_what_to_write(
    tmp_path: Path, times: float, edit: str
) -> None:
    (tmp_path / "arm.xml").write_text(_TWO)
    time = np.arange(0.0, 4.0, 0.02)
    swing = np.stack([0.8 * np.sin(time), 0.3 * np.sin(0.7 * time)], axis=1)
    channels = [Channel("position", ("a", "b"), "rad", time, swing * [1.0, times]),
                Channel("command", ("a", "b"), "rad", time, swing)]  # fmt: skip
    _, notes = suited(load(tmp_path / "arm.xml"), [Recording("run", {c.name: c for c in channels})])
    assert any("command of b is about" in note and edit in note and "(run)" in note for note in notes)


def test_a_gripper_that_goes_nearly_all_of_its_way_in_mm_is_not_in_percent_of_it(tmp_path: Path) -> None:
    """Of 40 mm, 3 to 37: taken as percent it would never open by half. Percent of all of the way are no mm of it."""
    finger = '<body><joint name="s" type="slide" range="0 .04"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "arm.xml").write_text(_ARM.replace("</worldbody>", finger))
    time = np.arange(0.0, 1.0, 0.01)
    for values, metres in ((3.0 + 34.0 * time, 0.003 + 0.034 * time), (95.0 * time, 0.04 * 0.95 * time)):
        channel = Channel("position", ("j", "s"), "", time, np.stack([time, values], axis=1))
        (run,), _ = suited(load(tmp_path / "arm.xml"), [Recording("opens", {"position": channel})])
        np.testing.assert_allclose(run.channel("position").column("s"), metres)


def test_the_opening_of_two_fingers_is_named_where_the_joint_is_one_of_them(tmp_path: Path) -> None:
    finger = '<body><joint name="s" type="slide" range="0 .04"/><geom size=".05"/></body></worldbody>'
    (tmp_path / "arm.xml").write_text(_ARM.split("<actuator>")[0].replace("</worldbody>", finger) + "</mujoco>")
    channel = Channel("position", ("s",), "m", np.arange(0.0, 1.0, 0.01), 0.075 * np.arange(0.0, 1.0, 0.01)[:, None])
    opens = [Recording("opens", {"position": channel})]
    ready = prepare(tmp_path / "arm.xml", opens, propose=False, refuse=["ranges"])
    assert any("beyond its range" in note and "opening between two fingers" in note for note in ready.notes)
