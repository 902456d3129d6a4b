# SPDX-License-Identifier: Apache-2.0
"""Instants of a bag's messages: by their headers, in their order, on one clock where headers count from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from trueup.arrays import Array

LATENCY = 0.1
"""s that the quickest message of a topic takes to arrive, at most: on one clock it is some milliseconds."""


@dataclass
class Stamps:
    """When the messages of one topic were stamped (None: not at all) and received, in s."""

    stamped: list[float | None] = field(default_factory=list)
    received: list[float] = field(default_factory=list)

    def add(self, stamp: float | None, received: float) -> None:
        """One message more."""
        self.stamped.append(stamp)
        self.received.append(received)

    def __len__(self) -> int:
        return len(self.received)

    @property
    def ahead(self) -> float | None:
        """Seconds by which the recorder's clock is ahead of the headers', with the least latency; None where nothing tells
        that: there are no headers, few messages, or what lies between does not stay the same, as with simulated time.
        """
        delays = [r - s for s, r in zip(self.stamped, self.received, strict=True) if s is not None]
        enough = 3
        if len(delays) < enough or median(delays) - min(delays) > LATENCY:
            return None
        return min(delays)

    def instants(self, ahead: float = 0.0) -> Array:
        """(n,) s of each message: its header's, moved by `ahead`; else that of its reception."""
        pairs = zip(self.stamped, self.received, strict=True)
        return np.array([r if s is None else s + ahead for s, r in pairs], dtype=np.float64)


def shifts(topics: Mapping[str, Stamps]) -> tuple[dict[str, float], list[str]]:
    """Seconds to add to the headers of each topic, so that all of a bag stand on one clock, and a note.

    Headers of one machine keep their order among one another. Where all topics agree nothing is moved, as their headers know
    better than who received them.
    """
    found = {name: ahead for name, stamps in topics.items() if (ahead := stamps.ahead) is not None}
    unstamped = any(None in stamps.stamped and set(stamps.stamped) == {None} for stamps in topics.values())
    clocks = _clocks(found)
    if len(clocks) + (unstamped and not any(abs(least) < LATENCY for least, _ in clocks)) < 2:
        return {}, []
    moved = {name: least for least, names in clocks for name in names if abs(least) >= LATENCY}
    said = ", ".join(f"{name} by {ahead:+.9g} s" for name, ahead in moved.items())
    return moved, [
        f"headers count from another instant than the recorder's clock, and were set to it by the quickest message: {said}"
    ] if moved else []


def _clocks(ahead: Mapping[str, float]) -> list[tuple[float, list[str]]]:
    """Topics whose headers share a clock, and by how much the recorder is ahead of each."""
    clocks: list[tuple[float, list[str]]] = []
    for name, value in sorted(ahead.items(), key=lambda item: item[1]):
        if clocks and value - ahead[clocks[-1][1][-1]] < LATENCY:
            clocks[-1][1].append(name)
        else:
            clocks.append((value, [name]))
    return clocks


def in_order(instants: Array) -> Sequence[int] | None:
    """The order of messages of which some overtook others on their way; None where there is none, or a clock was set back."""
    late = np.maximum.accumulate(instants) - instants
    if not 0.0 < np.max(late) < LATENCY:
        return None
    return np.argsort(instants, kind="stable").tolist()
