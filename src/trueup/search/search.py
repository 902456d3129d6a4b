# SPDX-License-Identifier: Apache-2.0
"""What a search must offer: it asks for candidates in the unit box and is told how good they were."""

from __future__ import annotations

from typing import Any, Protocol

from trueup.arrays import Array

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
