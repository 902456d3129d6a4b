# SPDX-License-Identifier: Apache-2.0
"""Fields of compiled models by name, with one row for each copy: of a batch, or of one model alone."""

from __future__ import annotations

from typing import Protocol

import mujoco

from trueup.arrays import Array


class Fields(Protocol):
    """Per-simulation values of a model field by name, (b, ...); a `mujoco.batch.Batch` offers it as `expand`."""

    def expand(self, name: str) -> Array:
        """The live array of a field."""
        ...


class SingleModel:
    """One compiled model seen as a batch of one, so that the same code reads, writes files and simulations."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model

    def expand(self, name: str) -> Array:
        """A view of the model's own field with a leading axis of one."""
        owner = self._model.opt if name.startswith("opt.") else self._model
        return getattr(owner, name.removeprefix("opt."))[None]


class FromNominal:
    """Fields of a batch, each set back to the model's own values the first time it is asked for."""

    def __init__(self, batch: Fields, model: mujoco.MjModel) -> None:
        self._batch, self._model = batch, model
        self._done: set[str] = set()

    def expand(self, name: str) -> Array:
        """The live array of a field."""
        live = self._batch.expand(name)
        if name not in self._done:
            owner = self._model.opt if name.startswith("opt.") else self._model
            live[:] = getattr(owner, name.removeprefix("opt."))
            self._done.add(name)
        return live
