# SPDX-License-Identifier: Apache-2.0
"""A servo on a bench: what it moves, and recordings of it as arrays that are replayed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup import files
from trueup.arrays import Array, Mask
from trueup.articulated.gains import Gains
from trueup.errors import ParameterError, RecordingError, unknown_name
from trueup.inspection.repeats import LONGEST_GAP
from trueup.inspection.settings import at_other_voltages, with_steady_gains
from trueup.inspection.suspicions import at_odds
from trueup.instant import usual_step
from trueup.noise import estimate_noise
from trueup.recording import Channel, Recording, warnings_of
from trueup.rounding import TINY
from trueup.samples import between, held_integral, in_force
from trueup.trial import ENABLED, command_of
from trueup.typed_toml import build
from trueup.units import GRAVITY

_AROUND = 0.04  # s that a line is laid through to know position and speed at an instant
_OUTPUTS = ("torque", "current", "load", "effort", "pwm", "duty", "present_load", "present_current", "present_pwm")
"""Channels that may show what the servo gives; the first that is there."""
_LONGEST = 10.0
"""m: no servo swings a longer pendulum; a length in mm or cm is beyond it."""


@dataclass(frozen=True)
class Bench:
    """What the servo moves about its axis, SI units. NaN is unknown."""

    mass: float = float("nan")
    """kg."""
    length: float = float("nan")
    """m, from the axis to the centre of mass."""
    arm_mass: float = 0.0
    """kg of a uniform rod between the axis and the mass, which comes on top of it."""
    inertia: float = 0.0
    """kg m2: about the centre of mass where mass and length are given, else about the axis."""
    hangs_at: float = 0.0
    """rad, position of the joint at which the centre of mass hangs straight down."""
    gravity: float = GRAVITY
    """m/s2, across the axis: 0 where the axis is vertical."""

    def __post_init__(self) -> None:
        """Raises ParameterError for what cannot be."""
        for name in ("mass", "length", "arm_mass", "inertia", "gravity"):
            if getattr(self, name) < 0.0:
                raise ParameterError(f"bench: {name} is {getattr(self, name):g}; it cannot be below zero")
        if np.isnan(self.mass) != np.isnan(self.length):
            given = "mass" if np.isnan(self.length) else "length"
            raise ParameterError(f"bench: {given} is given alone; a pendulum needs mass (kg) and length (m)")
        if self.length > _LONGEST:
            raise ParameterError(
                f"bench: length is {self.length:g} m; is that mm or cm? Lengths are in m, masses in kg"
            )
        if self.arm_mass > 0.0 and np.isnan(self.mass):
            raise ParameterError("bench: arm_mass is given alone; a pendulum needs mass (kg) and length (m), too")

    @property
    def known(self) -> bool:
        """Whether torques can be told in N m: without mass or inertia only their ratios can."""
        return self.moment > 0.0 or self.about_axis > 0.0

    @property
    def moment(self) -> float:
        """Largest torque of gravity in N m."""
        return 0.0 if np.isnan(self.mass) else (self.mass + self.arm_mass / 2.0) * self.length * self.gravity

    @property
    def about_axis(self) -> float:
        """Inertia in kg m2 about the axis."""
        return self.inertia + (0.0 if np.isnan(self.mass) else (self.mass + self.arm_mass / 3.0) * self.length**2)

    @property
    def as_one(self) -> Bench:
        """The same load as one body: mass and arm together, about their common centre of mass."""
        if self.arm_mass == 0.0:
            return self
        mass = self.mass + self.arm_mass
        length = (self.mass + self.arm_mass / 2.0) / mass * self.length
        return replace(self, mass=mass, length=length, arm_mass=0.0, inertia=self.about_axis - mass * length**2)

    @property
    def in_words(self) -> str:
        """Such as "0.5 kg at 0.15 m, on an arm of 0.05 kg"."""
        arm = f", on an arm of {self.arm_mass:g} kg" if self.arm_mass > 0.0 else ""
        return f"{self.mass:g} kg at {self.length:g} m{arm}"

    @classmethod
    def read(cls, path: Path) -> Bench:
        """From a TOML file with these names. Raises ParameterError."""
        return build(cls, files.toml(path, ParameterError), str(path), ParameterError)

    def named_by(self, recording: Recording) -> dict[str, float]:
        """Mass, length and mass of the arm that a recording names beside its signals and that are not known here."""
        if not np.isnan(self.mass) or self.inertia > 0.0:
            return {}
        found = {}
        for name in ("mass", "length", "arm_mass"):
            try:
                found[name] = float(recording.provenance[name])
            except (KeyError, ValueError):
                continue
        found = {name: value for name, value in found.items() if np.isfinite(value)}
        return found if {"mass", "length"} <= found.keys() else {}


@dataclass(frozen=True, eq=False)
class Run:
    """One recording of the servo, ready to be replayed; times in s since its start."""

    name: str
    bench: Bench
    gain: float
    """The servo's proportional setting over the one that the model stands for."""
    command_time: Array
    command: Array
    """(n,) held from then on; where the motor is off, the last one before."""
    integral: Array
    on: Mask
    """(n,) whether the motor is."""
    time: Array
    position: Array
    """(T,) rad, as measured."""
    smooth: Array
    """(T, 2) position and speed, by lines through the samples around."""
    noise: float
    output: Array
    """(T,) what a channel shows of the servo's output, in a unit of its own; empty where none does."""

    def hung(self, hangs_at: float | None) -> Run:
        """The same with its load hanging at `hangs_at` rad; None: as it is said to hang."""
        return self if hangs_at is None else replace(self, bench=replace(self.bench, hangs_at=hangs_at))

    def states(self, time: Array) -> Array:
        """(k, 2) position and speed as measured at `time` (k,)."""
        return between(time, self.time, self.smooth)

    def given(self, time: Array) -> NDArray[np.intp]:
        """(k,) the number of the command in force at `time` (k,); before the first it is the first."""
        return np.maximum(np.searchsorted(self.command_time, time, side="right") - 1, 0)

    @property
    def driven(self) -> Mask:
        """(T,) whether the motor is on."""
        return self.on[self.given(self.time)]


