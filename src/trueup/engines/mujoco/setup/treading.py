# SPDX-License-Identifier: Apache-2.0
"""Whether a robot whose base no recording shows trod on its feet, where its log does not begin at rest: by short replays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.starts import measured_base, measured_start
from trueup.articulated.wiring import commanded, control_of
from trueup.engines.mujoco.base import place
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.stance import commanded_joints
from trueup.evidence import STANDARD_ERRORS
from trueup.instant import LOOKS
from trueup.recording import Recording
from trueup.trial import Trial, command_of

_LASTING = 0.2  # s of each: by then a drive that is let go of its load has moved, and no robot has fallen


def trod(free: Model, hanging: mujoco.MjModel, recordings: Sequence[Recording]) -> str:
    """What speaks for feet on the floor, in words; '' where nothing does.

    From where the robot was at some instants, its base as it was reckoned, its joints go on as those of the free model do, or
    as where it hangs. Both replays are wrong in much else, delays and gains; so it is asked how far what was measured lies
    from the second towards the first, along what parts them (the J test of models of which none holds the other:
    R. Davidson, J. G. MacKinnon, Econometrica 49(3), 1981): surely more than half of the way, by how that scatters.
    """
    looks = list[tuple[float, float]]()
    for recording in recordings:
        looks_at = min(LOOKS, int((recording.stop - recording.start) / _LASTING))  # none sees what another does
        begins = np.linspace(recording.start, recording.stop - _LASTING, looks_at + 2)[1:-1]
        for begin in begins[begins > recording.start].tolist():
            standing, hung, seen = _ahead(free, hanging, recording, begin)
            if np.isfinite(standing).all() and np.isfinite(hung).all() and np.isfinite(seen).all():
                apart = standing - hung
                looks.append((float(np.sum((seen - hung) * apart)), float(np.sum(apart**2))))
    along, apart = np.array(looks).reshape(-1, 2).T
    if len(looks) < 2 or not apart.sum() > 0.0:  # of one nobody knows the scatter
        return ""
    share = float(along.sum() / apart.sum())
    error = float(np.sqrt(np.sum((along - share * apart) ** 2)) / apart.sum())
    if share - STANDARD_ERRORS * error < 0.5:  # surely nearer to the first
        return ""
    return (
        f"{_LASTING:g} s ahead joints are {100.0 * share:.0f} % of the way (standard error {100.0 * error:.0f}) from where "
        "hanging takes them to where feet on the floor do"
    )


def _ahead(free: Model, hanging: mujoco.MjModel, recording: Recording, begin: float) -> tuple[Array, Array, Array]:
    """(T, k) where joints are from an instant on, simulated on the feet and hanging, and measured; NaN where drives do not
    take what they were told.
    """
    drives, command = commanded_joints(free, recording), command_of(recording)
    if not drives or command is None:
        nothing = np.full((1, 1), np.nan)
        return nothing, nothing, nothing
    labels, actuators = list(drives), list(drives.values())
    position, asked = recording.channel("position").select(labels), command.select(labels)
    factors = np.array([control_of(free, name, command.unit) for name in commanded(free, asked)])
    late = (position.time > begin) & (position.time <= begin + _LASTING)
    trial, still = replace(Trial.of(recording), start=begin), np.zeros(len(labels))
    joints = measured_start((still, still), trial, labels, free.compiled.opt.timestep)
    base = measured_base(trial)
    found = []
    for compiled in (free.compiled, hanging):
        data, own = mujoco.MjData(compiled), compiled.actuator_trnid[actuators, 0]
        if base is not None:
            place(compiled, data.qpos, data.qvel, base)
        data.qpos[compiled.jnt_qposadr[own]], data.qvel[compiled.jnt_dofadr[own]] = joints
        seen = []
        for time in position.time[late].tolist():
            while begin + data.time < time:
                row = max(0, int(np.searchsorted(asked.time, begin + data.time, side="right")) - 1)
                data.ctrl[actuators] = factors * asked.values[row]
                mujoco.mj_step(compiled, data)
            seen.append(data.qpos[compiled.jnt_qposadr[own]])
        found.append(np.array(seen).reshape(-1, len(labels)))
    return found[0], found[1], position.values[late]
