# SPDX-License-Identifier: Apache-2.0
"""How a contract check says that a contract is broken."""

from __future__ import annotations


class ContractBrokenError(AssertionError):
    """An extension does not keep its contract; test runners report it as a failed test."""


def require(kept: bool, what: str) -> None:
    """Raises ContractBrokenError with `what` unless `kept`."""
    if not kept:
        raise ContractBrokenError(what)
