# SPDX-License-Identifier: Apache-2.0
"""The peer of the calibration benchmarks: mujoco.sysid, run as its README and notebook show, with care for timing."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import mujoco
import numpy as np
from absl import logging
from mujoco import sysid
from numpy.typing import NDArray

from trueup.recording import Recording

Array = NDArray[np.float64]
Geoms = Literal["keep", "remove_visuals", "none"]
ROLES = ("position", "velocity", "torque")
_SENSOR = {
    "position": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "velocity": mujoco.mjtSensor.mjSENS_JOINTVEL,
    "torque": mujoco.mjtSensor.mjSENS_JOINTACTFRC,
}


class ParameterRow(Protocol):
    """What `fit` reads of a parameter. Quantities: see `modifier`. Values in SI units, bounds finite."""

    @property
    def quantity(self) -> str: ...
    @property
    def target(self) -> str: ...
    @property
    def nominal(self) -> float: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...


@dataclass(frozen=True)
class PeerParameter:
    """One scalar to fit: `quantity` of the joint, actuator or body named `target`, from `nominal` within bounds."""

    quantity: str
    target: str
    nominal: float
    lower: float
    upper: float


@dataclass(frozen=True)
class PeerFit:
    """What mujoco.sysid found."""

    values: Array
    """(n,) in the order of the parameters given."""
    half_widths: Array
    """(n,) 95 % half widths of its `calculate_intervals`."""
    cpu_seconds: float
    """Process CPU time of all threads, from loading the model to the optimum; intervals and replays are not in it."""
    wall_seconds: float
    iterations: int
    evaluations: int
    """Simulated candidates; each replays all recordings."""
    status: str
    """The optimizer's own closing line."""
    setup: Setup = field(repr=False)

    def replay(self, recording: Recording, values: Array | None = None) -> Mapping[str, Array]:
        """Simulate `recording` at `values` (default: the fitted ones); see `Setup.replay`."""
        return self.setup.replay(recording, self.values if values is None else values)


def fit(
    model: str | Path,
    parameters: Sequence[ParameterRow],
    recordings: Sequence[Recording],
    *,
    max_iters: int = 200,
    geoms: Geoms = "keep",
    x_scale: str | None = None,
) -> PeerFit:
    """Fit `parameters` to `recordings` with `sysid.optimize` and its default optimizer, "mujoco".

    `model` is MJCF text or a path. Labels of the recordings are joint names. The residual is the library's default:
    measured - predicted, each column divided by norm(measured column) / sqrt(2) (`normalize_residual`), no weights.
    `geoms`: "keep" is the tutorial's way, "remove_visuals" calls the library's helper (it fails where a collision
    geom shares a visual one's mesh), "none" deletes all geoms (no contacts are possible then).
    `x_scale="jac"` is an option of the library, not its default.

    Raises ValueError for an unknown quantity or target, and where a joint of the model has no command.
    """
    logging.set_verbosity(logging.ERROR)  # its INFO log is the parameter table
    wall, cpu = time.perf_counter(), time.process_time()
    setup = _setup(model, parameters, recordings, geoms)
    residual = _Counted(sysid.build_residual_fn(models_sequences=[setup.sequences(recordings)]))
    options = {} if x_scale is None else {"x_scale": x_scale}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        found, result = sysid.optimize(
            initial_params=setup.parameter_dict(), residual_fn=residual, max_iters=max_iters, **options
        )
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    evaluations, iterations = residual.candidates, len(result.extras["objective"]) - 1
    at_optimum, _, _ = residual(result.x, found)
    _, half_widths = sysid.calculate_intervals(at_optimum, result.jac)
    status = next((line for line in printed.getvalue().splitlines() if line.startswith("Terminated")), "")
    return PeerFit(
        np.array(found.as_vector()), np.asarray(half_widths), cpu, wall, iterations, evaluations, status, setup
    )


class _Counted:
    """A residual function that counts the candidates it was asked for."""

    def __init__(self, residual: Callable[..., tuple[list[Array], object, object]]) -> None:
        self._residual = residual
        self.candidates = 0

    def __call__(self, x: Array, params: sysid.ParameterDict) -> tuple[list[Array], object, object]:
        self.candidates += x.shape[1] if x.ndim > 1 else 1
        return self._residual(x, params)


