# SPDX-License-Identifier: Apache-2.0
"""Prints a benchmark's figures the way that `make benchmarks` collects them."""

from __future__ import annotations

import json
import math


def result(
    name: str, value: float, unit: str, goal: float, *, peer: str = "", peer_value: float | None = None,
    at_most: bool = True, ratio_goal: bool = False,
) -> bool:  # fmt: skip
    """Prints one RESULT line; True if the goal is met. With `ratio_goal` the goal is on value / peer_value."""
    ratio = value / peer_value if peer_value else None
    judged = ratio if ratio_goal and ratio is not None else value
    met = bool(math.isfinite(judged) and (judged <= goal if at_most else judged >= goal))
    row = {"name": name, "value": _short(value), "unit": unit, "peer": peer, "peer_value": _short(peer_value)}
    print("RESULT " + json.dumps({**row, "ratio": _short(ratio), "goal": goal, "met": met}))
    return met


def _short(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.5g}")
