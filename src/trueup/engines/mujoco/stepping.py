# SPDX-License-Identifier: Apache-2.0
"""Two ways to step a batch: natively over many steps, or in lockstep where a controller or a live quantity must act."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

import mujoco
import numpy as np
from mujoco.batch import Batch
from numba import cfunc
from numpy.typing import NDArray

from trueup.articulated.kernels import own_delayed_command
from trueup.articulated.laws import Law
from trueup.articulated.signals import Signals
from trueup.controllers.controller import Controller, Observation

Array = NDArray[np.float64]


@cfunc("float64()", cache=True)
def stopped_clock() -> float:
    """Handed to MuJoCo in place of its profiling clock (see `unclocked`)."""
    return 0.0


@contextmanager
def unclocked() -> Iterator[None]:
    """Without the profiling clock, which MuJoCo reads some thirty times a step: a seventh of a small robot's step.

    The clock belongs to the process: one that the caller has set stays, and MuJoCo's own is back afterwards.
    """
    if mujoco.get_mjcb_time() is not None:
        yield
        return
    mujoco.set_mjcb_time(stopped_clock.ctypes)
    try:
        yield
    finally:
        mujoco.set_mjcb_time(None)


class Stepper(Protocol):
    """Advances the first `active` rows of a batch and records fields after each step."""

    def advance(self, at: int, count: int, active: int, record: Sequence[str]) -> dict[str, Array]:
        """Field to (active, count, ...). `at` is the number of steps done so far."""
        ...

    def salvaged(self) -> dict[str, Array]:
        """What the last `advance` had recorded when it raised."""
        ...


def stepper(
    batch: Batch, compiled: mujoco.MjModel, signals: Signals, laws: Sequence[Law], controller: Controller | None,
    step: float,
) -> Stepper:  # fmt: skip
    """The faster of the two that will do. `laws` act before each step."""
    candidates = len(signals.delay)
    if controller is None and not laws:
        return Native(batch, signals, candidates, step)
    return Lockstep(batch, compiled, signals, laws, controller, step)


class Native:
    """Commands computed beforehand, stepped in native code."""

    def __init__(self, batch: Batch, signals: Signals, candidates: int, step: float) -> None:
        self._batch, self._signals, self._candidates, self._step = batch, signals, candidates, step
        self._out: dict[str, Array] = {}

    def advance(self, at: int, count: int, active: int, record: Sequence[str]) -> dict[str, Array]:
        """See Stepper."""
        trials = active // self._candidates
        control = np.concatenate([self._signals.commands(k, at, count, self._step) for k in range(trials)])
        self._out = {
            f: np.empty((active, count, *self._batch.bind(f).shape[1:]), self._batch.bind(f).dtype) for f in record
        }
        self._batch.rollout(
            count, control, control_spec=int(mujoco.mjtState.mjSTATE_CTRL), record=tuple(record), ids=np.arange(active),
            out=dict(self._out),
        )  # fmt: skip
        return self._out

    def salvaged(self) -> dict[str, Array]:
        """See Stepper."""
        return self._out


class Lockstep:
    """One step at a time: controllers at their own rate, dead bands, friction that depends on speed and load."""

    def __init__(
        self, batch: Batch, compiled: mujoco.MjModel, signals: Signals, laws: Sequence[Law],
        controller: Controller | None, step: float,
    ) -> None:  # fmt: skip
        self._batch, self._compiled, self._signals, self._step = batch, compiled, signals, step
        self._controller = controller
        self._candidates = len(signals.delay)
        self._qpos, self._qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self._laws = laws
        self._delay = np.ascontiguousarray(np.tile(signals.delay, (batch.nsim // self._candidates, 1)))
        self._issued: list[float] = []
        self._orders = np.zeros((0, batch.nsim, compiled.nu))
        self._out: dict[str, Array] = {}

    def advance(self, at: int, count: int, active: int, record: Sequence[str]) -> dict[str, Array]:
        """See Stepper."""
        ids = np.arange(active)
        everyone = active == self._batch.nsim
        bound = {f: self._batch.bind(f) for f in record}
        self._out = {f: np.zeros((active, count, *b.shape[1:]), b.dtype) for f, b in bound.items()}
        trials = active // self._candidates
        control: Array | None = None
        if self._controller is None:
            control = np.concatenate([self._signals.commands(k, at, count, self._step) for k in range(trials)])
        for s in range(count):
            now = (at + s) * self._step
            wanted = control[:, s] if control is not None else self._closed_loop(now, active)
            self._act(wanted, active)
            self._batch.step(None if everyone else ids)
            for field, array in bound.items():
                self._out[field][:, s] = array[:active]
        return self._out

    def salvaged(self) -> dict[str, Array]:
        """See Stepper."""
        return self._out

    def _act(self, wanted: Array, active: int) -> None:
        command = np.array(wanted)
        for law in self._laws:
            law.act(command)
        self._ctrl[:active] = command

    def _closed_loop(self, now: float, active: int) -> Array:
        """Asks the controller when its next command is due; applies its orders after each actuator's delay."""
        controller = self._controller
        if controller is None:
            raise RuntimeError("no controller in this run")
        due = not self._issued or now >= self._issued[0] + len(self._issued) * controller.period - 1e-9
        if due:
            self._issue(controller, now)
        out = np.empty((len(self._ctrl), self._compiled.nu))
        count = len(self._issued)
        own_delayed_command(np.array(self._issued), self._orders, count, self._delay, now, self._step, out)
        return out[:active]

    def _issue(self, controller: Controller, now: float) -> None:
        # Sensors must describe the present state, not the one before the last step.
        self._batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_VEL))
        sensors = self._sensors()
        seen = Observation(now, self._qpos, self._qvel, sensors)
        if not self._issued:
            controller.reset(seen)
        order = np.asarray(controller.command(seen), dtype=np.float64)
        if order.shape != self._ctrl.shape:
            raise ValueError(f"the controller returned commands of shape {order.shape}, expected {self._ctrl.shape}")
        if len(self._issued) == len(self._orders):
            grown = np.zeros((max(64, 2 * len(self._orders)), *order.shape))
            grown[: len(self._orders)] = self._orders
            self._orders = grown
        self._orders[len(self._issued)] = order
        self._issued.append(now)

    def _sensors(self) -> dict[str, Array]:
        model = self._compiled
        if not model.nsensor:
            return {}
        data = self._batch.bind("sensordata")
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, i) or str(i) for i in range(model.nsensor)]
        return {n: data[:, a : a + d] for n, a, d in zip(names, model.sensor_adr, model.sensor_dim, strict=True)}
