# SPDX-License-Identifier: Apache-2.0
"""Reads HDF5: groups of arrays, as data sets of demonstrations, pandas and MATLAB 7.3 write them.

Links to other files are not followed.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import MissingExtraError
from trueup.formats.guarded import guarded
from trueup.formats.table import Table
from trueup.formats.tree import Leaf, Tree, runs

_UNITS, _NAMES = ("unit", "units"), ("names", "labels", "columns", "joint_names", "joints")


def read(path: Path) -> list[tuple[str, list[Table]]]:
    """(name, tables) of each run. Raises FormatError for a damaged file, MissingExtraError without h5py."""
    if find_spec("h5py") is None:
        raise MissingExtraError("reading HDF5 files (MATLAB 7.3 ones are)", "h5py", "hdf5")
    return runs(guarded(groups, path, "HDF5"), path)


def groups(path: Path) -> Tree:
    """A file's groups. Raises whatever h5py does."""
    import h5py

    with h5py.File(path, "r") as file:
        return _tree(file, h5py)


def _tree(group: Any, h5py: Any) -> Tree:
    tree = Tree({name: Leaf(np.asarray(value)) for name, value in group.attrs.items() if _plain(value)})
    named = {key: _texts(group.attrs[key]) for key in _NAMES if key in group.attrs}
    tree.leaves.update({key: Leaf(np.array(texts)) for key, texts in named.items() if len(texts) > 1})
    for name in group:
        if name == "#refs#" or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        entry = group[name]
        if isinstance(entry, h5py.Group):
            tree.branches[name] = _tree(entry, h5py)
        elif entry.dtype.names:  # a table of rows
            rows = entry[()]
            tree.branches[name] = Tree({f: Leaf(rows[f]) for f in entry.dtype.names if rows[f].dtype.kind in "biuf"})
        elif (leaf := _leaf(entry)) is not None:
            tree.leaves[name] = leaf
    return _of_pandas(tree)


def _plain(value: Any) -> bool:
    return isinstance(value, (str, int, float, np.integer, np.floating))


def _leaf(entry: Any) -> Leaf | None:
    """Numbers with at most two axes that are longer than one, or texts."""
    # Pictures have more axes: they are no signals, and not loaded.
    if len([n for n in entry.shape if n > 1]) > 2 or not entry.size:
        return None
    said = entry.attrs.get("MATLAB_class", b"")
    if said == b"char":
        return Leaf(np.array("".join(chr(int(c)) for c in np.ravel(entry[()]))))
    values = entry[()]
    if entry.dtype.kind in "biuf":
        unit = next((_text(entry.attrs[key]) for key in _UNITS if key in entry.attrs), "")
        names = next((_texts(entry.attrs[key]) for key in _NAMES if key in entry.attrs), ())
        return Leaf(np.asarray(values), unit, names)
    texts = _texts(values)
    return Leaf(np.array(texts if entry.shape else texts[0])) if texts else None


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _texts(value: Any) -> tuple[str, ...]:
    """Texts of an attribute or a data set; () for what holds anything else."""
    flat: NDArray[Any] = np.ravel(np.asarray(value, dtype=object))
    return tuple(_text(v) for v in flat) if all(isinstance(v, bytes | str) for v in flat) else ()


def _of_pandas(tree: Tree) -> Tree:
    """A data frame's blocks as columns with their names, beside its index."""
    blocks = [
        name.removesuffix("_values") for name in tree.leaves if name.startswith("block") and name.endswith("_values")
    ]
    if "axis1" not in tree.leaves or not all(f"{block}_items" in tree.leaves for block in blocks) or not blocks:
        return tree
    leaves = {"index": tree.leaves["axis1"]}
    for block in blocks:
        items, values = np.ravel(tree.leaves[f"{block}_items"].values), tree.leaves[f"{block}_values"].values
        leaves |= {str(item): Leaf(column) for item, column in zip(items, values.T, strict=True)}
    return Tree(leaves, tree.branches)
