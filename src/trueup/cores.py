# SPDX-License-Identifier: Apache-2.0
"""How many cores this process may use."""

from __future__ import annotations

import os

THREADS = "TRUEUP_THREADS"
"""Environment variable that says how many threads simulations take, where it is not all cores of this process."""


def cores() -> int:
    """As THREADS says, else all that the system lets this process use."""
    asked = os.environ.get(THREADS, "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
