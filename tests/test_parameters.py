# SPDX-License-Identifier: Apache-2.0
"""A space of parameters is gone through in its order, and asked for parameters by name."""

from __future__ import annotations

import numpy as np

from trueup.parameters import Parameter, ParameterSpace


def test_a_space_is_gone_through_in_its_order() -> None:
    space = ParameterSpace(tuple(Parameter(name, "", 0.5, 0.0, 1.0) for name in ("b", "a")))
    assert [p.name for p in space] == list(space.names) == ["b", "a"]
    assert space["a"] in space


def test_no_end_of_a_range_lies_beyond_its_bounds_by_a_last_bit() -> None:
    """Else what ended there is refused once the file that says so is given back."""
    bounds = [(0.003, 15.0), (1e-4, 0.2), (0.0002, 0.1)]
    space = ParameterSpace(tuple(Parameter(f"p{k}", "", a, a, b, scale="log") for k, (a, b) in enumerate(bounds)))
    low, high = np.array(bounds).T
    assert (space.from_unit(np.zeros(3)) >= low).all()
    assert (space.from_unit(np.ones(3)) <= high).all()
    assert space.from_unit(np.full(3, 1.1))[0] > 15.0