def runs_of(recordings: Sequence[Recording], bench: Bench, joint: str = "") -> tuple[list[Run], Gains, list[str]]:
    """Recordings as runs, the settings of the servo that they name, and notes.

    Raises RecordingError where there is no command or position, or one is told with another sign or in another unit than the
    other, UnknownNameError for another joint, ParameterError where recordings name impossible loads.
    """
    if odds := at_odds(recordings):
        raise RecordingError(odds[0])
    read = [sentence for recording in recordings for sentence in warnings_of(recording)]
    recordings, notes = with_steady_gains(recordings)
    gains, named = Gains.named_by(recordings, quantities=("kp",))
    notes += read + named + at_other_voltages(recordings)
    runs = [_run(r, bench, gains, joint) for r in recordings]
    if any(b.bench != bench for b in runs):
        said = sorted({b.bench.in_words for b in runs})
        notes.append(f"the recordings name what the servo carries: {'; '.join(said)}")
    if any(not r.on.all() for r in runs):
        notes.append("stretches with the motor off are replayed too: they show friction without the motor")
    unsaid = [_uncommanded(run) for run, r in zip(runs, recordings, strict=True) if not r.has(ENABLED)]
    notes += [sentence for sentence in unsaid if sentence]
    return runs, gains, notes


def _uncommanded(run: Run) -> str:
    """A sentence on the longest stretch of a log without a command, where it has one in every sample else; "" without any."""
    stamps = np.append(run.command_time, run.time[-1])
    gaps = np.diff(stamps)
    k = int(np.argmax(gaps))
    if gaps[k] < LONGEST_GAP or np.median(gaps) > 2.0 * usual_step(run.time):
        return ""
    return (
        f"recording '{run.name}' has no command from {stamps[k]:.3g} to {stamps[k + 1]:.3g} s: the one before is taken to "
        f"hold; if the motor was off there, add a column '{ENABLED}' that is 0"
    )


