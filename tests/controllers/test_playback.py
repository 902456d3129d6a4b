# SPDX-License-Identifier: Apache-2.0
"""A recorded command is played as it was in force."""

from __future__ import annotations

import numpy as np

from trueup.controllers.playback import Playback
from trueup.recording import Channel


def test_in_place_of_a_missing_command_the_last_one_is_played() -> None:
    command = Channel("command", ("lift",), "rad", np.arange(3.0), np.array([[1.0], [np.nan], [2.0]]))
    assert Playback(command, 2).ahead(np.array([0.5, 1.5, 2.5]))[:, :, 0].tolist() == [[1.0, 1.0, 2.0]] * 2
