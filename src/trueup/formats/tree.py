# SPDX-License-Identifier: Apache-2.0
"""Arrays below nested names, as MATLAB, HDF5 and NumPy files hold them, as tables: one for each clock, of each run."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.errors import FormatError
from trueup.formats.rules.names import is_time, says_nanoseconds
from trueup.formats.table import JOINTS, Table, unique_names

_SAYS_NOTHING = frozenset({"signals", "values", "data", "observations"})
"""Names of containers alone, as Simulink and data sets of demonstrations have them."""


@dataclass(frozen=True, eq=False)
class Leaf:
    """One array, or a text, with what its file says of it."""

    values: NDArray[Any]
    unit: str = ""
    names: tuple[str, ...] = ()
    """Of its columns."""


@dataclass(frozen=True, eq=False)
class Tree:
    """Leaves and further trees by name."""

    leaves: dict[str, Leaf] = field(default_factory=dict)
    branches: dict[str, Tree] = field(default_factory=dict)

    def every(self, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Leaf]]:
        """All leaves with their names from here on."""
        for name, leaf in self.leaves.items():
            yield (*before, name), leaf
        for name, branch in self.branches.items():
            yield from branch.every((*before, name))


def runs(tree: Tree, path: Path) -> list[tuple[str, list[Table]]]:
    """(name, tables) of each run in a file's tree: branches that are numbered and hold the same are runs of their own.

    Arrays are (T,), (T, k), or (k, T) beside a time of T samples; single numbers and texts, and short arrays that are no
    signal, go to `metadata`. Raises FormatError where there is no array of numbers.
    """
    while len(tree.branches) == 1 and not any(_is_numbers(leaf) for leaf in tree.leaves.values()):
        (inner,) = tree.branches.values()
        tree = Tree({**tree.leaves, **inner.leaves}, inner.branches)
    alike = _numbered(tree)
    if not alike:
        return [(path.stem, _tables(_without_names(tree), path))]
    shared = {name: leaf for name, leaf in tree.leaves.items() if not _is_numbers(leaf)}
    return [
        (f"{path.stem}_{name}", _tables(Tree({**shared, **branch.leaves}, branch.branches), path))
        for name, branch in alike.items()
    ]


def table_of(leaves: Mapping[str, Leaf], name: str, path: str) -> Table:
    """The table of arrays that share a clock, or have none. Raises FormatError where none holds numbers."""
    arrays = {key: leaf.values for key, leaf in leaves.items()}
    facts = {key: str(array.reshape(-1)[0]) for key, array in arrays.items() if array.size == 1}
    words = [array for array in arrays.values() if array.dtype.kind in "US" and array.ndim == 1 and array.size > 1]
    numeric = {key: array for key, array in arrays.items() if array.dtype.kind in "biuf" and array.size > 1}
    if not numeric:
        kinds = ", ".join(f"{key} {array.dtype} {array.shape}" for key, array in arrays.items())
        raise FormatError(f"{path}: no array of numbers; arrays are: {kinds or 'none'}")
    length = _length(numeric)
    columns: dict[str, Array] = {}
    warnings: list[str] = []
    for key, array in numeric.items():
        values = _oriented(array, length)
        if values is None:
            warnings.append(f"{name}: array '{key}' of shape {array.shape} is no signal of {length} samples")
            facts |= {key: str(array.tolist())} if array.ndim == 1 and array.size <= JOINTS else {}
        else:
            columns[key] = values
    named = {
        key: leaves[key].names for key, values in columns.items()
        if values.ndim == 2 and len(leaves[key].names) == values.shape[1]
    }  # fmt: skip
    said = set(named.values())
    wide = {values.shape[1] for values in columns.values() if values.ndim == 2}
    words.sort(key=lambda array: array.size not in wide)  # cameras have names too
    labels = tuple(str(label) for label in words[0]) if words else said.pop() if len(said) == 1 else ()
    units = {key: leaves[key].unit for key in columns if leaves[key].unit}
    return Table(name, path, columns, units=units, labels=labels, named=named, row_word="sample", metadata=facts,
                 warnings=tuple(warnings))  # fmt: skip


def _without_names(tree: Tree) -> Tree:
    """The tree, in place of its only array of numbers the columns of that."""
    numeric = [(name, leaf) for name, leaf in tree.leaves.items() if _is_numbers(leaf)]
    if len(numeric) != 1 or tree.branches or numeric[0][1].values.ndim != 2 or numeric[0][1].names:
        return tree
    name, leaf = numeric[0]
    columns = {f"column_{k + 1}": Leaf(column) for k, column in enumerate(leaf.values.T)}
    return Tree({key: other for key, other in tree.leaves.items() if key != name} | columns)


def _numbered(tree: Tree) -> dict[str, Tree]:
    """Branches whose names differ in a number alone and that hold the same; {} for fewer than two."""
    kinds: dict[tuple[str, frozenset[tuple[str, ...]]], dict[str, Tree]] = {}
    for name, branch in tree.branches.items():
        held = frozenset(where for where, leaf in branch.every() if _is_numbers(leaf))
        if held and re.search(r"\d", name):
            kinds.setdefault((re.sub(r"\d+", "", name), held), {})[name] = branch
    most = max(kinds.values(), key=len, default={})
    timed = any(is_time(name) for branch in most.values() for name in branch.leaves)
    several = any(len(where) > 1 for _, held in kinds for where in held) or all(
        len(b.leaves) > 1 for b in most.values()
    )
    return most if len(most) > 1 and (timed or several) and not _clocked(tree) else {}


def _tables(tree: Tree, path: Path) -> list[Table]:
    """One for each clock, the largest first; what has no clock of its own goes with the only one there is."""
    clocks = [(where, leaf) for where, leaf in tree.every() if is_time(where[-1]) and _is_clock(leaf)]
    clocks = [(where, leaf) for where, leaf in clocks if not _is_rest(where, clocks)]
    different: list[tuple[tuple[str, ...], Leaf]] = []
    for where, leaf in clocks:
        if not any(np.array_equal(leaf.values.ravel(), other.values.ravel()) for _, other in different):
            different.append((where, leaf))
    parts: list[dict[tuple[str, ...], Leaf]] = [{where: leaf} for where, leaf in different] or [{}]
    for where, leaf in tree.every():
        if not any(leaf is clock for _, clock in clocks):
            near = max(clocks, key=lambda c: _shared(where, c[0]), default=(where, leaf))[1].values.ravel()
            same = (k for k, (_, clock) in enumerate(different) if np.array_equal(clock.values.ravel(), near))
            parts[next(same, 0)][where] = leaf
    kept = [part for part in parts if any(_is_numbers(leaf) for leaf in part.values())]
    found = [_table(part, path, several=len(kept) > 1) for part in kept or parts]
    return sorted(found, key=lambda t: -sum(v.size for v in t.columns.values()))


def _table(part: Mapping[tuple[str, ...], Leaf], path: Path, *, several: bool) -> Table:
    """Its columns by the shortest names that tell them apart from containers."""
    plain = {where: [name for name in where if name.lower() not in _SAYS_NOTHING] or [where[-1]] for where in part}
    first = min((names[:-1] for names in plain.values()), key=len, default=[])
    common = next((k for k, piece in enumerate(first) if any(n[k] != piece for n in plain.values())), len(first))
    names = unique_names([".".join(pieces[common:]) for pieces in plain.values()])
    leaves = dict(zip(names, part.values(), strict=True))
    group = "/".join(first[:common]) if several else ""
    name = group or path.name
    return table_of(leaves, name, f"{path} {group}".rstrip())


def _shared(one: Sequence[str], other: Sequence[str]) -> int:
    """How many names two places have in common from the root on, that of the other itself left out."""
    pairs = zip(one, other[:-1], strict=False)
    return next((k for k, (a, b) in enumerate(pairs) if a != b), min(len(one), len(other) - 1))


def _clocked(tree: Tree) -> bool:
    return any(is_time(name) and _is_clock(leaf) for name, leaf in tree.leaves.items())


def _is_clock(leaf: Leaf) -> bool:
    return _is_numbers(leaf) and max(leaf.values.shape) == leaf.values.size


def _is_rest(where: tuple[str, ...], clocks: Sequence[tuple[tuple[str, ...], Leaf]]) -> bool:
    """Whether these are the nanoseconds of whole seconds that stand beside them, and no clock by themselves."""
    beside = [leaf for other, leaf in clocks if other[:-1] == where[:-1] and not says_nanoseconds(other[-1])]
    return says_nanoseconds(where[-1]) and any(np.all(leaf.values == np.round(leaf.values)) for leaf in beside)


def _is_numbers(leaf: Leaf) -> bool:
    return leaf.values.dtype.kind in "biuf" and leaf.values.size > 1


def _length(arrays: Mapping[str, NDArray[Any]]) -> int:
    """How many samples there are: the length of the time, else the most common length."""
    clocks = [array.size for name, array in arrays.items() if is_time(name) and array.size == max(array.shape)]
    if clocks:
        return max(clocks)
    lengths = [max(array.shape) for array in arrays.values()]
    return max(set(lengths), key=lambda n: (lengths.count(n), n))


def _oriented(array: NDArray[Any], length: int) -> Array | None:
    """(T,) or (T, k); None where no axis has T entries."""
    squeezed = array.squeeze()
    if squeezed.ndim == 1 and len(squeezed) == length:
        return squeezed.astype(np.float64)
    if squeezed.ndim == 2 and squeezed.shape[0] == length:
        return squeezed.astype(np.float64)
    if squeezed.ndim == 2 and squeezed.shape[1] == length:
        return squeezed.T.astype(np.float64)
    return None
