# SPDX-License-Identifier: Apache-2.0
"""What a log says that drove the car, as throttle and steering: from pedals, topics of their own, speeds or turn rates."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.instant import HARDLY
from trueup.recording import Channel, Recording, is_command
from trueup.rounding import ROUNDED
from trueup.trial import command_of
from trueup.units import AS_FAR

COMMAND = ("throttle", "steering")
"""Labels of the command channel: both without unit, usually -1 ... 1."""

TOGETHER = (
    "put the files of one drive into one folder, drives/d1/cmd.csv and drives/d1/pose.csv, and give the folder drives"
)
"""How files that hold a part of one drive each become one recording."""
BEYOND: Mapping[str, str] = MappingProxyType({
    "sideways": "a speed sideways, as of mecanum, omni or swerve wheels",
    "rear_steering": "an angle of the rear wheels too, as of steering on four wheels",
    "apart": "another speed of wheels of one side, as of mecanum wheels",
})  # fmt: skip
"""Commands, by their labels, of what is not simulated: a vehicle goes ahead and back, and turns by its front wheels."""
_SWITCHES = ("safety", "enable", "enabled", "deadman", "armed")
_DRIVES, _STEERS = ("throttle", "speed"), ("steering", "curvature", "turn")


def driven_by(recording: Recording, wheelbase: float = 1.0) -> Channel:
    """Throttle and steering as recorded, from channels of their own too; a brake counts as throttle below zero.

    A commanded speed is a throttle too, and a turn rate beside it, or a curvature, the wheel angle (rad) with which a car of
    this wheelbase (m) would turn so, or itself with a wheelbase of 0. Raises RecordingError without them.
    """
    found = signals(recording)
    drive = next((found[label] for label in _DRIVES if label in found), None)
    steer = next((found[label] for label in _STEERS if label in found), None)
    if drive is None or steer is None or (drive is not found.get("speed") and steer is found.get("turn")):
        listed = ", ".join(found) or "none"
        apart = (
            "" if found else f" among {', '.join(recording.channels)} (for commands in a file of their own: {TOGETHER})"
        )
        if {"left", "right"} <= set(found) or {"left_duty", "right_duty"} <= set(found):
            raise RecordingError(
                f"recording '{recording.name}': a left and a right wheel are commanded; the file of a robot with two driven "
                "wheels says how far they are apart: [vehicle] track = 0.23 (m), and wheel_radius = 0.033 (m) where they "
                "are told how fast to turn"
            )
        raise RecordingError(
            f"recording '{recording.name}': a car's command needs the labels throttle (or speed) and steering (or turn, a "
            f"turn rate beside a speed); found: {listed}{apart}. Name their columns in the mapping (`trueup inspect LOG "
            "--model CAR.toml --force` writes one of what drives a vehicle): [channels.command] "
            'columns = ["...", "..."], labels = ["speed", "steering"], units = ["m/s", "rad"]; of a robot with two driven '
            'wheels labels = ["speed", "turn"], units = ["m/s", "rad/s"], or labels = ["left", "right"], unit = "m/s" '
            '(["left_duty", "right_duty"] of PWM; of four wheels ["left", "right", "rear_left", "rear_right"]). '
            "What drives sideways too (three omni wheels, mecanum), or bends in its middle (articulated loaders: "
            "bending turns them as they stand, too), is not simulated"
        )
    for label, beside in (("sideways", drive), ("rear_steering", steer)):
        if label in found:
            refuse_beyond(recording, label, found[label], beside)
    parts = [drive, steer, *([found["brake"]] if "brake" in found else [])]
    same = all(p.time is drive.time or np.array_equal(p.time, drive.time) for p in parts)
    time = drive.time if same else np.unique(np.concatenate([p.time for p in parts]))
    throttle, steering, *brake = (held(p, time) for p in parts)
    turned = steer in (found.get("turn"), found.get("curvature")) and wheelbase > 0.0
    if turned and steer is found.get("turn"):
        moving = np.abs(throttle) > HARDLY * np.nanmax(np.abs(throttle), initial=0.0)
        steering = np.where(moving, steering / np.where(moving, throttle, 1.0), 0.0)
    steering = np.arctan(wheelbase * steering) if turned else steering
    throttle = throttle - brake[0] if brake else throttle
    units = (drive.unit_of(drive.labels[0]), "rad" if turned else steer.unit_of(steer.labels[0]))
    return Channel("command", COMMAND, "", time, np.stack([throttle, steering], axis=1), units if any(units) else ())


def refuse_beyond(recording: Recording, label: str, given: Channel, beside: Channel) -> None:
    """Raises RecordingError where `given` commands what is not simulated (`BEYOND`), and is not as good as nothing `beside`
    what is.
    """
    usual, most = (float(np.nanmax(np.abs(c.values), initial=0.0)) for c in (beside, given))
    if most <= HARDLY * usual:
        return
    name = given.labels[0]
    raise RecordingError(
        f"recording '{recording.name}': {BEYOND[label]}, is commanded, up to {most:.3g} {given.unit_of(name)}".rstrip()
        + "; a vehicle is simulated that goes ahead and back and turns by its front wheels, or by two driven ones. Give "
        f"drives in which that stays zero, or leave '{name}' and its column out of [channels.command] in the mapping where "
        "it does nothing"
    )


def refuse_another_range(
    recording: Recording, middle: tuple[float, float], full: tuple[float, float] | None, wheelbase: float = 1.0
) -> None:
    """Raises RecordingError where commands without a unit cannot be those that stand for zero at `middle`, for one at `full`
    beyond: they go far past one, or are shares of which a car would not move. `full` is None before a calibration.
    """
    if full is None:
        return
    command = driven_by(recording, wheelbase)
    if command.units or not np.isfinite(command.values).any():
        return
    sent = np.where((command.values == 0.0) & (np.abs(middle) > np.abs(full)), np.nan, command.values)
    largest = np.nanmax(np.abs(sent - middle) / np.abs(full), axis=0, initial=0.0)
    shares = 0.0 < float(np.nanmax(np.abs(command.values))) <= AS_FAR
    if not (largest > AS_FAR).any() and not (shares and (largest <= HARDLY).all()):
        return
    reach = " and ".join(
        f"{label} goes from {low:.4g} to {high:.4g} ({m - abs(f):.4g} to {m + abs(f):.4g} in the file)"
        for label, low, high, m, f in zip(
            COMMAND, np.nanmin(command.values, axis=0), np.nanmax(command.values, axis=0), middle, full, strict=True
        )
    )
    raise RecordingError(
        f"recording '{recording.name}': its commands are in another unit than those that the car's file was calibrated with; "
        f"{reach}. Say in the mapping's [channels.command] the scale and offset that bring them there (and sign, where "
        "steering grows to the other side), or calibrate with such logs"
    )


def by_unsteered_axle(recording: Recording) -> Recording:
    """A prepared recording of a vehicle whose steered wheel is told a speed (a tricycle's, a fork lift's): with the speed of
    its unsteered axle, which is less by the cosine of the angle.
    """
    command = recording.channel("command").select(COMMAND)
    values = np.array(command.values)
    values[:, 0] *= np.cos(values[:, 1])
    return recording.with_channel(command.replace(values=values))


def told_to_turn(recording: Recording) -> bool:
    """Whether a turn rate is commanded beside a speed, and no steering."""
    found = set(signals(recording))
    return {"speed", "turn"} <= found and not {"steering", "throttle"} & found


def turned_on_the_spot(recording: Recording) -> float:
    """Share of the samples at which a robot commanded by speed and turn rate was told to turn without going on."""
    if not told_to_turn(recording):
        return 0.0
    found = signals(recording)
    time = found["turn"].time
    turns, speeds = (np.abs(held(found[label], time)) for label in ("turn", "speed"))
    most = [max(float(np.nanmax(x, initial=0.0)), ROUNDED) for x in (turns, speeds)]
    return float(np.mean((turns > HARDLY * most[0]) & (speeds <= HARDLY * most[1])))


def signals(recording: Recording) -> dict[str, Channel]:
    """What is commanded, by label: that of the command channel, else of channels that hold a part of it."""
    whole = command_of(recording)
    channels = [whole] if whole is not None else []
    channels += [c for name, c in recording.channels.items() if is_command(name) and name != "command_sent"]
    found: dict[str, Channel] = {}
    for channel in channels:
        for label in channel.labels:
            found.setdefault(label, channel.select((label,)))
    return found


def held(channel: Channel, time: Array) -> Array:
    """(T,) a signal at other times: each command stays in force until the next; before the first one it is zero."""
    if channel.time is time:
        return channel.values[:, 0]
    values = channel.at(time, hold=True)[:, 0]
    return np.where(time < channel.time[0], 0.0, values)


def effective(
    recording: Recording,
    enabled_by: str,
    middle: tuple[float, float],
    full: tuple[float, float] | None,
    wheelbase: float = 1.0,
) -> Channel:
    """The commands as shares, throttle zero while the switch was off. Raises RecordingError where there are none."""
    command = driven_by(recording, wheelbase)
    if full is not None:  # a pulse of no width is no command yet, not one far to the side
        sent = np.where((command.values == 0.0) & (np.abs(middle) > np.abs(full)), middle, command.values)
        command = command.replace(values=(sent - middle) / full)
    for label in (label for label in COMMAND if full is None and not command.unit_of(label)):
        largest = float(np.nanmax(np.abs(command.column(label)), initial=0.0))
        if largest > AS_FAR:
            raise RecordingError(
                f"recording '{recording.name}': {label} reaches {largest:.4g}; a car's commands are shares, -1 ... 1: say in "
                f"the mapping's [channels.command] scale = [...] with {1.0 / _round_up(largest):.3g} for {label} (and offset "
                "where the middle is not zero)"
            )
    switch = _switch(recording, enabled_by)
    if switch is None:
        return command
    values = np.array(command.values)
    values[:, 0] *= switch.at(command.time, hold=True)[:, 0] > 0.0
    return command.replace(values=values)


def _round_up(largest: float) -> float:
    """The full command that a largest value suggests: 30 is of 100, 1720 of 10000."""
    return float(10.0 ** np.ceil(np.log10(largest)))


def _switch(recording: Recording, enabled_by: str) -> Channel | None:
    for channel in recording.channels.values():
        for label in channel.labels:
            named = label == enabled_by if enabled_by else any(w in label.lower().split("_") for w in _SWITCHES)
            values = channel.column(label)
            if named and (enabled_by or set(np.unique(values[np.isfinite(values)])) == {0.0, 1.0}):
                return channel.select((label,))
    if enabled_by:
        raise RecordingError(f"recording '{recording.name}' has no signal '{enabled_by}', which enables the throttle")
    return None
