# SPDX-License-Identifier: Apache-2.0
"""Lags between signals are found to a fraction of a sample, whatever their rates, offsets and noise."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.errors import RecordingError
from trueup.inspection.alignment import clock_errors, lag, on_other_clocks
from trueup.recording import Channel, Recording


def channel(name: str, rate: float, shift: float = 0.0, noise: float = 0.0, label: str = "a") -> Channel:
    time = np.arange(0, 12, 1 / rate)
    t = time - shift
    values = np.sin(2 * np.pi * 0.7 * t) + 0.4 * np.sin(2 * np.pi * 1.9 * t + 1) + 0.2 * np.sin(2 * np.pi * 3.1 * t)
    return Channel(name, (label,), "rad", time, values + noise * np.random.default_rng(0).standard_normal(len(time)))


@pytest.mark.parametrize("shift", [-0.12, -0.0137, 0.0, 0.0042, 0.0371, 0.2])
def test_a_known_shift_is_found(shift: float) -> None:
    assert lag(channel("command", 100), channel("position", 100, shift)) == pytest.approx(shift, abs=1e-3)


def test_rates_may_differ_and_samples_be_noisy() -> None:
    assert lag(channel("command", 50), channel("position", 200, 0.03, 2e-3)) == pytest.approx(0.03, abs=2e-3)


def test_a_shift_is_symmetric() -> None:
    a, b = channel("a", 100), channel("b", 100, 0.05)
    assert lag(a, b) == pytest.approx(-lag(b, a), abs=1e-4)


def _swung(late: float, stuck: tuple[float, float]) -> Recording:
    """Two joints told to swing slowly, each at its own rate, that stay behind until their servos pull hard enough."""
    time = np.arange(0.0, 24.0, 0.01)
    told, seen = [], []
    for hertz, play in zip((0.12, 0.1), stuck, strict=True):
        wanted = (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * hertz * time))
        at, way = 0.0, []
        for target in np.interp(time - 0.03, time, wanted):
            at = min(max(at, target - play), target + play)
            way.append(at)
        told.append(wanted)
        seen.append(way)
    channels = (
        Channel("command", ("a", "b"), "rad", time + late, np.array(told).T),
        Channel("position", ("a", "b"), "rad", time, np.array(seen).T),
    )
    return Recording(f"{late} {stuck}", {c.name: c for c in channels})


def test_what_friction_holds_back_in_slow_motion_is_no_clock_error() -> None:
    sound = [_swung(0.0, (0.02, 0.02)).replace(name=n) for n in ("one", "two")]
    assert clock_errors([*sound, _swung(0.0, (0.4, 0.7))]) == {}
    late = _swung(0.8, (0.02, 0.02)).replace(name="late")
    assert list(clock_errors([*sound, late])) == ["late"]


def test_signals_that_share_nothing_are_refused() -> None:
    with pytest.raises(RecordingError, match="share no label"):
        lag(channel("command", 50), channel("position", 50, label="b"))


def test_signals_that_do_not_move_are_refused() -> None:
    still = Channel("position", ("a",), "rad", np.arange(0, 12, 0.02), np.zeros((600, 1)))
    with pytest.raises(RecordingError, match="do not move"):
        lag(channel("command", 50), still)


@pytest.mark.parametrize("late", [0.25, -0.1])
def test_a_car_that_moves_before_it_is_told_to_is_said_to(late: float) -> None:
    time, rng = np.arange(0.0, 20.0, 0.05), np.random.default_rng(0)
    speed, turn = (lambda s: 1.0 + 0.4 * np.sin(0.8 * s) + 0.2 * np.sin(2.3 * s)), (lambda s: 0.5 * np.sin(1.1 * s))
    told = np.column_stack([speed(time), turn(time)])
    moved = [f(time + late) + rng.normal(0.0, 0.05, len(time)) for f in (speed, turn)]
    log = Recording("log", {
        "command": Channel("command", ("speed", "turn"), "m/s", time, told, ("m/s", "rad/s")),
        "speed": Channel("speed", ("speed",), "m/s", time, moved[0]),
        "yaw_rate": Channel("yaw_rate", ("yaw_rate",), "rad/s", time, moved[1]),
    })  # fmt: skip
    said = on_other_clocks([log])
    assert len(said) == (1 if late > 0.0 else 0)
    assert not said or "before it is told to" in said[0]


@pytest.mark.parametrize("delay", [0.1, 0.5])
@pytest.mark.parametrize("kind", ["steps", "sines"])
def test_a_turn_rate_that_grows_to_the_right_is_no_late_clock(delay: float, kind: str) -> None:
    time, rng = np.arange(0.0, 60.0, 0.05), np.random.default_rng(0)
    drawn = np.repeat(rng.uniform(-0.8, 0.8, 30), 40)
    told = drawn if kind == "steps" else 0.5 * np.sin(0.9 * time) + 0.3 * np.sin(2.1 * time)
    turned = np.interp(time - delay, time, told) + rng.normal(0.0, 0.02, len(time))
    command = Channel(
        "command", ("speed", "turn"), "m/s", time, np.column_stack([1.0 + 0.0 * time, told]), ("m/s", "rad/s")
    )
    for sign in (1.0, -1.0):
        measured = Channel("yaw_rate", ("yaw_rate",), "rad/s", time, sign * turned)
        said = on_other_clocks([Recording("log", {"command": command, "yaw_rate": measured})])
        assert len(said) == (0 if sign > 0.0 else 1)
        assert not said or "yaw_rate goes the other way than turn is commanded" in said[0]
    noise = Channel("yaw_rate", ("yaw_rate",), "rad/s", time, rng.normal(0.0, 0.1, len(time)))
    noisy = on_other_clocks([Recording("log", {"command": command, "yaw_rate": noise})])
    assert not any("the other way" in line for line in noisy)
