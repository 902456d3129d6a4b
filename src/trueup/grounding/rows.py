# SPDX-License-Identifier: Apache-2.0
"""Recordings as rows to learn from: joints, commands and whatever else was measured in one frame, joints in the next.

A. Farchy, S. Barrett, P. MacAlpine and P. Stone, "Humanoid robots learning to walk faster: from the real world to
simulation and back", AAMAS 2013, section 4.3: 11 joints, 3 coordinates of the centre of mass and 11 commands in, 11 joints
out. Here these are whatever a robot's recordings have, and several past frames if wanted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Integers, Mask
from trueup.errors import GroundingError, counted, unknown_name
from trueup.grounding.frames import instants_of, measured_at, period_of
from trueup.grounding.others import others_of
from trueup.instant import MISSING
from trueup.noise import estimate_grid, estimate_noise, is_noise
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE
from trueup.trial import command_of

_ANGLES = {"base_orientation": ("roll", "pitch", "yaw")}  # channels that are seen whole or not at all


@dataclass(frozen=True)
class Inputs:
    """What goes into a prediction, in this order: joints, commands and other channels of a frame, then earlier frames."""

    joints: tuple[str, ...]
    """Whose positions go in."""
    commands: tuple[str, ...]
    """Joints whose commands go in, and whose next positions come out."""
    period: float
    """From one frame to the next, in s."""
    history: int = 1
    """Frames of joints and commands that go in, the present one included."""
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Other channels, each to the labels that go in, of the present frame."""
    unit: str = "rad"

    def __post_init__(self) -> None:
        """Raises GroundingError for a frame or a history that cannot be."""
        if not self.period > 0.0 or self.history < 1:  # `not >`: NaN is no period either
            raise GroundingError(
                f"a frame of {self.period:g} s and a history of {counted(self.history, 'frame')}: both must be above zero"
            )

    @property
    def looks_at(self) -> dict[str, tuple[str, ...]]:
        """Channels that a controller must see to predict, each to its labels."""
        return {"position": self.joints, **{n: _ANGLES.get(n, labels) for n, labels in self.others.items()}}

    @property
    def names(self) -> tuple[str, ...]:
        """(d,) of the inputs: 'position.knee', 'command.knee', 'com.z', 'position.knee 1 before'."""
        first = [f"position.{j}" for j in self.joints] + [f"command.{j}" for j in self.commands]
        more = [f"{channel}.{label}" for channel, labels in self.others.items() for label in labels]
        return (*first, *more, *(f"{name} {k} before" for k in range(1, self.history) for name in first))

    @property
    def blocks(self) -> dict[str, Integers]:
        """Columns that a run may be strange in: commands of all frames, each other channel of the present one.

        Where joints are, and were, is what simulator and robot differ in, and no part.
        """
        kinds = [name.split(".", 1)[0] for name in self.names]
        kinds = ["" if kind == "position" else kind for kind in kinds]
        return {kind: np.array([i for i, k in enumerate(kinds) if k == kind]) for kind in dict.fromkeys(kinds) if kind}

    @property
    def command_columns(self) -> slice:
        """Where the present commands stand."""
        return slice(len(self.joints), len(self.joints) + len(self.commands))

    @property
    def frames(self) -> list[int]:
        """Where each frame's joints stand, followed by its commands; the present one first."""
        both = len(self.joints) + len(self.commands)
        later = both + sum(len(labels) for labels in self.others.values())
        return [0, *(later + k * both for k in range(self.history - 1))]

    @property
    def position_columns(self) -> Integers:
        """(k,) which of the inputs is the present position of each output."""
        return np.array([self.joints.index(j) for j in self.commands])

    def other_channels(self, channels: Mapping[str, Array]) -> list[Array]:
        """(b, m) each: the other channels that go in, from those that `looks_at` asks for."""
        picked = ((n, labels, _ANGLES.get(n, labels)) for n, labels in self.others.items())
        return [channels[n][:, [every.index(x) for x in labels]] for n, labels, every in picked]

    def row(self, positions: Sequence[Array], commands: Sequence[Array], others: Sequence[Array] = ()) -> Array:
        """(b, d) inputs; positions (b, j) and commands (b, c) of the present frame, of the one before, ..."""
        past = [x for k in range(1, self.history) for x in (positions[k], commands[k])]
        return np.concatenate([positions[0], commands[0], *others, *past], axis=1)


