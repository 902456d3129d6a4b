# SPDX-License-Identifier: Apache-2.0
"""Learners that part the inputs: a stump, a tree pruned by left-out rows, one of classes, and the model tree M5.

Splits are found by scikit-learn; what stands in the leaves, and what is pruned, is found here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.grounding.linear import RESOLUTION, standard
from trueup.grounding.predictors import Trees

_FEWEST = 2  # rows in a leaf: Weka's REPTree and J48
_PSEUDO = 15.0  # Quinlan's smoothing constant


def stump(X: Array, Y: Array, rng: np.random.Generator) -> Trees:
    """One question, two numbers."""
    from sklearn.tree import DecisionTreeRegressor

    return Trees.together([_constant(DecisionTreeRegressor(max_depth=1, random_state=0).fit(X, y)) for y in Y.T])


def reduced_error(X: Array, Y: Array, rng: np.random.Generator) -> Trees:
    """Trees grown on two thirds of the rows, pruned where the other third is predicted no worse, then filled by all.

    J. R. Quinlan, "Simplifying decision trees", Int. J. Man-Machine Studies 27, 1987; three folds as Weka's REPTree.
    """
    from sklearn.tree import DecisionTreeRegressor

    order = rng.permutation(len(X))
    grow, prune = order[len(X) // 3 :], order[: len(X) // 3]
    trees = []
    for y in Y.T:
        grown = DecisionTreeRegressor(min_samples_leaf=_FEWEST, random_state=0).fit(X[grow], y[grow])
        tree = grown.tree_
        paths = grown.decision_path(X[prune])
        error = (
            paths.T @ np.ones(len(prune)) * tree.value[:, 0, 0] ** 2
            - 2.0 * tree.value[:, 0, 0] * (paths.T @ y[prune])
            + paths.T @ (y[prune] ** 2)
        )
        leaf = _pruned(tree, np.asarray(error))
        every = grown.decision_path(X)
        counts, sums = every.T @ np.ones(len(X)), every.T @ y
        value = np.where(counts > 0, sums / np.maximum(counts, 1.0), tree.value[:, 0, 0])
        trees.append(_table(tree, leaf, value, np.zeros((0, X.shape[1]))))
    return Trees.together(trees)


def discretised(X: Array, Y: Array, rng: np.random.Generator) -> Trees:
    """Outputs in ten bins of equal width as classes; what is predicted is the mean of the bins by their probability."""
    from sklearn.tree import DecisionTreeClassifier

    trees = []
    for y in Y.T:
        edges = np.linspace(y.min(), y.max(), 11)[1:-1]  # ten classes: Weka's default
        bins = np.digitize(y, edges)
        grown = DecisionTreeClassifier(criterion="entropy", min_samples_leaf=_FEWEST, random_state=0).fit(X, bins)
        means = np.array([y[bins == c].mean() for c in grown.classes_])
        share = grown.tree_.value[:, 0, :]
        value = share @ means / share.sum(axis=1)
        trees.append(_table(grown.tree_, grown.tree_.children_left < 0, value, np.zeros((0, X.shape[1]))))
    return Trees.together(trees)


def model_tree(X: Array, Y: Array, rng: np.random.Generator) -> Trees:
    """M5: a tree with a linear function in each leaf, pruned by the error that is expected on new rows, smoothed.

    J. R. Quinlan, "Learning with continuous classes", AI'92; Y. Wang and I. H. Witten, "Inducing model trees for
    continuous classes", ECML 1997. A subtree gives way to its root's linear function where that one's mean residual,
    times (n + v) / (n - v) for v coefficients, is no larger. All inputs go into each function. Smoothing (15 rows of
    the parent's opinion, as theirs) is done while fitting: as many pseudo-rows, spread as all rows are, that the
    parent's function predicts; so a leaf in which an input does not move keeps its parent's slope.
    """
    from sklearn.tree import DecisionTreeRegressor

    centre, scale = standard(X)
    Z = np.concatenate([np.ones((len(X), 1)), (X - centre) / scale], axis=1)
    whole = Z.T @ Z / len(Z) + RESOLUTION**2 * np.eye(Z.shape[1])
    trees = []
    for y in Y.T:
        # On the residual of the linear function: what is left for a tree to find, which else cuts along its slope.
        line = np.linalg.solve(whole, Z.T @ y / len(Z))
        grown = DecisionTreeRegressor(min_samples_leaf=2 * Z.shape[1], random_state=0).fit(X, y - Z @ line)
        W, error, reach = _functions(grown.tree_, grown.apply(X), Z, y, whole, line)
        slopes, root = (W - line)[:, 1:] / scale, line[1:] / scale
        tree = _table(grown.tree_, _pruned(grown.tree_, error), (W - line)[:, 0] - slopes @ centre, slopes, reach)
        trees.append(replace(tree, line=np.append(root, line[0] - root @ centre)[:, None]))
    return Trees.together(trees)


def _functions(
    tree: Any, leaves: Integers, Z: Array, y: Array, whole: Array, line: Array
) -> tuple[Array, Array, Array]:
    """(m, d + 1) the linear function of each node, (m,) the error expected of it, in rows times their unit, and (m, 2) how
    far it departs from `line` on its rows.
    """
    m, d = tree.node_count, Z.shape[1]
    order = np.argsort(leaves, kind="stable")
    first = np.searchsorted(leaves[order], np.arange(m))
    last = np.searchsorted(leaves[order], np.arange(m), side="right")
    begin, end = np.array(first), np.array(last)
    # Rows sorted by leaf are not sorted by node; a node's rows are those of its leaves.
    below: list[Integers] = [order[a:b] for a, b in zip(begin, end, strict=True)]
    for node in range(m - 1, -1, -1):  # children stand behind their parents
        if tree.children_left[node] >= 0:
            below[node] = np.concatenate([below[tree.children_left[node]], below[tree.children_right[node]]])
    W, error, reach, prior = np.empty((m, d)), np.empty(m), np.empty((m, 2)), _PSEUDO * whole
    parent = np.full(m, -1)
    for node in range(m):
        for child in (tree.children_left[node], tree.children_right[node]):
            if child >= 0:
                parent[child] = node
        rows = below[node]
        own, said, n = Z[rows], line if parent[node] < 0 else W[parent[node]], len(rows)
        gram = own.T @ own
        both = np.linalg.solve(gram + prior, np.column_stack([own.T @ y[rows] + prior @ said, gram]))
        W[node] = both[:, 0]
        v = min(float(np.trace(both[:, 1:])), n - 1.0)  # coefficients that these rows decide
        error[node] = np.sum(np.abs(y[rows] - own @ W[node])) * (n + v) / (n - v)
        away = own @ (W[node] - line)
        reach[node] = away.min(), away.max()
    return W, error, reach


def _pruned(tree: Any, error: Array) -> Mask:
    """(m,) where a tree ends, from the error of each node were it a leaf: a subtree that is no better gives way."""
    left, right = tree.children_left, tree.children_right
    leaf, best = left < 0, np.array(error)
    for node in range(tree.node_count - 1, -1, -1):
        if left[node] >= 0:
            below = best[left[node]] + best[right[node]]
            if error[node] <= below:
                leaf[node] = True
            else:
                best[node] = below
    return leaf


def _constant(grown: Any) -> Trees:
    tree = grown.tree_
    return _table(tree, tree.children_left < 0, tree.value[:, 0, 0], np.zeros((0, grown.n_features_in_)))


def _table(tree: Any, leaf: Mask, b: Array, W: Array, reach: Array | None = None) -> Trees:
    """A tree that ends at `leaf`, with the nodes that can be reached; `reach` (m, 2) of what its leaves give."""
    reached, kept = [0], []
    while reached:
        node = reached.pop()
        kept.append(node)
        if not leaf[node]:
            reached += [int(tree.children_right[node]), int(tree.children_left[node])]
    number = np.zeros(tree.node_count, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    ends = leaf[kept]
    low, high = np.full((2, len(kept)), [[-np.inf], [np.inf]]) if reach is None else reach[kept].T
    return Trees(
        np.zeros(1, dtype=np.int64), np.where(ends, -1, tree.feature[kept]).astype(np.int64),
        np.where(ends, 0.0, tree.threshold[kept]), np.where(ends, 0, number[tree.children_left[kept]]),
        np.where(ends, 0, number[tree.children_right[kept]]), np.array(b[kept]), np.array(W[kept]) if len(W) else W,
        low, high, np.zeros((W.shape[1] + 1, 1)),
    )  # fmt: skip
