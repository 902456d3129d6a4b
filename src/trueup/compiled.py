# SPDX-License-Identifier: Apache-2.0
"""Inner loops as machine code: what numba takes to compile them, once a machine, is said and is no part of any search."""

from __future__ import annotations

import time
import warnings
from typing import Any

from numba import njit
from numba.core import event

__all__ = ["clock", "njit"]

_SILENT = 2.0  # s of compiling after which a user is told why nothing happens


class _Compiling(event.Listener):
    """Adds up the time in which functions are compiled, those that they call included, and warns once where it is long."""

    def __init__(self) -> None:
        self.seconds, self._depth, self._began, self._said = 0.0, 0, 0.0, False

    def on_start(self, event: Any) -> None:
        """A function, or one that it calls, is being compiled; numba lets one thread do so at a time."""
        if not self._depth:
            self._began = time.perf_counter()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is done, or has failed."""
        self._depth -= 1
        if self._depth:
            return
        self.seconds += time.perf_counter() - self._began
        if self.seconds > _SILENT and not self._said:
            self._said = True
            warnings.warn("inner loops are compiled for this machine, once: that takes up to a minute", stacklevel=2)


_compiling = _Compiling()
event.register("numba:compile", _compiling)


def clock() -> float:
    """Seconds since some instant, without those in which loops were compiled: for what ends after a time."""
    return time.perf_counter() - _compiling.seconds