@dataclass(frozen=True, eq=False)
class Rows:
    """N frames of several runs."""

    inputs: Inputs
    X: Array
    """(N, d) as `Inputs.names`."""
    Y: Array
    """(N, k) positions of the commanded joints one frame later."""
    run: Integers
    """(N,) number of the run."""
    frame: Integers
    """(N,) number of the frame within its run; one that follows another has the next number."""
    names: tuple[str, ...]
    """Of the runs."""
    spread: Array
    """(k,) standard deviation of each output in all runs."""
    noise: Array
    """(k,) of its measurement: no error below it can be told from none."""
    moves: Mask
    """(k,) which outputs move in some run: what stands still foretells itself, and counts in no average."""

    @property
    def held(self) -> Array:
        """(N, k) the present positions: what is predicted by holding the last value."""
        return self.X[:, self.inputs.position_columns]

    def inverse(self) -> Rows:
        """Rows that ask which command led to the next positions: these stand where the commands stood."""
        X = np.array(self.X)
        X[:, self.inputs.command_columns] = self.Y
        return replace(self, X=X, Y=np.array(self.X[:, self.inputs.command_columns]))

    def where(self, keep: Mask | Integers) -> Rows:
        """Some of the frames."""
        return replace(self, X=self.X[keep], Y=self.Y[keep], run=self.run[keep], frame=self.frame[keep])

    def thinned(self, most: int) -> Rows:
        """At most so many frames, evenly spread over all runs."""
        count = len(self.X)
        return self if count <= most else self.where(np.linspace(0, count - 1, most).round().astype(np.int64))


def inputs_of(
    recordings: Sequence[Recording], *, period: float | None = None, history: int = 1,
    others: Sequence[str] | None = None, joints: Sequence[str] | None = None,
) -> Inputs:  # fmt: skip
    """The inputs that all recordings have: joints that are commanded and measured, other channels (None: all of them).

    `period` in s (None: that of the recordings, but at least `FRAME`). Raises GroundingError and UnknownNameError.
    """
    if not recordings:
        raise GroundingError("there are no recordings to learn from")
    measured = _common([_labels(r, "position") for r in recordings])
    commanded = _common([_commanded(r) for r in recordings])
    both = [label for label in measured if label in commanded]
    without = [r.name for r in recordings if not _commanded(r)]
    if without and len(without) < len(recordings):
        raise GroundingError(
            f"no joint of {', '.join(without)} is commanded by angles and measured, as joints of the other "
            "recordings are: leave these recordings out, or say in a mapping which columns are their commands"
        )
    if not both:
        where = "the recording" if len(recordings) == 1 else f"all {len(recordings)} recordings"
        raise GroundingError(
            f"no joint is both commanded and measured in {where}; commanded are: {', '.join(commanded) or 'none'}; "
            f"measured are: {', '.join(measured) or 'none'}"
        )
    for name in joints or ():
        if name not in both:
            raise unknown_name("joint", name, both, "what is commanded and measured in all recordings")
    kept = tuple(joints or both)
    channels = others_of(recordings)
    for name in others or ():
        if name not in channels:
            raise unknown_name("channel", name, channels, "what may go in beside joints and commands")
    chosen = {n: x for n, x in channels.items() if others is None or n in others}
    unit = recordings[0].channel("position").unit_of(kept[0])
    went = tuple(j for j in measured if joints is None or j in kept)
    return Inputs(went, kept, period_of(recordings) if period is None else period, history, chosen, unit)


