# SPDX-License-Identifier: Apache-2.0
"""What a robot must offer, real or simulated: it performs a trial and hands back what was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from trueup.recording import Recording
from trueup.trial import Trial


class Robot(Protocol):
    """Performs planned runs. Recordings of a robot and of a simulator look alike."""

    @property
    def repeatable(self) -> bool:
        """Whether `perform` may be called again for a trial that an interruption left without an outcome.

        A stand-in says True and gives the same recordings for the same trial name; ByHand says True and goes on waiting.
        A driver that moves hardware says False: what became of the run is then for an operator to say.
        """
        ...

    def perform(self, trial: Trial) -> list[Recording]:
        """One recording for each repeat, with the command requested and, where it differs, the command sent.

        Raises TrialAbortedError where the run was stopped, RobotFellError where the robot fell or failed, and TrueupError
        where the trial cannot be performed as planned.
        """
        ...


@runtime_checkable
class HandsOut(Protocol):
    """A robot that is shown all trials of a step before the first is performed: an operator runs them together."""

    def hand_out(self, trials: Sequence[Trial]) -> None:
        """Makes the trials known; again for one that is known already changes nothing."""
        ...
