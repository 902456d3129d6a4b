# SPDX-License-Identifier: Apache-2.0
"""Diagnoses say what was seen, in numbers too, and can be refused."""

from __future__ import annotations

import numpy as np

from trueup.inspection.diagnosis import Diagnosis
from trueup.inspection.zeros import zeros_off
from trueup.recording import Channel, Recording


def test_a_zero_that_is_off_shows_where_commands_were_held_and_noise_alone_does_not() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 12.0, 0.01)
    held = rng.uniform(-1.0, 1.0, (12, 2))[np.minimum(time.astype(int), 11)]
    lag = np.where((time % 1.0 < 0.2)[:, None], 0.1, 0.0)  # on its way to the next posture
    seen = held + np.array([5e-3, 0.0]) - lag + 1e-3 * rng.standard_normal(held.shape)
    joints = ("off", "right")
    log = Recording("log", {n: Channel(n, joints, "rad", time, v) for n, v in (("command", held), ("position", seen))})
    found = zeros_off([log], joints)
    assert found is not None
    assert list(found.numbers) == ["off"]
    assert abs(found.numbers["off"] - 5e-3) < 3e-4
    assert zeros_off([log.without("command")], joints) is None


def test_what_is_refused_says_so() -> None:
    found = Diagnosis("floor", "the robot was stopped", "a floor is added", {"height": 0.1})
    assert str(found) == "the robot was stopped: a floor is added"
    assert str(found.unless(["zero"])) == str(found)
    assert str(found.unless(["floor"])).startswith("refused, and so not done: the robot was stopped")
