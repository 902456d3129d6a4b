# SPDX-License-Identifier: Apache-2.0
"""What was learned, as plain arrays: evaluated for many rows at once without the library that it was learned with."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import GroundingError


class Predictor(Protocol):
    """A function from inputs to outputs. Its fields are arrays, by which it is kept in a file."""

    def predict(self, X: Array) -> Array:
        """(n, k) outputs of inputs (n, d)."""
        ...


@dataclass(frozen=True, eq=False)
class Affine:
    """Outputs = X W + b."""

    W: Array
    """(d, k)."""
    b: Array
    """(k,)."""

    def predict(self, X: Array) -> Array:
        """See Predictor."""
        return X @ self.W + self.b


@dataclass(frozen=True, eq=False)
class Trees:
    """A tree for each output, all nodes in one table; each leaf holds a number or an affine function.

    A row goes left where its input, in single precision as trees are grown by scikit-learn, is at most the threshold.
    What leaves give is added to one affine function of all rows, from which none departs farther than its own rows did.
    """

    roots: Integers
    """(k,) node of each output."""
    feature: Integers
    """(m,) input that a node asks for; -1: a leaf."""
    threshold: Array
    left: Integers
    right: Integers
    b: Array
    """(m,) of leaves."""
    W: Array
    """(m, d) of leaves; (0, d) where these are numbers."""
    low: Array
    high: Array
    """(m,) least and greatest departure of each leaf."""
    line: Array
    """(d + 1, k) slopes, then values at zero, of what all leaves are added to."""

    def predict(self, X: Array) -> Array:
        """See Predictor."""
        single = X.astype(np.float32)
        at = np.repeat(self.roots[None, :], len(X), axis=0)
        rows = np.arange(len(X))[:, None]
        while True:
            asks = self.feature[at]
            if not (asks >= 0).any():
                break
            less = single[rows, np.maximum(asks, 0)] <= self.threshold[at]
            at = np.where(asks >= 0, np.where(less, self.left[at], self.right[at]), at)
        out = self.b[at]
        if len(self.W):
            out = np.clip(out + np.einsum("nd,nkd->nk", X, self.W[at]), self.low[at], self.high[at])
        return out + X @ self.line[:-1] + self.line[-1]

    @property
    def leaves(self) -> int:
        """How many there are in all."""
        return int(np.sum(self.feature < 0))

    @classmethod
    def together(cls, trees: list[Trees]) -> Trees:
        """The trees of all outputs as one table."""
        first = np.cumsum([0, *(len(t.feature) for t in trees[:-1])])
        moved = {
            name: np.concatenate([getattr(t, name) + at for t, at in zip(trees, first, strict=True)])
            for name in ("roots", "left", "right")
        }
        same = ("feature", "threshold", "b", "W", "low", "high")
        joined = {name: np.concatenate([getattr(t, name) for t in trees]) for name in same}
        return cls(**moved, **joined, line=np.concatenate([t.line for t in trees], axis=1))


@dataclass(frozen=True, eq=False)
class Network:
    """A perceptron with one hidden layer of rectified units, on standardised inputs and outputs."""

    centre: Array
    scale: Array
    W1: Array
    b1: Array
    W2: Array
    b2: Array
    out_centre: Array
    out_scale: Array

    def predict(self, X: Array) -> Array:
        """See Predictor."""
        hidden = np.maximum((X - self.centre) / self.scale @ self.W1 + self.b1, 0.0)
        return (hidden @ self.W2 + self.b2) * self.out_scale + self.out_centre


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The mean of the nearest rows, on standardised inputs."""

    centre: Array
    scale: Array
    points: Array
    """(N, d) standardised."""
    values: Array
    """(N, k)."""
    count: Integers
    """(1,) how many of the nearest."""

    def predict(self, X: Array) -> Array:
        """See Predictor."""
        from scipy.spatial import KDTree

        tree = self.__dict__.get("_tree")
        if tree is None:
            tree = KDTree(self.points)
            object.__setattr__(self, "_tree", tree)  # built once
        _, nearest = tree.query((X - self.centre) / self.scale, k=int(self.count[0]))
        return self.values[nearest].mean(axis=1)


@dataclass(frozen=True, eq=False)
class Tempered:
    """A line, and a share of what another predictor departs from it."""

    line: Affine
    other: Predictor
    share: Array
    """(1,)."""

    def predict(self, X: Array) -> Array:
        """See Predictor."""
        near = self.line.predict(X)
        return near + self.share * (self.other.predict(X) - near)


KINDS: Mapping[str, type[Any]] = {"affine": Affine, "trees": Trees, "network": Network, "neighbours": Neighbours}


_TEMPERED = "tempered "


def as_arrays(predictor: Predictor) -> tuple[str, dict[str, Array]]:
    """The kind of a predictor, and its arrays by name."""
    if isinstance(predictor, Tempered):
        kind, own = as_arrays(predictor.other)
        line, share = predictor.line, predictor.share
        return _TEMPERED + kind, {**own, "tempered.W": line.W, "tempered.b": line.b, "tempered.share": share}
    kind = next(name for name, cls in KINDS.items() if isinstance(predictor, cls))
    return kind, {f.name: getattr(predictor, f.name) for f in dataclasses.fields(KINDS[kind])}


def from_arrays(kind: str, arrays: Mapping[str, Array]) -> Predictor:
    """The predictor of a kind. Raises GroundingError for an unknown kind or missing arrays."""
    if kind.startswith(_TEMPERED):
        other = from_arrays(kind.removeprefix(_TEMPERED), arrays)
        return Tempered(Affine(arrays["tempered.W"], arrays["tempered.b"]), other, arrays["tempered.share"])
    if kind not in KINDS:
        raise GroundingError(f"a model of kind '{kind}' is not known; kinds are: {', '.join(KINDS)}")
    names = [f.name for f in dataclasses.fields(KINDS[kind])]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise GroundingError(f"the model of kind '{kind}' lacks {', '.join(missing)}")
    return KINDS[kind](**{name: arrays[name] for name in names})
