# SPDX-License-Identifier: Apache-2.0
"""Commands between the samples of a log: on the way from one to the next, and said where held ones leave no delay."""

from __future__ import annotations

import numpy as np

from trueup.calibration import Calibration, Estimate
from trueup.commands.between import HELD, INTERPOLATED, sooner_than_held, with_commands_between
from trueup.recording import Channel, Recording

_TIME = np.arange(0.0, 1.0, 0.01)
_LOG = Recording("log", {n: Channel(n, ("j",), "rad", _TIME, np.sin(_TIME)[:, None]) for n in ("command", "position")})


def _found(delay: float) -> Calibration:
    estimate = Estimate("delay", "s", 0.0, delay, 0.0, 0.01, 0.0, 0.1, True, "identified")
    return Calibration("arm", (estimate,), (), (), np.eye(1))


def test_interpolated_commands_lie_on_the_way_and_what_was_measured_stays() -> None:
    (held,), (between,) = (with_commands_between([_LOG], how, 0.002) for how in (HELD, INTERPOLATED))
    assert held.channel("command") == _LOG.channel("command")
    fine = between.channel("command")
    assert len(fine.time) > 4 * len(_TIME)
    np.testing.assert_allclose(fine.values[:, 0], np.interp(fine.time, _TIME, np.sin(_TIME)), atol=1e-12)
    assert len(between.channel("position").time) == len(_TIME)


def test_no_delay_beside_held_commands_is_told_of() -> None:
    (note,) = sooner_than_held(_found(0.0), [_LOG], 0.002)
    assert "10 ms between their samples" in note
    assert "--commands interpolated" in note
    assert not sooner_than_held(_found(0.004), [_LOG], 0.002)
    assert not sooner_than_held(_found(0.0), [_LOG], 0.01)
