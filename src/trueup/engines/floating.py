# SPDX-License-Identifier: Apache-2.0
"""Robots whose base is free, and joints that nothing drives: where trials of them may begin, and what moves them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from trueup.trial import Trial


@runtime_checkable
class Floating(Protocol):
    """A Simulator of a robot whose base may be free."""

    def placed(self, trial: Trial) -> bool:
        """Whether a trial's recording tells where the base was; True where it is not free."""
        ...


def placed(simulator: object, trial: Trial) -> bool:
    """Whether a trial may begin at any instant of its recording: a base of which nothing is known stands where the model has
    it at the beginning, and nowhere later.
    """
    return not isinstance(simulator, Floating) or simulator.placed(trial)


@runtime_checkable
class Passive(Protocol):
    """A Simulator that knows which joints nothing drives, and whether its robot touches anything."""

    def swings(self, trial: Trial) -> bool:
        """Whether joints were measured in a trial that nothing drives."""
        ...

    def passive(self, trial: Trial) -> bool:
        """Whether contacts alone move joints that were measured in a trial: those of a boom that a hopper hangs on."""
        ...


def passive(simulator: object, trial: Trial) -> bool:
    """Whether contacts move joints of a trial that nothing drives; False where a simulator cannot tell."""
    return isinstance(simulator, Passive) and simulator.passive(trial)


def swings(simulator: object, trial: Trial) -> bool:
    """Whether joints were measured in a trial that nothing drives, as a cart's pole; False where a simulator cannot tell."""
    return isinstance(simulator, Passive) and simulator.swings(trial)
