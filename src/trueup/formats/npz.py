# SPDX-License-Identifier: Apache-2.0
"""Reads NumPy files: .npz (arrays by name) and .npy (one array). Nothing in them is ever executed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import FormatError
from trueup.formats.table import Table
from trueup.formats.tree import Leaf, table_of


def read(path: Path) -> Table:
    """The table in a .npz or .npy file, as `tree.table_of` makes it. Raises FormatError for a damaged file."""
    return table_of({name: Leaf(array) for name, array in _load(path).items()}, path.name, str(path))


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
