# SPDX-License-Identifier: Apache-2.0
"""Reads NumPy files: .npz (arrays by name) and .npy (one array). Nothing in them is ever executed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.errors import FormatError
from trueup.formats.rules.names import is_time
from trueup.formats.table import Table

_SHORT = 64
"""Numbers in an array that may be a fact of each joint, such as its gain."""


def read(path: Path) -> Table:
    """The table in a .npz or .npy file: arrays of shape (T,), (T, k), or (k, T) beside a time of T samples.

    Single numbers and texts, and short arrays of numbers that are no signal, go to `metadata`. Raises FormatError for a
    damaged file, and for arrays that do not fit together.
    """
    arrays = _load(path)
    facts = {name: str(array.reshape(-1)[0]) for name, array in arrays.items() if array.size == 1}
    names = [array for array in arrays.values() if array.dtype.kind in "US" and array.ndim == 1 and array.size > 1]
    numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "biuf" and array.size > 1}
    if not numeric:
        kinds = ", ".join(f"{name} {array.dtype} {array.shape}" for name, array in arrays.items())
        raise FormatError(f"{path}: no array of numbers; arrays are: {kinds or 'none'}")
    length = _length(numeric)
    columns: dict[str, Array] = {}
    warnings: list[str] = []
    for name, array in numeric.items():
        values = _oriented(array, length)
        if values is None:
            warnings.append(f"{path.name}: array '{name}' of shape {array.shape} is no signal of {length} samples")
            facts |= {name: str(array.tolist())} if array.ndim == 1 and array.size <= _SHORT else {}
        else:
            columns[name] = values
    labels = tuple(str(label) for label in names[0]) if names else ()
    return Table(
        path.name, str(path), columns, labels=labels, row_word="sample", metadata=facts, warnings=tuple(warnings)
    )


def _load(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if not isinstance(loaded, np.ndarray):
                return {name: np.asarray(loaded[name]) for name in loaded.files}
        array = np.atleast_1d(loaded)
        if array.ndim == 2:
            return {f"column_{i + 1}": array[:, i] for i in range(array.shape[1])}
        return {"column_1": array}
    except Exception as error:  # a damaged archive raises whatever its deepest part raises
        reason = str(error) or type(error).__name__
        if "pickle" in reason:
            reason = "it holds Python objects, which are not read; save plain arrays"
        raise FormatError(f"{path}: cannot be read as a NumPy file ({reason})") from error


def _length(arrays: Mapping[str, NDArray[Any]]) -> int:
    """How many samples there are: the length of the time, else the most common length."""
    clocks = [array.size for name, array in arrays.items() if is_time(name) and array.ndim == 1]
    if clocks:
        return max(clocks)
    lengths = [max(array.shape) for array in arrays.values()]
    return max(set(lengths), key=lambda n: (lengths.count(n), n))


def _oriented(array: NDArray[Any], length: int) -> Array | None:
    """(T,) or (T, k); None where no axis has T entries."""
    squeezed = array.squeeze()
    if squeezed.ndim == 1 and len(squeezed) == length:
        return squeezed.astype(np.float64)
    if array.ndim == 2 and array.shape[0] == length:
        return array.astype(np.float64)
    if array.ndim == 2 and array.shape[1] == length:
        return array.T.astype(np.float64)
    return None
