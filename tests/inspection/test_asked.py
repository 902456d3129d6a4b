# SPDX-License-Identifier: Apache-2.0
"""Joints that were exchanged are told from a joint that gives way under load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.inspection.asked import swapped
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

_TIME = np.arange(0.0, 2.0, 0.01)
_KNEE, _ANKLE = np.sin(3.0 * _TIME), 0.3 * np.cos(7.0 * _TIME)
_ASKED = Channel("command", ("knee", "ankle"), "rad", _TIME, np.stack([_KNEE, _ANKLE], axis=1))


def _said(knee: Array, ankle: Array) -> str:
    position = Channel("position", ("knee", "ankle"), "rad", _TIME, np.stack([knee, ankle], axis=1))
    found = swapped(_ASKED, Recording("run", {"position": position}))
    return "" if found is None else found.words


def test_a_weak_ankle_that_the_knee_moves_is_not_taken_for_it() -> None:
    assert not _said(0.9 * _KNEE, 0.2 * _KNEE + 0.05 * _ANKLE)
    late = np.sin(3.0 * _TIME - 0.9)  # the knee itself is slow
    assert not _said(2.0 * late, 0.2 * _KNEE - 0.02 * _ANKLE)


def test_joints_that_were_exchanged_are_named() -> None:
    assert "in another order" in _said(0.9 * _ANKLE, 0.9 * _KNEE)
