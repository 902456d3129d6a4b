# SPDX-License-Identifier: Apache-2.0
"""Sensors that are late, noisy and off, and starts that scatter: channels tied to the state of a model."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.articulated.sensing import Sense, Senses, on_robot, turned
from trueup.articulated.signals import Signals
from trueup.chance import StartScatter
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import Source, source_of
from trueup.errors import unknown_name
from trueup.trial import Trial


def senses_of(model: Model, compiled: mujoco.MjModel, signals: Signals, k: int, step: float) -> Senses:
    """What controllers of one trial see: as the trial declares it, and as calibrated errors and delays of sensors have it."""
    trial, rows, found = signals.trial(k), len(signals.delay), []
    for s in trial.sensing:
        source = _source(model, compiled, trial, s.channel, ())
        noisy = _source(model, compiled, trial, s.channel, s.labels).columns if s.labels else source.columns
        found.append(
            Sense.declared(
                trial, s, rows, step, source.field, source.columns, noisy, derived=source.derived,
                turn=turned if source.turned else None,
            )
        )  # fmt: skip
    for channel, late in on_robot(signals.sensor_delays, trial):
        source = _source(model, compiled, trial, channel, ())
        found.append(Sense(source.field, source.columns, source.columns, late / step, derived=source.derived))
    if errors := signals.sensor_errors:
        columns = _source(model, compiled, trial, "position", tuple(errors)).columns
        found.append(Sense("qpos", columns, columns, np.zeros(rows), bias=np.stack(list(errors.values()), axis=1)))
    return Senses(found)


def scatter(model: Model, compiled: mujoco.MjModel, trial: Trial, qpos: Array, qvel: Array) -> None:
    """Moves the start states (b, nq), (b, nv) of one trial by what is declared to scatter."""
    for i, d in enumerate(trial.disturbances):
        if isinstance(d, StartScatter):
            source = _source(model, compiled, trial, d.channel, d.labels)
            state = qvel if source.field == "qvel" else qpos
            streams = trial.settled().streams(f"{trial.name}/{i}", len(qpos))
            if source.turned:
                state[:, source.columns] = turned(state[:, source.columns], d.deviation * streams.normal(3))
            else:
                state[:, source.columns] += d.deviation * streams.normal(len(source.columns))


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
