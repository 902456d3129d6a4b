# SPDX-License-Identifier: Apache-2.0
"""What of the inputs each prediction looks at: all as they are, as the paper did, or relative to where the joints stand.

A joint's next position is its present one and a little more. A learner that has to find that out first spends its leaves
or its neighbours on where the robot stood; robots in other postures are then foreign to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import unknown_name
from trueup.grounding.learners import Learner
from trueup.grounding.predictors import Predictor
from trueup.grounding.rows import Inputs, Rows


@dataclass(frozen=True, eq=False)
class Model:
    """Predictors of all outputs together, or one for each, on linear combinations of the inputs."""

    maps: tuple[Array, ...]
    """(d, m) each: from inputs to what a predictor takes; one for all outputs, or one for each."""
    predictors: tuple[Predictor, ...]
    """One for each of `maps`."""
    base: Array
    """(d, k): what is added to the predictors' outputs, the present positions or nothing."""

    def predict(self, X: Array) -> Array:
        """(n, k) outputs of inputs (n, d)."""
        parts = [p.predict(X @ T) for p, T in zip(self.predictors, self.maps, strict=True)]
        return np.concatenate(parts, axis=1) + X @ self.base


def plain(inputs: Inputs) -> list[Array]:
    """All inputs as they are: the paper's."""
    return [np.eye(len(inputs.names))]


def relative(inputs: Inputs) -> list[Array]:
    """Positions; commands, also earlier ones, relative to these; what positions changed by; other channels."""
    return [np.concatenate([_pose(inputs), _motion(inputs, range(len(inputs.commands))), _others(inputs)], axis=1)]


def joint_alone(inputs: Inputs) -> list[Array]:
    """The same of the predicted joint alone, and other channels."""
    pose, others, each = _pose(inputs), _others(inputs), range(len(inputs.commands))
    return [np.concatenate([pose[:, [inputs.position_columns[o]]], _motion(inputs, [o]), others], axis=1) for o in each]


def posed(inputs: Inputs) -> list[Array]:
    """That, and the positions of all joints: what loads a joint depends on them."""
    pose, others, each = _pose(inputs), _others(inputs), range(len(inputs.commands))
    return [np.concatenate([pose, _motion(inputs, [o]), others], axis=1) for o in each]


VIEWS: Mapping[str, Callable[[Inputs], list[Array]]] = {
    "plain": plain, "relative": relative, "posed": posed, "own": joint_alone,
}  # fmt: skip
"""Name to the combinations of inputs that predictors take."""


def view_named(name: str) -> Callable[[Inputs], list[Array]]:
    """Raises UnknownNameError, which lists the names."""
    if name not in VIEWS:
        raise unknown_name("view", name, VIEWS, "what a prediction may look at")
    return VIEWS[name]


def fitted(learner: Learner, rows: Rows, rng: np.random.Generator, view: str = "plain", *, moves: bool = True) -> Model:
    """The model that a learner makes of rows that it sees in this way; what is learned `moves` the present positions on."""
    maps = view_named(view)(rows.inputs)
    base = np.zeros((len(rows.inputs.names), len(rows.inputs.commands)))
    if view != "plain" and moves:
        base[rows.inputs.position_columns, np.arange(len(rows.inputs.commands))] = 1.0
    left = rows.Y - rows.X @ base
    outputs = [slice(None)] if len(maps) == 1 else [slice(o, o + 1) for o in range(len(maps))]
    fits = [learner.fit(rows.X @ T, left[:, o], rng) for T, o in zip(maps, outputs, strict=True)]
    return Model(tuple(maps), tuple(fits), base)


def _unit(inputs: Inputs, at: int) -> Array:
    return np.eye(len(inputs.names))[:, at]


def _pose(inputs: Inputs) -> Array:
    return np.eye(len(inputs.names))[:, : len(inputs.joints)]


def _others(inputs: Inputs) -> Array:
    first = len(inputs.joints) + len(inputs.commands)
    return np.eye(len(inputs.names))[:, first : first + sum(len(x) for x in inputs.others.values())]


def _motion(inputs: Inputs, outputs: range | list[int]) -> Array:
    """(d, 2 h - 1 for each output) commands of all frames relative to the present position, what that changed by in each.

    Of a drive that is late the command of one of these frames acts, which a tree can ask for as it stands here.
    """
    frames, j, columns = inputs.frames, len(inputs.joints), []
    for o in outputs:
        place = int(inputs.position_columns[o])
        columns.append(_unit(inputs, j + o) - _unit(inputs, place))
        for before, after in zip(frames[1:], frames, strict=False):
            columns.append(_unit(inputs, after + place) - _unit(inputs, before + place))
            columns.append(_unit(inputs, before + j + o) - _unit(inputs, place))
    return np.stack(columns, axis=1)