@dataclass(frozen=True)
class Setup:
    """A model prepared for sysid: its sensors are exactly the measured columns, in their order.

    The default residual picks predicted columns by the index of the measured ones, so the two layouts must agree.
    """

    spec: mujoco.MjSpec
    parameters: tuple[ParameterRow, ...]
    columns: tuple[tuple[str, str], ...]
    """(role, joint) of each sensor."""

    def parameter_dict(self) -> sysid.ParameterDict:
        """The parameters with their modifiers, at nominal."""
        params = sysid.ParameterDict()
        for row in self.parameters:
            write = modifier(self.spec, row.quantity, row.target)
            params.add(sysid.Parameter(_name(row), row.nominal, row.lower, row.upper, modifier=write))
        return params

    def sequences(self, recordings: Sequence[Recording]) -> sysid.ModelSequences:
        """The recordings as the library wants them, with initial states from the recordings."""
        model = self.spec.compile()
        return sysid.ModelSequences(
            "arm",
            self.spec,
            [r.name for r in recordings],
            [sysid.create_initial_state(model, _start(model, r), np.zeros(model.nv)) for r in recordings],
            [self._control(model, r) for r in recordings],
            [self._measured(model, r) for r in recordings],
        )

    def replay(self, recording: Recording, values: Array) -> Mapping[str, Array]:
        """Simulated (T, k) by role, at the times and labels of each measured channel of `recording`."""
        params = self.parameter_dict()
        params.update_from_vector(np.asarray(values, dtype=np.float64))
        model = sysid.apply_param_modifiers(params, self.spec)
        measured = self.sequences([recording]).measured_rollout[0]
        trajectory = sysid.sysid_rollout([model], [mujoco.MjData(model)], [measured.control], [measured.initial_state])[
            0
        ]
        result = {}
        for role in ROLES:
            if recording.has(role):
                channel = recording.channel(role)
                times = channel.time - recording.channel("position").time[0] + model.opt.timestep
                sampled = trajectory.sensordata.resample(new_times=times).data
                result[role] = sampled[:, [self.columns.index((role, label)) for label in channel.labels]]
        return result

    def _control(self, model: mujoco.MjModel, recording: Recording) -> sysid.TimeSeries:
        """Commands held, on the simulation's grid: the library would interpolate between them linearly."""
        command, origin = recording.channel("command"), recording.channel("position").time[0]
        joints = [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]
        missing = [j for j in joints if j not in command.labels]
        if missing:
            raise ValueError(f"recording '{recording.name}' has no command for joints {missing}")
        dt = model.opt.timestep
        steps = int(np.floor((recording.channel("position").time[-1] - origin) / dt + 1e-6)) + 2
        grid = np.arange(steps) * dt
        held = sysid.TimeSeries(command.time - origin, command.select(joints).values).resample(
            # a command due at a step's start belongs to that step, whatever the rounding of its time
            grid + 1e-6 * dt,
            method="zero_order_hold",
        )
        # Its resampling takes ceil(duration / dt) + 1 points: rounding up by an ulp would add one and shift all others.
        times = np.linspace(0.0, grid[-1] * (1 - 1e-12), steps)
        return sysid.TimeSeries.from_control_names(times, held.data, model)

    def _measured(self, model: mujoco.MjModel, recording: Recording) -> sysid.TimeSeries:
        """Measured columns at the times of the position channel, a timestep late.

        `mujoco.rollout` stores the sensors of a step's start beside the time of its end; the notebook's own data
        carry the same shift.
        """
        position = recording.channel("position")
        columns = []
        for role, joint in self.columns:
            channel = recording.channel(role)
            column = channel.column(joint)
            same = channel.time.shape == position.time.shape and np.array_equal(channel.time, position.time)
            columns.append(column if same else np.interp(position.time, channel.time, column))
        data = np.column_stack(columns)
        whole = np.isfinite(data).all(axis=1)
        times = position.time[whole] - position.time[0] + model.opt.timestep
        return sysid.TimeSeries.from_names(times, data[whole], model)


