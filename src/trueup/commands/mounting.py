# SPDX-License-Identifier: Apache-2.0
"""How an arm is mounted, as users say it: the direction of gravity in the base's frame."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trueup.errors import IdentificationError
from trueup.rounding import TINY
from trueup.units import EARTH, GRAVITY

if TYPE_CHECKING:
    from trueup.identification.kinematic_tree import KinematicTree


def add_gravity(parser: argparse.ArgumentParser, more: str = "") -> None:
    """The argument, the same wherever an arm is loaded; `more` says what holds without it."""
    said = f"acceleration of gravity in the base frame, m/s^2, for an arm on a wall or ceiling{more}"
    parser.add_argument("--gravity", nargs=3, type=float, metavar=("X", "Y", "Z"), help=said)


def mounted(tree: KinematicTree, gravity: Sequence[float] | None) -> tuple[KinematicTree, list[str]]:
    """The tree with gravity as it was given (3,), m/s^2, and what is strange about it; as it is where none was.

    Raises IdentificationError where a number is not finite.
    """
    return (tree, []) if gravity is None else (tree.replace(gravity=gravity), strange(gravity))


def strange(gravity: Sequence[float]) -> list[str]:
    """What is strange about gravity as it was given (3,), m/s^2. Raises IdentificationError where a number is not finite."""
    given, size = in_words(gravity), float(np.linalg.norm(gravity))
    if not np.isfinite(size):
        raise IdentificationError(f"--gravity {given}: three finite numbers are needed, in m/s^2, as 0 0 -{GRAVITY:g}")
    if size <= TINY or EARTH[0] <= size <= EARTH[1]:
        return []
    earthly = in_words(np.asarray(gravity) * GRAVITY / size)
    return [f"--gravity {given} is {size:.4g} m/s^2; on Earth it is {GRAVITY:g}, in that direction --gravity {earthly}"]


def in_words(gravity: Iterable[float]) -> str:
    """Three numbers (3,) as the command takes them, to the mm/s^2."""
    return " ".join(f"{round(float(g), 3) + 0.0:g}" for g in gravity)
