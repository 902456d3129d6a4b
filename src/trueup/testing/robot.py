# SPDX-License-Identifier: Apache-2.0
"""What every Robot must do, whatever it is made of."""

from __future__ import annotations

import numpy as np

from trueup.ends import ended
from trueup.recording import Recording, is_command
from trueup.robots.robot import HandsOut, Robot
from trueup.testing.broken import require
from trueup.trial import Trial


def check_robot(robot: Robot, trial: Trial) -> None:
    """Checks the contract of `Robot` with a trial that it can perform: this moves the robot, two or three times.

    One recording a repeat, with the observed channels in their units and with all labels, over the whole trial or
    up to the end that the recording says its run had (`ends.with_end`); the
    command that was requested, where there was one; nothing written into the trial; where the robot calls itself
    repeatable, the same recordings for the same trial. Raises ContractBrokenError (an AssertionError) that says what was
    broken.
    """
    require(isinstance(robot.repeatable, bool), "repeatable is not True or False")
    before = _content(trial)
    if isinstance(robot, HandsOut):
        robot.hand_out([trial])
        robot.hand_out([trial])  # again changes nothing
    recordings = robot.perform(trial)
    require(len(recordings) == trial.repeats, f"{len(recordings)} recordings for {trial.repeats} repeats")
    names = [r.name for r in recordings]
    require(len(set(names)) == len(names), f"two repeats have the same name: {', '.join(names)}")
    for recording in recordings:
        _check_recording(recording, trial)
    require(_content(trial) == before, "perform wrote into its trial")
    if robot.repeatable:
        again = robot.perform(trial)
        for one, other in zip(recordings, again, strict=True):
            same = all(
                np.array_equal(c.values, other.channel(n).values, equal_nan=True) for n, c in one.channels.items()
            )
            require(same, "it calls itself repeatable, but the same trial gave other recordings")


def _check_recording(recording: Recording, trial: Trial) -> None:
    end = ended(recording)
    for name, o in trial.observed.items():
        require(recording.has(name), f"channel '{name}' is observed but missing from recording '{recording.name}'")
        channel = recording.channel(name)
        missing = [label for label in o.labels if label not in channel.labels]
        require(not missing, f"channel '{name}' lacks {', '.join(missing)}")
        require(channel.unit == o.unit, f"channel '{name}' is in '{channel.unit}', asked for in '{o.unit}'")
        covered = channel.time[-1] - channel.time[0]
        lasted = trial.duration if end is None else end.at - recording.start
        require(covered >= 0.9 * lasted, f"channel '{name}' covers {covered:g} s of {lasted:g} s")
        if not is_command(name):
            moves = bool(np.isfinite(channel.values).any())
            require(moves, f"channel '{name}' holds no number")
    if trial.command is not None:
        require(recording.has("command"), "the command that was requested is not in the recording")
        done = recording.channel("command").select(trial.command.labels)
        asked = trial.command.at(done.time, hold=True)
        require(np.allclose(done.values, asked, equal_nan=True), "the 'command' recorded is not the one requested")


def _content(trial: Trial) -> str:
    arrays = [trial.command.values] if trial.command is not None else []
    arrays += [o.time for o in trial.observed.values()] + [r.values for r in trial.references.values()]
    return repr((trial.name, dict(trial.settings), [a.tobytes() for a in arrays]))
