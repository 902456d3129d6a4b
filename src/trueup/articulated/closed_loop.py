# SPDX-License-Identifier: Apache-2.0
"""A trial's controller in a simulation: asked when a command is due, its commands held, delayed and limited."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from trueup.arrays import Array
from trueup.articulated.kernels import own_delayed_commands
from trueup.articulated.signals import Signals
from trueup.controllers.controller import Controller, Forcing, Foretold, Looking, Observation
from trueup.rounding import first_step


class ClosedLoop:
    """One trial's controller of b copies: the `trial`-th of `signals`, whose drives take what it commands. `step` in s."""

    def __init__(self, controller: Controller, signals: Signals, trial: int, step: float) -> None:
        self._controller, self._signals, self._trial, self._step = controller, signals, trial, step
        self._delay = np.ascontiguousarray(signals.delay)
        # Commands older than the longest delay act no more; room for as many again, so that they are seldom moved.
        self._acting = int(np.ceil(self._delay.max(initial=0.0) / controller.period)) + 2
        self._times = np.zeros(2 * self._acting)
        self._orders = np.zeros((2 * self._acting, *self._delay.shape))
        self._kept = self._asked = 0
        kinds = type(controller).__mro__  # a subclass that commands otherwise does not say it ahead
        told, commanded = (min((i for i, k in enumerate(kinds) if n in vars(k)), default=len(kinds))
                           for n in ("ahead", "command"))  # fmt: skip
        # Asked of the controller once: to look whether it keeps a protocol costs as much as a small one's command.
        self._looking, self._forcing = isinstance(controller, Looking), isinstance(controller, Forcing)
        self._foretold = told <= commanded and isinstance(controller, Foretold)

    @property
    def due(self) -> int:
        """Number of the step before which the next command is asked for."""
        return first_step(self._asked * self._controller.period, self._step)

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """Channels that the controller wants to see."""
        return cast(Looking, self._controller).looks_at if self._looking else {}

    @property
    def push(self) -> tuple[tuple[str, ...], Array] | None:
        """Joints and (b, k) torques with which the controller pushes on them; None where it only commands."""
        if not self._forcing:
            return None
        c = cast(Forcing, self._controller)
        return (c.forced, c.torque) if c.forced else None

    def ask(self, observation: Observation) -> None:
        """Takes the controller's next command. Raises ValueError where it has another shape than (b, width)."""
        if not self._asked:
            self._controller.reset(observation)
        order = np.asarray(self._controller.command(observation), dtype=np.float64)
        if order.shape != self._delay.shape:
            raise ValueError(f"the controller returned commands of shape {order.shape}, expected {self._delay.shape}")
        if self._kept == len(self._times):
            self._make_room()
        self._times[self._kept], self._orders[self._kept] = observation.time, order
        self._kept += 1
        self._asked += 1

    def _make_room(self) -> None:
        """Forgets commands that act no more, and has room for as many again as still may."""
        kept = slice(self._kept - min(self._acting, self._kept), self._kept)
        times, orders = self._times[kept].copy(), self._orders[kept].copy()
        if len(self._times) < 2 * self._acting:  # commands told ahead have filled them
            self._times = np.zeros(2 * self._acting)
            self._orders = np.zeros((2 * self._acting, *orders.shape[1:]))
        self._kept = len(times)
        self._times[: self._kept], self._orders[: self._kept] = times, orders

    def foretell(self, until: int) -> None:
        """Takes the commands that are due before step `until`, of a controller that has begun and knows them ahead."""
        if not self._asked or not self._foretold:
            return
        begun, times = self._asked, list[float]()
        while self.due < until:
            times.append(self.due * self._step)
            self._asked += 1
        orders = cast(Foretold, self._controller).ahead(np.array(times)) if times else None
        if orders is None:
            self._asked = begun
            return
        kept = slice(max(0, self._kept - self._acting), self._kept)
        self._times = np.concatenate([self._times[kept], times])
        self._orders = np.ascontiguousarray(np.concatenate([self._orders[kept], orders.swapaxes(0, 1)]))
        self._kept = len(self._times)

    def _paces(self) -> Array:
        """Speeds of the commands that act, each since the one before: what comes next, a controller does not know."""
        paces, kept = np.zeros_like(self._orders), self._kept
        waits = np.diff(self._times[:kept])[:, None, None]
        paces[1:kept] = np.diff(self._orders[:kept], axis=0) / waits
        return paces

    def commands(self, at: int, count: int) -> Array:
        """(b, count, width) of the steps at ... at + count, before which no other command is due, as drives take them.

        Steps must be asked for in their order.
        """
        out = np.empty((len(self._delay), count, self._delay.shape[1]))
        own_delayed_commands(self._times, self._orders, self._kept, self._delay, at, self._step, out)
        if self._signals.lead.any():
            ahead = np.empty_like(out)
            own_delayed_commands(self._times, self._paces(), self._kept, self._delay, at, self._step, ahead)
            out += self._signals.lead[:, None] * ahead
        return self._signals.arriving(self._trial, at, out, self._step)
