# SPDX-License-Identifier: Apache-2.0
"""What a robot must offer, real or simulated: it performs a trial and hands back what was recorded."""

from __future__ import annotations

from typing import Protocol

from trueup.recording import Recording
from trueup.trial import Trial


class Robot(Protocol):
    """Performs planned runs. Recordings of a robot and of a simulator look alike."""

    def perform(self, trial: Trial) -> list[Recording]:
        """One recording for each repeat, with the command requested and, where it differs, the command sent.

        Raises TrueupError where the trial cannot be performed as planned.
        """
        ...
