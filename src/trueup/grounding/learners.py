# SPDX-License-Identifier: Apache-2.0
"""The ten learners of the paper's Table 2, by name."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import MissingExtraError, unknown_name
from trueup.grounding import linear, trees
from trueup.grounding.linear import standard
from trueup.grounding.predictors import Neighbours, Network, Predictor, Tempered


def network(X: Array, Y: Array, rng: np.random.Generator) -> Network:
    """A perceptron with one hidden layer of (d + k) / 2 units (Weka's default), by quasi-Newton steps."""
    rounds = 300  # of the network's search
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    centre, scale = standard(X)
    middle, spread = standard(Y)
    V = (Y - middle) / spread
    units = max((X.shape[1] + Y.shape[1]) // 2, 2)
    start = int(rng.integers(2**31))
    net = MLPRegressor(hidden_layer_sizes=(units,), solver="lbfgs", alpha=1e-3, max_iter=rounds, random_state=start)
    with warnings.catch_warnings():  # that it could go on is no news
        warnings.simplefilter("ignore", ConvergenceWarning)
        net.fit((X - centre) / scale, V if V.shape[1] > 1 else V[:, 0])
    (W1, W2), (b1, b2) = net.coefs_, net.intercepts_
    return Network(centre, scale, W1, b1, W2, b2, middle, spread)


def neighbours(X: Array, Y: Array, rng: np.random.Generator) -> Neighbours:
    """The mean of the five nearest rows, inputs in units of their standard deviation."""
    nearest = 5
    centre, scale = standard(X)
    return Neighbours(centre, scale, (X - centre) / scale, np.array(Y), np.array([min(nearest, len(X))]))


@dataclass(frozen=True)
class Learner:
    """A way to learn outputs from inputs."""

    name: str
    weka: str
    """What the paper's Table 2 calls it."""
    fit: Callable[[Array, Array, np.random.Generator], Predictor]
    """From inputs (n, d) and outputs (n, k)."""
    library: str = ""
    """That it needs."""


LEARNERS = {
    learner.name: learner
    for learner in (
        Learner("simple-linear", "SimpleLinearRegression", linear.simple),
        Learner("linear", "LinearRegression", linear.least_squares),
        Learner("least-median", "LeastMedSq", linear.least_median),
        Learner("pace", "PaceRegression", linear.pace),
        Learner("network", "MultilayerPerceptron", network, "sklearn"),
        Learner("stump", "DecisionStump", trees.stump, "sklearn"),
        Learner("model-tree", "M5P", trees.model_tree, "sklearn"),
        Learner("tree", "REPTree", trees.reduced_error, "sklearn"),
        Learner("neighbours", "IBk", neighbours),
        Learner("discretised", "RegressionByDiscretization", trees.discretised, "sklearn"),
    )
}


def tempered(learner: Learner, share: float) -> Learner:
    """One that takes a share of what `learner` departs from a line (stacking: L. Breiman, Machine Learning 24, 1996)."""

    def fit(X: Array, Y: Array, rng: np.random.Generator) -> Predictor:
        return Tempered(linear.least_squares(X, Y, rng), learner.fit(X, Y, rng), np.array([share]))

    return replace(learner, fit=fit)


def learners(names: Sequence[str] | None = None) -> tuple[Learner, ...]:
    """Those named, or all that this installation can run.

    Raises UnknownNameError, and MissingExtraError for one whose library is absent.
    """
    if names is None:
        return tuple(learner for learner in LEARNERS.values() if _present(learner))
    for name in names:
        if name not in LEARNERS:
            raise unknown_name("learner", name, LEARNERS, "what trueup knows")
        if not _present(LEARNERS[name]):
            raise MissingExtraError(f"learner '{name}'", "scikit-learn", "grounding")
    return tuple(LEARNERS[name] for name in names)


def _present(learner: Learner) -> bool:
    return not learner.library or importlib.util.find_spec(learner.library) is not None
