# SPDX-License-Identifier: Apache-2.0
"""Channels that were reckoned from others of a recording: runs begin as they say, and are not compared with them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from trueup.recording import Recording

RECKONED = "reckoned"
"""Key of a recording's provenance: such channels, parted by spaces (`reckoned_of`)."""
TOLD_BY = "told_by"
"""Key of a recording's provenance: the channel that is compared under another name, as that of a base's orientation."""
RATE_OF = "_rate"
"""Behind the name of a channel: that of the one that tells how fast it changes, where that was reckoned, too."""


@runtime_checkable
class Reckoning(Protocol):
    """A simulator that knows how recordings of its robot are completed."""

    def reckoned(self, recording: Recording) -> Recording | None:
        """A recording with the channels that are reckoned from others; None where it does not tell them."""
        ...


def reckoned_of(recording: Recording) -> frozenset[str]:
    """Its channels that were reckoned from others."""
    return frozenset(recording.provenance.get(RECKONED, "").split())


def reckoned_as(simulator: object, recording: Recording) -> Recording | None:
    """A recording with what a simulator's recordings have reckoned; None where that, or the recording, does not tell it."""
    return simulator.reckoned(recording) if isinstance(simulator, Reckoning) else None
