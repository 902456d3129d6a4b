# SPDX-License-Identifier: Apache-2.0
"""A guessed mapping as a model has it: its names of joints and sensors, and units that it or gravity tells."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.formats import ChannelColumns, ChannelMap
from trueup.inspection.joint_names import alike_names, match_joints, one_each, ways
from trueup.inspection.sensors import labels_of, sensed
from trueup.recording import Channel, Recording
from trueup.rounding import ROUNDED
from trueup.trial import COMMANDS
from trueup.units import size_of

_WRITTEN: Mapping[str, tuple[str, ...]] = {
    "rad": ("rad", "deg"), "m": ("m", "mm"), "rad/s": ("rad/s", "deg/s", "rev/s", "rpm"), "m/s^2": ("m/s^2", "g0"),
}  # fmt: skip
"""Units as which a model may take numbers, by what they become."""


def suited_to(
    model: str, guess: ChannelMap, recordings: Sequence[Recording], shown: Sequence[Recording]
) -> tuple[ChannelMap, list[str], list[str]]:
    """The guess for `recordings`, which are `shown` as the model takes them; notes; channels of which it now has the unit."""
    guess, sensors = _with_sensors(guess, recordings, model)
    guess, units = _with_units_seen(guess, recordings[0], shown[0], Path(model).name)
    return guess, [*sensors, *units.values()], list(units)


def _with_units_seen(
    guess: ChannelMap, read: Recording, seen: Recording, model: str
) -> tuple[ChannelMap, dict[str, str]]:
    """The guess with a unit for channels of which it knows none: that by which the numbers `read` were taken for what is
    `seen`. And what to say of each such channel, by its name.
    """
    channels, said = dict(guess.channels), {}
    for name, columns in guess.channels.items():
        unsaid = not columns.unit and not any(columns.units) and read.has(name) and seen.has(name)
        units = _units(read.channel(name), seen.channel(name)) if unsaid else ()
        if not units:
            continue
        channels[name] = _with(columns, units)
        each = {u: [x for x, unit in zip(seen.channel(name).labels, units, strict=True) if unit == u] for u in units}
        told = ", ".join(f"{unit} ({', '.join(labels)})" for unit, labels in each.items())
        why = f"the ranges of {model} make" if name in ("position", *COMMANDS) else "the numbers make"
        said[name] = f"{name}: no unit is said; {why} it {told}"
    return dataclasses.replace(guess, channels=channels), said


def _with(columns: ChannelColumns, units: Sequence[str]) -> ChannelColumns:
    if len(set(units)) == 1:
        return dataclasses.replace(columns, unit=units[0])
    return dataclasses.replace(columns, units=tuple(units))


def _units(read: Channel, seen: Channel) -> tuple[str, ...]:
    """The unit in which each column was written; () where it was scaled in another way, as shares of a range are."""
    if read.values.shape != seen.values.shape:
        return ()
    each = [_that_make(*columns, seen.unit_of(label)) for columns, label in _by_label(read, seen)]
    sure = {units[0] for units in each if len(units) == 1}
    # Nothing but zeros is in the unit of the others.
    return tuple(next((u for u in units if u in sure), units[0]) for units in each) if all(each) else ()


def _by_label(read: Channel, seen: Channel) -> list[tuple[tuple[Array, Array], str]]:
    return [((read.values[:, k], seen.values[:, k]), label) for k, label in enumerate(seen.labels)]


def _that_make(numbers: Array, values: Array, unit: str) -> list[str]:
    """The units in which `numbers` are these values in SI."""
    choices = _WRITTEN.get(unit, ())
    return [u for u in choices if np.allclose(numbers * size_of(u), values, ROUNDED, 0.0, equal_nan=True)]


def renamed(
    guess: ChannelMap, recordings: Sequence[Recording], drives: Mapping[str, str], others: Collection[str]
) -> tuple[ChannelMap, list[str]]:
    """The guess with names of the model's joints, apart for what was measured (gripper_width) and told (gripper); notes."""
    labels = [label for label in labelled(recordings) if label not in others]
    if all(label in drives for label in labels):
        return guess, []
    measured = [x for x in labels if any(r.has("position") and x in r.channel("position").labels for r in recordings)]
    several = alike_names([x for x in labels if x not in measured and x not in drives], list(others))
    labels = [label for label in labels if label not in several]
    parts = [match_joints(part, drives) for part in (measured, [x for x in labels if x not in measured]) if part]
    names = one_each({label: joint for found, _ in parts for label, joint in found.items()} | several, recordings)
    how = max((how for _, how in parts), default="by name")  # 'by order' where any is
    notes = [f"joints renamed {way}" for way in ways(names, how)]
    unknown = [label for label in labels if label not in names]
    if unknown:
        left = [j for j in (*drives, *others) if j not in names.values()]
        notes.append(
            f"no joint of the model was found for {', '.join(unknown)} (left are: {', '.join(left) or 'none'}): "
            "fill in [joints] in the mapping"
        )
    return dataclasses.replace(guess, joints=names), notes


def _with_sensors(guess: ChannelMap, recordings: Sequence[Recording], model: str) -> tuple[ChannelMap, list[str]]:
    """The guess with labels of the model's sensors for their axes, and what to say of it."""
    from trueup.engines.family import family_of

    family = family_of(model)
    found = sensed(recordings, family.sensors(family.load(Path(model))))
    channels = {
        name: dataclasses.replace(columns, labels=labels_of(found[name], columns.labels)) if name in found else columns
        for name, columns in guess.channels.items()
    }
    notes = [f"channel {name} is labelled as the model's sensor {sensor}" for name, sensor in found.items()]
    return dataclasses.replace(guess, channels=channels), notes


def labelled(recordings: Sequence[Recording]) -> list[str]:
    """What recordings call their joints."""
    names = ("position", "command", "command_sent")
    return list(dict.fromkeys(x for r in recordings for n in names if r.has(n) for x in r.channel(n).labels))


def drives_of(model: str) -> tuple[Mapping[str, str], tuple[str, ...]]:
    """A model's joints and what drives them, and drives of several joints."""
    from trueup.engines.family import family_of

    family = family_of(model)
    loaded = family.load(Path(model))
    return family.drives(loaded), family.others(loaded)
