# SPDX-License-Identifier: Apache-2.0
"""What a search must offer: it asks for candidates in the unit box and is told how good they were."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from trueup.arrays import Array
from trueup.errors import CalibrationError

SearchState = dict[str, Any]
"""Plain numbers, strings and lists (it is written as JSON); a search made from it goes on as if never interrupted."""


class Search(Protocol):
    """Ask and tell over the unit box. `trueup.testing.check_search` holds the contract as tests."""

    def ask(self) -> Array:
        """(b, n) candidates in [0, 1] to be evaluated next."""
        ...

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses (b,) of the candidates; NaN where an evaluation failed. Least squares takes residuals (b, m)."""
        ...

    @property
    def done(self) -> str:
        """Why the search has ended, or '' while it has not."""
        ...

    @property
    def best(self) -> tuple[Array, float]:
        """The best candidate (n,) so far and its loss."""
        ...

    def state(self) -> SearchState:
        """Everything needed to go on later, random generator included."""
        ...


def saved_point(state: SearchState, own: Array) -> Array:
    """(n,) the point of a saved search. Raises CalibrationError where it has another number of parameters than `own` (n,)."""
    point = np.asarray(state["point"], dtype=np.float64)
    if point.shape != own.shape:
        raise CalibrationError(f"the saved search has {len(point)} parameters, this one {len(own)}")
    return point


def same_search(same: bool) -> None:
    """Raises CalibrationError where a saved search was made otherwise than the one that shall go on from it."""
    if not same:
        raise CalibrationError("the saved search had another seed or other parameters; start in a new folder")
