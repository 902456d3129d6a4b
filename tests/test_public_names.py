# SPDX-License-Identifier: Apache-2.0
"""The names that `trueup` offers: each is there, known to type checkers too, and an unknown one is named."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import trueup


def names_for_type_checkers() -> set[str]:
    tree = ast.parse(Path(trueup.__file__).read_text("utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    return {alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}


@pytest.mark.parametrize("name", sorted(trueup._HOME))
def test_a_public_name_can_be_used(name: str) -> None:
    assert name in dir(trueup)
    assert getattr(trueup, name).__module__.startswith("trueup")


def test_type_checkers_and_python_see_the_same_names() -> None:
    assert names_for_type_checkers() == set(trueup._HOME)


def test_an_unknown_name_lists_the_public_ones() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'Recordin'; public names are: .*Calibration"):
        trueup.Recordin  # noqa: B018
