# SPDX-License-Identifier: Apache-2.0
"""The kinematic tree of a model file, whichever format it has."""

from __future__ import annotations

from pathlib import Path

from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.mjcf import tree_from_mjcf
from trueup.identification.urdf import is_urdf, tree_from_urdf


def load_tree(path: str | Path, *, fix_base: bool = False) -> KinematicTree:
    """The tree of a URDF or MJCF file; meshes are not needed. `fix_base` welds a floating base where it stands.

    Raises ModelError where the file cannot be read or has joints that are neither revolute nor prismatic.
    """
    return tree_from_urdf(path, fix_base=fix_base) if is_urdf(path) else tree_from_mjcf(path, fix_base=fix_base)
