# SPDX-License-Identifier: Apache-2.0
"""A space of parameters is gone through in its order, and asked for parameters by name."""

from __future__ import annotations

from trueup.parameters import Parameter, ParameterSpace


def test_a_space_is_gone_through_in_its_order() -> None:
    space = ParameterSpace(tuple(Parameter(name, "", 0.5, 0.0, 1.0) for name in ("b", "a")))
    assert [p.name for p in space] == list(space.names) == ["b", "a"]
    assert space["a"] in space
