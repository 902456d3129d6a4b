# SPDX-License-Identifier: Apache-2.0
"""Where sensors that are late, noisy and off, and starts that scatter, find their channels in the state of a model."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.articulated.sensing import Find, Place, turned
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import Source, source_of
from trueup.errors import unknown_name
from trueup.trial import Trial


def finder(model: Model, compiled: mujoco.MjModel, trial: Trial) -> Find:
    """What finds the channels of a trial in the state. It raises UnknownNameError."""

    def find(channel: str, labels: tuple[str, ...]) -> Place:
        source = _source(model, compiled, trial, channel, labels)
        return Place(source.field, source.columns, source.derived, turned if source.turned else None)

    return find


def _source(model: Model, compiled: mujoco.MjModel, trial: Trial, channel: str, labels: tuple[str, ...]) -> Source:
    """Where a channel of the state is, or a sensor of the model by its own name. Raises UnknownNameError."""
    number = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, channel)
    if number >= 0:
        first, size = int(compiled.sensor_adr[number]), int(compiled.sensor_dim[number])
        return Source("sensordata", np.arange(first, first + size, dtype=np.int64), None, derived=True)
    whole = {POSITION: AXES, ORIENTATION: ANGLES, "position": model.scalar_joints(), "velocity": model.scalar_joints()}
    observed = trial.observed[channel].labels if channel in trial.observed else ()
    source = source_of(model, compiled, channel, labels or tuple(whole.get(channel, observed)))
    if source is None or not len(source.columns):
        raise unknown_name("channel", channel, [*whole, *trial.observed], f"what can be sensed in trial '{trial.name}'")
    return source
