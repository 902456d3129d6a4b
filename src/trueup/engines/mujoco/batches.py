# SPDX-License-Identifier: Apache-2.0
"""Batches of simulations of one model, kept and lean: a batch of its own costs more than a short run."""

from __future__ import annotations

import time
from contextlib import suppress

import mujoco
from mujoco.batch import Batch, SimulationError

from trueup.cores import cores, worth
from trueup.engines.mujoco.linkages import Linkages

_HANDOVER = 1e-4
"""s that a batch's other threads take to be given work and waited for, measured on two cores (0.085 ms)."""


class Batches:
    """Makes batches of `whole`, or of `bare` (the same model without shapes) where nothing touches anything.

    `threads` None: as many as this process may use. Every batch holds copies of its model, and the shapes of a real robot
    are megabytes.
    """

    def __init__(self, whole: mujoco.MjModel, bare: mujoco.MjModel, threads: int | None) -> None:
        self.whole, self.bare, self._threads = whole, bare, threads
        self.linkages = Linkages(bare)
        self._kept: dict[tuple[int, int, bool, bool, int], Batch] = {}
        self._costs: dict[tuple[bool, bool], float] = {}

    def __reduce__(self) -> tuple[type[Batches], tuple[object, ...]]:
        """In another process, with as many threads as that one has."""
        return Batches, (self.whole, self.bare, None)

    def at_step(self, step: float) -> Batches:
        """The same with another step, in s."""
        whole, bare = self.whole.__copy__(), self.bare.__copy__()
        whole.opt.timestep = bare.opt.timestep = step
        return Batches(whole, bare, self._threads)

    def get(
        self, rows: int, *, contacts: bool, sensors: bool, stepwise: bool = False, place: tuple[int, int] = (0, 1)
    ) -> Batch:
        """A batch of that many simulations, in whatever state it was left. `stepwise`: it is stepped one step at a time, so
        that it has no more threads than pay for a step. Batches that are stepped at once have each its own `place`, the
        first of how many, and share the threads.
        """
        kept, (number, count) = 3, place
        threads = min(-(-self.threads // count), rows)
        if stepwise and threads > 1:
            threads = worth(rows * self._cost(contacts, sensors), _HANDOVER, threads)
        key = (number, rows, contacts, sensors, threads)
        if key not in self._kept:
            if len(alike := [k for k in self._kept if k[0] == number]) >= kept:
                self._kept.pop(alike[0])
            self._kept[key] = Batch(self._model(contacts, sensors), rows, threads)
        return self._kept[key]

    @property
    def threads(self) -> int:
        """That step simulations, in all."""
        return self._threads or cores()

    def side_by_side(self, rows: int, contacts: bool) -> int:
        """In how many runs trials of so many simulations, with sensors, are best stepped where controllers act in between:
        as many as there are threads, one in which controllers act and one that waits; one where a step does not pay for
        being handed over, or on one core.
        """
        pays = self.threads > 1 and worth(rows * self._cost(contacts, True), _HANDOVER, 2) > 1
        return self.threads + 2 if pays else 1

    def _cost(self, contacts: bool, sensors: bool) -> float:
        """Seconds that one simulation takes for a step, measured once."""
        key, rows = (contacts, sensors), 8
        if key not in self._costs:
            batch, spent = Batch(self._model(contacts, sensors), rows, 1), []
            for _ in range(5):
                begun = time.perf_counter()
                with suppress(SimulationError):
                    batch.step()
                spent.append(time.perf_counter() - begun)
            self._costs[key] = min(spent) / rows
        return self._costs[key]

    def _model(self, contacts: bool, sensors: bool) -> mujoco.MjModel:
        model, off = (self.whole if contacts else self.bare).__copy__(), mujoco.mjtDisableBit
        model.opt.disableflags |= 0 if contacts else int(off.mjDSBL_CONTACT)
        model.opt.disableflags |= 0 if sensors else int(off.mjDSBL_SENSOR)
        # One tree is one island: to look for more costs a tenth of a step and changes nothing.
        model.opt.disableflags |= int(off.mjDSBL_ISLAND) if model.ntree == 1 else 0
        return model
