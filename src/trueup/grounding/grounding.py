# SPDX-License-Identifier: Apache-2.0
"""What was learned of a robot, and what becomes of a command by it: requested and predicted angles, blended.

    command' = a command + b inverse(state, forward(state, command))

or, with what was found to be missing in the simulator itself (`residual.py`),

    command' = (a + b) command + b residual(state, command), or torque += b residual(state, command)

With the robot's forward model alone this is Farchy et al. (AAMAS 2013) section 4.3, with the simulator's inverse model after
it their section 6.1 and grounded action transformation (J. Hanna and P. Stone, AAAI 2017), with the robot's inverse model
alone, on the robot itself, their section 6.2.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup import files
from trueup.arrays import Array
from trueup.errors import GroundingError
from trueup.formats.aside import written_aside
from trueup.grounding.domain import Block, Domain
from trueup.grounding.predictors import as_arrays, from_arrays
from trueup.grounding.rows import Inputs
from trueup.grounding.views import Model

REQUESTED, PREDICTED = 0.7, 0.3
"""The paper's weights of the requested and of the predicted angles."""
_FORMAT = "trueup grounding 1"
_PARTS = ("columns", "centre", "whiten", "scale", "low", "high")


@dataclass(frozen=True, eq=False)
class Grounding:
    """Learned models of joints, where they may be asked, and how their outputs are blended with commands."""

    inputs: Inputs
    forward: Model | None
    """Of the robot: joints one frame later."""
    domain: Domain
    """Of the robot's rows."""
    inverse: Model | None = None
    """Commands that lead to given joints one frame later: in the simulator, or on the robot."""
    residual: Model | None = None
    """Of the simulator, in place of both: what is added to commands, or in N m to joints, so that it replays the robot."""
    torque: bool = False
    """Whether `residual` is a torque."""
    chained: bool = False
    """Whether the forward model goes on from its own predictions, not from where the simulated joints are: what these are
    wrong by then does not come back through the model. It is exact where the simulator follows well enough."""
    weights: tuple[float, float] = (REQUESTED, PREDICTED)
    """Of what is requested and of what is predicted."""
    about: Mapping[str, str] = field(default_factory=dict)
    """Where it came from: recordings, learner, errors."""

    def goal(self, X: Array) -> Array:
        """(b, k) where the joints are to be one frame later, of inputs X (b, d)."""
        return X[:, self.inputs.command_columns] if self.forward is None else self.forward.predict(X)

    def commands(self, X: Array, weights: Array | None = None, goal: Array | None = None) -> Array:
        """(b, k) what is told to the simulator in place of the commands in inputs X (b, d); weights (b, 2) for each row.

        `goal` (b, k) where it was found from other inputs.
        """
        asked = X[:, self.inputs.command_columns]
        if self.residual is not None:
            goal = asked if self.torque else asked + self.residual.predict(X)
        elif goal is None:
            goal = self.goal(X)
        if self.inverse is not None and self.residual is None:
            Z = np.array(X)
            Z[:, self.inputs.command_columns] = goal
            goal = self.inverse.predict(Z)
        a, b = np.transpose(weights)[:, :, None] if weights is not None else self.weights
        return a * asked + b * goal

    def torques(self, X: Array, weights: Array | None = None) -> Array:
        """(b, k) N m that are added to the joints of `inputs.commands`; (b, 0) without a residual torque."""
        if self.residual is None or not self.torque:
            return np.zeros((len(X), 0))
        return (self.weights[1] if weights is None else weights[:, 1:]) * self.residual.predict(X)

    def weighted(self, requested: float, predicted: float) -> Grounding:
        """The same with other weights."""
        return replace(self, weights=(float(requested), float(predicted)))

    def save(self, path: str | Path) -> None:
        """Writes one NPZ file, whole or not at all. Raises OutputError."""
        arrays: dict[str, Array] = {}
        meta: dict[str, Any] = {
            "format": _FORMAT,
            "weights": self.weights,
            "chained": self.chained,
            "torque": self.torque,
            "about": dict(self.about),
        }
        i = self.inputs
        meta["inputs"] = {"joints": i.joints, "commands": i.commands, "period": i.period, "history": i.history,
                          "others": dict(i.others), "unit": i.unit}  # fmt: skip
        for name, model in (("forward", self.forward), ("inverse", self.inverse), ("residual", self.residual)):
            if model is not None:
                meta[name] = _keep(model, name, arrays)
        meta["blocks"] = [{"name": b.name, "limit": b.limit, "patience": b.patience} for b in self.domain.blocks]
        for k, b in enumerate(self.domain.blocks):
            for part in _PARTS:
                arrays[f"domain/{k}/{part}"] = getattr(b, part)
        with written_aside(Path(path)) as aside, aside.open("wb") as file:
            np.savez_compressed(file, meta=np.array(json.dumps(meta)), **arrays)  # pyright: ignore[reportArgumentType]

    @classmethod
    def load(cls, path: str | Path) -> Grounding:
        """Reads what `save` wrote. Raises GroundingError for any other file."""
        whole = io.BytesIO(files.content(Path(path), GroundingError))
        if not zipfile.is_zipfile(whole):
            raise GroundingError(
                f"{path} is no grounding as `trueup ground` writes it (grounding.npz), or is not whole"
            )
        try:
            with np.load(whole, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(str(arrays.pop("meta")))
            if meta["format"] != _FORMAT:
                raise GroundingError(f"{path}: its format is '{meta['format']}', not '{_FORMAT}'")
            shape = meta["inputs"]
            inputs = Inputs(
                tuple(shape["joints"]), tuple(shape["commands"]), shape["period"], shape["history"],
                {n: tuple(x) for n, x in shape["others"].items()}, shape["unit"],
            )  # fmt: skip
            forward, inverse, residual = (
                _model(meta[n], n, arrays) if n in meta else None for n in ("forward", "inverse", "residual")
            )
            blocks = tuple(_block(b, k, arrays) for k, b in enumerate(meta["blocks"]))
            (requested, predicted), chained, torque = meta["weights"], bool(meta["chained"]), bool(meta.get("torque"))
        except (KeyError, ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise GroundingError(
                f"{path} is no grounding as `trueup ground` writes it, or is damaged: {error}"
            ) from None
        domain = Domain(inputs.names, blocks)
        return cls(inputs, forward, domain, inverse, residual, torque, chained, (requested, predicted), meta["about"])


def _keep(model: Model, name: str, arrays: dict[str, Array]) -> list[str]:
    """Puts a model's arrays among those of the file; the kinds of its predictors."""
    kinds = []
    arrays[f"{name}/base"] = model.base
    for k, (T, predictor) in enumerate(zip(model.maps, model.predictors, strict=True)):
        kind, own = as_arrays(predictor)
        kinds.append(kind)
        arrays[f"{name}/{k}/map"] = T
        arrays.update({f"{name}/{k}/{part}": values for part, values in own.items()})
    return kinds


def _block(told: Mapping[str, Any], k: int, arrays: Mapping[str, Array]) -> Block:
    parts: dict[str, Any] = {part: arrays[f"domain/{k}/{part}"] for part in _PARTS if f"domain/{k}/{part}" in arrays}
    # Files of earlier versions know no ranges: two standard deviations to either side.
    parts.setdefault("low", parts["centre"] - 2.0 * parts["scale"])
    parts.setdefault("high", parts["centre"] + 2.0 * parts["scale"])
    return Block(limit=told["limit"], patience=told["patience"], name=told["name"], **parts)


def _model(kinds: list[str], name: str, arrays: Mapping[str, Array]) -> Model:
    def own(k: int) -> dict[str, Array]:
        first = f"{name}/{k}/"
        return {n.removeprefix(first): v for n, v in arrays.items() if n.startswith(first)}

    each = [own(k) for k in range(len(kinds))]
    predictors = tuple(from_arrays(kind, part) for kind, part in zip(kinds, each, strict=True))
    return Model(tuple(part["map"] for part in each), predictors, arrays[f"{name}/base"])
