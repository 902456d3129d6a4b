# SPDX-License-Identifier: Apache-2.0
"""Whether a robot whose base no recording shows trod on its feet, where its log does not begin at rest: by short replays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from trueup.articulated.starts import measured_base, measured_start
from trueup.articulated.wiring import commanded, control_of
from trueup.engines.mujoco.base import place
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.stance import told
from trueup.evidence import HALVED
from trueup.recording import Recording
from trueup.trial import Trial, command_of

_LOOKS = 16  # stretches of each recording, spread over it
_LASTING = 0.2  # s of each: by then a drive that is let go of its load has moved, and no robot has fallen


def trod(free: Model, hanging: mujoco.MjModel, recordings: Sequence[Recording]) -> str:
    """What speaks for feet on the floor, in words: from where the robot was at some instants, its base as it was reckoned,
    its joints go on as those of the free model do, and not as where it hangs. '' where nothing speaks for it.
    """
    standing, hung = 0.0, 0.0
    for recording in recordings:
        begins = np.linspace(recording.start, recording.stop - _LASTING, _LOOKS + 2)[1:-1]
        for begin in begins[begins > recording.start].tolist():
            both = [_error(compiled, free, recording, begin) for compiled in (free.compiled, hanging)]
            if np.isfinite(both).all():
                standing, hung = standing + both[0], hung + both[1]
    if not standing < HALVED**2 * hung:  # or doubtful gains would decide
        return ""
    return (
        f"{_LASTING:g} s ahead joints are foretold to {100.0 * np.sqrt(standing / hung):.0f} % of the error of a model that "
        "hangs by one that stands where that is reckoned to have been"
    )


def _error(compiled: mujoco.MjModel, model: Model, recording: Recording, begin: float) -> float:
    """By how much joints are elsewhere than measured, simulated from an instant on: a sum of squares; NaN where drives do not
    take what they were told, or something is not known.
    """
    drives, command = told(model, recording), command_of(recording)
    if not drives or command is None:
        return np.nan
    labels, actuators = list(drives), list(drives.values())
    position, asked = recording.channel("position").select(labels), command.select(labels)
    factors = [control_of(model, name, command.unit) for name in commanded(model, asked)]
    trial = replace(Trial.of(recording), start=begin)
    data, base = mujoco.MjData(compiled), measured_base(trial)
    if base is not None:
        place(compiled, data.qpos, data.qvel, base)
    own = compiled.actuator_trnid[actuators, 0]
    still = np.zeros(len(labels))
    data.qpos[compiled.jnt_qposadr[own]], data.qvel[compiled.jnt_dofadr[own]] = measured_start(
        (still, still), trial, labels
    )
    error, late = 0.0, (position.time > begin) & (position.time <= begin + _LASTING)
    for time, seen in zip(position.time[late], position.values[late], strict=True):
        while begin + data.time < time:
            row = max(0, np.searchsorted(asked.time, begin + data.time, side="right") - 1)
            data.ctrl[actuators] = factors * asked.values[row]
            mujoco.mj_step(compiled, data)
        error += float(np.nansum((data.qpos[compiled.jnt_qposadr[own]] - seen) ** 2))
    return error
