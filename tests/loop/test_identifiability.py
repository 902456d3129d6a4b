# SPDX-License-Identifier: Apache-2.0
"""What recordings do not see is said of what can be traded, each by itself where all mixtures are unseen."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import orth

from trueup.loop.descent import Fit
from trueup.loop.identifiability import unseen_directions
from trueup.loop.selection import Choice, kept_notes
from trueup.parameters import Parameter, ParameterSpace

Array = NDArray[np.float64]
NAMES = ("one.damping", "two.damping", "one.kv", "two.kv")
UNIT = "N m s/rad"
SPACE = ParameterSpace(tuple(Parameter(n, UNIT, nominal=v, lower=1e-3, upper=10.0, scale="log")
                             for n, v in zip(NAMES, (1.0, 1.0, 0.1, 1.0), strict=True)))  # fmt: skip
FIT = Fit(SPACE, np.full(4, 0.5), np.ones(10), np.ones((10, 4)), np.ones(10), "")


def covariance(*unseen: tuple[float, ...]) -> Array:
    """(4, 4) of what is known well but for some directions."""
    basis = orth(np.array(unseen, dtype=np.float64).T)
    return np.asarray(1e-6 * np.eye(4) + 100.0 * basis @ basis.T, dtype=np.float64)


@pytest.mark.parametrize(("unseen", "said"), [
    ([(1, 1, 0, 0), (1, -1, 0, 0)], [{"one.damping", "two.damping"}]),
    ([(1, 0, -1, 0)], [{"sum", "one.damping", "one.kv"}]),
    ([(1, 1, -1, -1), (1, -1, -1, 1)], [{"sum", "one.damping", "one.kv"}, {"sum", "two.damping", "two.kv"}]),
    ([(1, -1, 1, 0)], [{"one.damping", "two.damping", "one.kv"}]),
    ([(1, -1, 1, 0), (1, -1, 1, 0)], [{"one.damping", "two.damping", "one.kv"}]),
])  # fmt: skip
def test_mixtures_of_unseen_directions_are_told_apart(unseen: list[tuple[float, ...]], said: list[set[str]]) -> None:
    sentences = [re.findall(r"sum|[\w.]+\.(?:damping|kv)", s) for s in unseen_directions(FIT, covariance(*unseen))]
    assert sorted(map(sorted, sentences)) == sorted(map(sorted, said))


def test_what_is_unseen_alone_is_one_sentence_for_each_motion_that_would_tell() -> None:
    motions = ("slow reversals", "slow reversals", "jumps", "")
    told = [dataclasses.replace(p, shown_by=motion) for p, motion in zip(SPACE.parameters, motions, strict=True)]
    fit = dataclasses.replace(FIT, space=ParameterSpace(tuple(told)))
    assert sorted(unseen_directions(fit, np.asarray(100.0 * np.eye(4)))) == [
        "one.damping, two.damping are not seen by these recordings. Slow reversals would tell.",
        "one.kv is not seen by these recordings. Jumps would tell.",
        "two.kv is not seen by these recordings.",
    ]


def test_parameters_that_are_kept_alike_are_named_in_one_sentence() -> None:
    some = [dataclasses.replace(p, nominal=n) for p, n in zip(SPACE.parameters, (1.0, 2.0, 1.0, 1.0), strict=True)]
    choice = Choice(tuple(p.name for p in some), kept_notes(some))
    assert choice.words() == (
        "one.damping, one.kv, two.kv kept at 1 N m s/rad: told by none of these recordings",
        "two.damping kept at 2 N m s/rad: told by none of these recordings",
    )


def test_a_sum_is_one_of_what_changes_by_as_much() -> None:
    apart = dataclasses.replace(FIT, unit=np.array([0.9, 0.5, 0.4, 0.5]))  # 4 and 0.04 N m s/rad
    (said,) = unseen_directions(apart, covariance((0.01, 0.0, -1.0, 0.0), (0.01, 0.0, -1.0, 0.0)))
    assert "one.kv is not seen" in said
    (said,) = unseen_directions(apart, covariance((1.0, 0.0, -1.0, 0.0)))
    assert "product" in said