def rows_of(recordings: Sequence[Recording], inputs: Inputs) -> Rows:
    """All frames of all recordings that have a next one. Raises GroundingError where there is none, or no such input."""
    refuse_others(recordings, inputs)
    parts = [_rows(r, inputs) for r in recordings]
    if not sum(len(x) for x, _, _ in parts):
        longest = max(r.duration for r in recordings)
        raise GroundingError(
            f"no recording holds two frames of {1e3 * inputs.period:g} ms with all inputs; the longest lasts {longest:g} s"
        )
    X, Y, frame = (np.concatenate(each) for each in zip(*parts, strict=True))
    run = np.repeat(np.arange(len(parts)), [len(x) for x, _, _ in parts])
    found = [_noise_and_motion(r, inputs.commands) for r in recordings]
    noise = np.ma.median(np.ma.masked_invalid([each for each, _ in found]), axis=0).filled(0.0)
    spread = np.maximum(Y.std(axis=0), NEGLIGIBLE)
    moves = np.any([moving for _, moving in found], axis=0)
    return Rows(inputs, X, Y, run, frame.astype(np.int64), tuple(r.name for r in recordings), spread, noise, moves)


def refuse_others(recordings: Sequence[Recording], inputs: Inputs) -> None:
    """Raises GroundingError for recordings that lack an input."""
    for recording in recordings:
        wanted = {"position": inputs.joints, **inputs.others}
        there = {name: _labels(recording, name) for name in wanted}
        lacking = [f"{name} of {x}" for name, labels in wanted.items() for x in labels if x not in there[name]]
        lacking += [f"command of {x}" for x in inputs.commands if x not in _commanded(recording)]
        if lacking:
            has = "; ".join(f"{name} of {', '.join(labels) or 'nothing'}" for name, labels in there.items())
            raise GroundingError(
                f"recording '{recording.name}' has no {lacking[0]}, which goes into predictions; it has {has}; commands of "
                f"{', '.join(_commanded(recording)) or 'nothing'}. Leave it out, or name its columns in a mapping"
            )


def _noise_and_motion(recording: Recording, joints: Sequence[str]) -> tuple[Array, Mask]:
    """(k,) noise of joints in a recording, and which of them do more than that."""
    position = recording.channel("position").select(joints)
    grid = [estimate_grid(column) for column in position.values.T]
    noise = estimate_noise(position.values, position.time, grid)
    still = [is_noise(*each) for each in zip(position.values.T, noise.tolist(), grid, strict=True)]
    return noise, ~np.array(still)


def _rows(recording: Recording, inputs: Inputs) -> tuple[Array, Array, NDArray[np.intp]]:
    position = recording.channel("position").select(inputs.joints)
    command = command_of(recording)
    if command is None:
        raise GroundingError(f"recording '{recording.name}' holds no commands")
    instants = instants_of(recording, inputs.period)
    at, asked = measured_at(position, instants, inputs.period), command.select(inputs.commands).at(instants, hold=True)
    others = [
        measured_at(recording.channel(name).select(labels), instants, inputs.period)
        for name, labels in inputs.others.items()
    ]
    # Before its first frame a run stood as it stands there.
    back = [np.maximum(np.arange(len(instants)) - k, 0) for k in range(inputs.history)]
    X = inputs.row([at[k] for k in back], [asked[k] for k in back], others)[:-1]
    Y = at[1:, inputs.position_columns]
    whole = np.asarray(np.isfinite(np.concatenate([X, Y], axis=1)).all(axis=1))
    gap = np.diff(instants) > MISSING * inputs.period
    for k in range(inputs.history):  # a gap spoils the frames after it too, as far as they look back
        whole[k:] &= ~gap[: len(gap) - k]
    return X[whole], Y[whole], np.flatnonzero(whole)


def _labels(recording: Recording, channel: str) -> tuple[str, ...]:
    return recording.channel(channel).labels if recording.has(channel) else ()


def _commanded(recording: Recording) -> tuple[str, ...]:
    """Labels whose command is in the unit of their position: an angle for an angle, never a torque."""
    command = command_of(recording)
    if command is None or not recording.has("position"):
        return ()
    position = recording.channel("position")
    same = [x for x in command.labels if x in position.labels and command.unit_of(x) == position.unit_of(x)]
    return tuple(same)


def _common(each: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(label for label in each[0] if all(label in labels for labels in each))
