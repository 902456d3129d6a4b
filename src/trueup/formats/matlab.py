# SPDX-License-Identifier: Apache-2.0
"""Reads MATLAB's .mat files: variables, structs and lists of them; files of version 7.3 are HDF5."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trueup.errors import FormatError
from trueup.formats import hdf5
from trueup.formats.guarded import guarded
from trueup.formats.table import Table
from trueup.formats.tree import Leaf, Tree, runs

_NEWER = b"MATLAB 7.3"
_OBJECTS = (
    "timetables, tables, timeseries and Simulink's datasets are objects that only MATLAB reads: save arrays, or a struct of "
    "them (s.time = seconds(t.Time); s.q = t.q; of a dataset element e: s.time = e.Values.Time; s.q = e.Values.Data)"
)


def read(path: Path) -> list[tuple[str, list[Table]]]:
    """(name, tables) of each run. Raises FormatError for a damaged file, and for one that holds objects alone."""
    with path.open("rb") as file:
        if file.read(len(_NEWER)) == _NEWER:
            return hdf5.read(path)
    tree = guarded(variables, path, "a MAT-file")
    if not any(leaf.values.dtype.kind in "biuf" and leaf.values.size > 1 for _, leaf in tree.every()):
        there = ", ".join(".".join(where) for where, _ in tree.every())
        raise FormatError(f"{path}: no array of numbers; variables are: {there or 'none'}. {_OBJECTS}")
    return runs(tree, path)


def variables(path: Path) -> Tree:
    """A file's variables. Raises whatever `loadmat` does."""
    from scipy.io import loadmat  # takes long to import

    loaded = loadmat(path, simplify_cells=True)
    return _tree({name: value for name, value in loaded.items() if not name.startswith("__")})


def _tree(data: Mapping[str, Any]) -> Tree:
    """Structs as branches; of an array of structs each by its label, its block or its number."""
    tree = Tree()
    for name, value in data.items():
        if isinstance(value, dict):
            tree.branches[name] = _tree(value)
        elif isinstance(value, list | np.ndarray) and len(np.shape(value)) and all(isinstance(v, dict) for v in value):
            parts = {_signal_name(part) or str(k + 1): _tree(part) for k, part in enumerate(value)}
            tree.branches.update({f"{name}{key}" if key.isdigit() else key: part for key, part in parts.items()})
        elif (leaf := _leaf(value)) is not None:
            tree.leaves[name] = leaf
    return tree


def _signal_name(part: Mapping[str, Any]) -> str:
    """How Simulink names a signal."""
    return next((str(part[key]) for key in ("label", "blockName") if isinstance(part.get(key), str) and part[key]), "")


def _leaf(value: Any) -> Leaf | None:
    """Numbers, a text, or a list of texts; None for objects."""
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        value = np.array(value, dtype=np.str_)
    array = np.asarray(value) if not isinstance(value, list) else np.zeros(0)
    if array.dtype == object and array.size and all(isinstance(v, str) for v in array.flat):
        array = array.astype(np.str_)
    return Leaf(array) if array.dtype.kind in "biufUS" and array.size else None
