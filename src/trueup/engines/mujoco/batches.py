# SPDX-License-Identifier: Apache-2.0
"""Batches of simulations of one model, kept and lean: a batch of its own costs more than a short run."""

from __future__ import annotations

import mujoco
from mujoco.batch import Batch

from trueup.cores import cores


class Batches:
    """Makes batches of `whole`, or of `bare` (the same model without shapes) where nothing touches anything.

    `threads` None: as many as this process may use. Every batch holds copies of its model, and the shapes of a real robot
    are megabytes.
    """

    def __init__(self, whole: mujoco.MjModel, bare: mujoco.MjModel, threads: int | None) -> None:
        self.whole, self._bare, self._threads = whole, bare, threads
        self._kept: dict[tuple[int, bool, bool], Batch] = {}

    def __reduce__(self) -> tuple[type[Batches], tuple[object, ...]]:
        """In another process, with as many threads as that one has."""
        return Batches, (self.whole, self._bare, None)

    def at_step(self, step: float) -> Batches:
        """The same with another step, in s."""
        whole, bare = self.whole.__copy__(), self._bare.__copy__()
        whole.opt.timestep = bare.opt.timestep = step
        return Batches(whole, bare, self._threads)

    def get(self, rows: int, *, contacts: bool, sensors: bool) -> Batch:
        """A batch of that many simulations, in whatever state it was left."""
        kept = 3
        key = (rows, contacts, sensors)
        if key not in self._kept:
            if len(self._kept) >= kept:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = Batch(self._model(contacts, sensors), rows, min(self._threads or cores(), rows))
        return self._kept[key]

    def _model(self, contacts: bool, sensors: bool) -> mujoco.MjModel:
        model, off = (self.whole if contacts else self._bare).__copy__(), mujoco.mjtDisableBit
        model.opt.disableflags |= 0 if contacts else int(off.mjDSBL_CONTACT)
        model.opt.disableflags |= 0 if sensors else int(off.mjDSBL_SENSOR)
        # One tree is one island: to look for more costs a tenth of a step and changes nothing.
        model.opt.disableflags |= int(off.mjDSBL_ISLAND) if model.ntree == 1 else 0
        return model