def _run(recording: Recording, bench: Bench, gains: Gains, joint: str) -> Run:
    told = command_of(recording)
    if told is None or not recording.has("position"):
        lacking = "command" if told is None else "position"
        raise RecordingError(f"recording '{recording.name}' has no {lacking}; its channels are: "
                             f"{', '.join(recording.channels)}")  # fmt: skip
    position = recording.channel("position")
    shared = [x for x in told.labels if x in position.labels]
    if joint and joint not in shared:
        raise unknown_name("joint", joint, shared, f"recording '{recording.name}'")
    if not joint and len(shared) != 1:
        raise RecordingError(
            f"recording '{recording.name}' has {len(shared)} joints with command and position "
            f"({', '.join(shared) or 'none'}); say which with --joint"
        )
    label = joint or shared[0]
    _check_angles(recording, label, (position, told))
    measured, command = position.column(label), told.column(label)
    good = np.isfinite(measured)
    if good.sum() < 10:
        raise RecordingError(f"recording '{recording.name}': {good.sum()} positions of '{label}'; ten are needed")
    zero = position.time[good][0]
    time, measured = position.time[good] - zero, measured[good]
    on = np.isfinite(command) & _enabled(recording, told.time)
    if not np.isfinite(command).any():
        raise RecordingError(f"recording '{recording.name}': no command of '{label}' is ever given")
    held = in_force(command[:, None])[:, 0]
    noise = float(estimate_noise(measured, time)[0])
    carried = replace(bench, **bench.named_by(recording))
    gain = gains.factor("kp", recording.name, label)
    return Run(
        recording.name, carried, gain, told.time - zero, held, held_integral(told.time, held[:, None])[:, 0], on, time,
        measured, _lines(time, measured), noise if noise > 0.0 else 1e-6, _output(recording, position.time[good], label),
    )  # fmt: skip


def _check_angles(recording: Recording, label: str, channels: Sequence[Channel]) -> None:
    """Raises RecordingError for numbers of which nobody knows how many rad they are: a law would be fitted to any."""
    for channel in channels:
        if (unit := channel.unit_of(label)) != "rad":
            most = np.nanmax(np.abs(channel.column(label)))
            raise RecordingError(
                f"recording '{recording.name}': {channel.name} of '{label}', which reaches {most:.4g}, has "
                f"{f'the unit {unit}, which is no angle' if unit else 'no unit'}: say in the mapping what it is "
                '(trueup inspect writes one): "deg", "rev", ..., with scale and offset for counts of an encoder'
            )


def _lines(time: Array, position: Array) -> Array:
    """(T, 2) place and slope at each sample of the line through the samples around."""
    n = np.arange(len(time))
    first = np.minimum(np.searchsorted(time, time - 0.5 * _AROUND), np.maximum(n - 1, 0))
    last = np.maximum(np.searchsorted(time, time + 0.5 * _AROUND, side="right"), np.minimum(n + 2, len(time)))
    sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (time, position, time**2, time * position)]
    t, q, tt, tq = (s[last] - s[first] for s in sums)
    count = last - first
    slope = (tq - t * q / count) / np.maximum(tt - t**2 / count, TINY)
    return np.stack([q / count + slope * (time - t / count), slope], axis=1)


def _enabled(recording: Recording, time: Array) -> Mask:
    if not recording.has(ENABLED):
        return np.ones(len(time), dtype=bool)
    return np.nan_to_num(recording.channel(ENABLED).at(time, hold=True)[:, 0]) != 0.0


def _output(recording: Recording, time: Array, label: str) -> Array:
    """(T,) samples of the first channel of the servo's output; numbers that wrapped below zero at 16 bits are unwrapped."""
    for name in _OUTPUTS:
        if not recording.has(name):
            continue
        channel = recording.channel(name)
        if label not in channel.labels and len(channel.labels) != 1:
            continue
        raw = channel.column(label if label in channel.labels else channel.labels[0])
        if 60000.0 < np.nanmax(raw) < 65536.0:  # before it is interpolated
            raw = np.where(raw > 32767.0, raw - 65536.0, raw)
        return channel.replace(values=raw[:, None], labels=(label,), units=()).at(time)[:, 0]
    return np.zeros(0)