def modifier(spec: mujoco.MjSpec, quantity: str, target: str) -> Callable[[mujoco.MjSpec, sysid.Parameter], object]:
    """The callback that writes `quantity` of `target` into a spec, as the library's README writes them.

    Quantities: joint.damping, joint.friction, joint.armature, actuator.kp, actuator.kv, actuator.force_limit,
    body.mass, body.com_x, body.com_y, body.com_z. Raises ValueError for another one, or a target not in `spec`.
    """
    kind, _, what = quantity.partition(".")
    if getattr(spec, kind, lambda _: None)(target) is None:
        raise ValueError(f"{kind} '{target}' is not in the model")

    def damping(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.joint(target).damping = np.array([p.value[0], 0.0, 0.0])  # a polynomial in MuJoCo 4

    def force_limit(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.actuator(target).forcerange = np.array([-p.value[0], p.value[0]])

    def mass(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        body = s.body(target)
        body.inertia = np.array(body.inertia) * (p.value[0] / body.mass)  # denser, not larger
        body.mass = p.value[0]

    def com(axis: int) -> Callable[[mujoco.MjSpec, sysid.Parameter], None]:
        return lambda s, p: s.body(target).ipos.__setitem__(axis, p.value[0])

    # body_inertia_param() would compile the model once more for each body and candidate; the README's direct
    # assignment does the same where the inertial is given, so the peer gets the faster of its two ways.
    writers: dict[str, Callable[[mujoco.MjSpec, sysid.Parameter], object]] = {
        "joint.damping": damping,
        "joint.friction": lambda s, p: setattr(s.joint(target), "frictionloss", p.value[0]),
        "joint.armature": lambda s, p: setattr(s.joint(target), "armature", p.value[0]),
        "actuator.kp": lambda s, p: sysid.apply_pgain(s, target, p.value[0]),
        "actuator.kv": lambda s, p: sysid.apply_dgain(s, target, p.value[0]),
        "actuator.force_limit": force_limit,
        "body.mass": mass,
        "body.com_x": com(0),
        "body.com_y": com(1),
        "body.com_z": com(2),
    }
    if quantity not in writers:
        raise ValueError(f"unknown quantity '{quantity}'; quantities are: {', '.join(writers)}")
    if kind == "body" and not spec.body(target).explicitinertial:
        raise ValueError(f"body '{target}' has no <inertial>: {what} cannot be set directly")
    return writers[quantity]


def _setup(
    model: str | Path, parameters: Sequence[ParameterRow], recordings: Sequence[Recording], geoms: Geoms
) -> Setup:
    text = str(model)
    spec = mujoco.MjSpec.from_string(text) if text.lstrip().startswith("<") else mujoco.MjSpec.from_file(text)
    if geoms == "remove_visuals":
        spec = sysid.remove_visuals(spec)
    elif geoms == "none":
        _delete_geoms(spec)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    columns = tuple((role, j) for role in ROLES if recordings[0].has(role) for j in recordings[0].channel(role).labels)
    for role, joint in columns:
        spec.add_sensor(name=f"{role}_{joint}", type=_SENSOR[role], objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint)
    return Setup(spec, tuple(parameters), columns)


def _delete_geoms(spec: mujoco.MjSpec) -> None:
    for body in spec.bodies:
        if body.geoms and body.name != "world" and not body.explicitinertial:
            raise ValueError(f"body '{body.name}' takes its inertia from its geoms: they cannot be deleted")
    for item in [*spec.geoms, *spec.meshes, *spec.materials, *spec.textures]:
        spec.delete(item)


def _start(model: mujoco.MjModel, recording: Recording) -> Array:
    """(nq,) joint positions at rest: the mean over the samples before the command moves, 0.1 s at most."""
    command, position = recording.channel("command"), recording.channel("position")
    moved = np.flatnonzero(np.any(command.values != command.values[0], axis=1))
    until = min(position.time[0] + 0.1, command.time[moved[0]] if moved.size else np.inf)
    mean = np.nanmean(position.values[: max(1, int(np.searchsorted(position.time, until)))], axis=0)
    qpos = np.array(mujoco.MjData(model).qpos)
    for label, value in zip(position.labels, mean, strict=True):
        qpos[model.joint(label).qposadr[0]] = value
    return qpos


def _name(row: ParameterRow) -> str:
    return f"{row.quantity} {row.target}"
