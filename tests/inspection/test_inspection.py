# SPDX-License-Identifier: Apache-2.0
"""Faults put into a recording are found and said; a sound recording is left in peace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup import formats
from trueup.inspection import estimate_noise, inspect
from trueup.recording import Channel, Recording

RATE = 100.0
TIME = np.arange(2000) / RATE
SIGMA = 5e-4


def angle(time: NDArray[np.float64] = TIME, phase: float = 0.0) -> NDArray[np.float64]:
    return 0.6 * np.sin(2 * np.pi * 0.4 * time + phase) + 0.2 * np.sin(2 * np.pi * 1.1 * time)


def speed(time: NDArray[np.float64] = TIME, phase: float = 0.0) -> NDArray[np.float64]:
    slow = 0.6 * 0.8 * np.pi * np.cos(2 * np.pi * 0.4 * time + phase)
    return slow + 0.2 * 2.2 * np.pi * np.cos(2 * np.pi * 1.1 * time)


def noisy(values: NDArray[np.float64], sigma: float = SIGMA, seed: int = 0) -> NDArray[np.float64]:
    return values + np.random.default_rng(seed).normal(0.0, sigma, np.shape(values))


def channel(name: str, *columns: NDArray[np.float64], unit: str = "rad", time: NDArray[np.float64] = TIME) -> Channel:
    return Channel(name, tuple("abcdef"[: len(columns)]), unit, time, np.stack(columns, axis=1))


def recording(*channels: Channel) -> Recording:
    return Recording("run", {c.name: c for c in channels})


def sound() -> Recording:
    return recording(
        channel("command", angle(TIME + 0.03), angle(TIME + 0.03, 1.0)),
        channel("position", noisy(angle()), noisy(angle(TIME, 1.0), seed=1)),
        channel("velocity", noisy(speed(), 0.01), noisy(speed(TIME, 1.0), 0.01), unit="rad/s"),
    )


def test_a_sound_recording_has_no_findings() -> None:
    assert inspect(sound()).findings() == ()


def test_rate_jitter_and_noise_are_those_that_were_put_in() -> None:
    jittered = TIME + np.random.default_rng(0).normal(0.0, 2e-4, len(TIME))
    found = inspect(recording(channel("position", noisy(angle(jittered)), time=jittered))).channel("position")
    assert found.rate == pytest.approx(RATE, rel=0.01)
    assert found.jitter == pytest.approx(2e-4 * np.sqrt(2.0), rel=0.1)
    assert found.noise == pytest.approx(SIGMA, rel=0.15)
    assert found.gaps == ()


def test_gaps_are_found_where_samples_were_taken_out() -> None:
    keep = np.ones(len(TIME), dtype=bool)
    keep[500:520] = keep[1200] = False
    inspection = inspect(recording(channel("position", noisy(angle())[keep], time=TIME[keep])))
    first, second = inspection.channel("position").gaps
    assert (first.start, first.duration) == pytest.approx((4.99, 0.21))
    assert (second.start, second.duration) == pytest.approx((11.99, 0.02))
    said = "a gap lasts 0.21 s after 4.990 s, beside a single sample that is missing"
    assert any(said in sentence for sentence in inspection.findings())


def test_single_samples_that_are_missing_are_counted_and_called_harmless() -> None:
    keep = np.random.default_rng(0).permutation(len(TIME)) >= 30
    keep[1:][~keep[:-1]] = True  # no two beside each other
    found = inspect(recording(channel("position", noisy(angle())[keep], time=TIME[keep])))
    count = np.count_nonzero(~keep[1:-1])
    assert found.channel("position").dropped == len(found.channel("position").gaps) == count
    assert any(f"{count} single samples are missing" in sentence for sentence in found.findings())
    assert not any("gap" in sentence for sentence in found.findings())


def test_what_does_not_move_is_named() -> None:
    still = recording(channel("position", noisy(angle()), noisy(0.0 * TIME, seed=1), 0.0 * TIME + 1.0))
    inspection = inspect(still)
    assert inspection.channel("position").motionless == ("b", "c")
    assert any("b, c shows nothing but noise" in sentence for sentence in inspection.findings())


def test_slow_motion_under_coarse_quantisation_is_still_motion() -> None:
    slow = np.round(0.01 * np.sin(2 * np.pi * 0.1 * TIME) / 0.0015) * 0.0015
    assert inspect(recording(channel("position", slow))).channel("position").motionless == ()


def test_a_current_that_is_cut_off_is_saturated() -> None:
    current = np.clip(noisy(3.0 * angle(), 0.01), -1.2, 1.2)
    inspection = inspect(recording(channel("current", current, noisy(angle(), 0.01), unit="A")))
    assert inspection.channel("current").saturated == ("a",)
    assert any("rests at its extreme" in sentence for sentence in inspection.findings())


@pytest.mark.parametrize("labels", [("w", "x", "y", "z"), ("qw", "qx", "qy", "qz")])
def test_a_quaternion_near_upright_is_not_cut_off(labels: tuple[str, ...]) -> None:
    half = np.round(0.5 * 0.3 * np.clip(np.sin(TIME), 0.0, 1.0), 5)
    turn = Channel("base_orientation", labels, "", TIME,
                   np.round(np.stack([np.cos(half), np.sin(half), 0.0 * half, 0.0 * half], axis=1), 5))  # fmt: skip
    assert not any("rests at its extreme" in sentence for sentence in inspect(recording(turn)).findings())


def test_a_position_that_rests_where_it_was_told_to_is_not_saturated() -> None:
    target = np.where((TIME % 4.0) < 2.0, 0.0, 0.5)
    settled = np.round(np.convolve(target, np.ones(20) / 20, "full")[: len(TIME)] / 0.0015) * 0.0015
    held = recording(channel("command", target), channel("position", settled))
    assert inspect(held).channel("position").saturated == ()


def test_a_position_at_its_stop_while_the_command_goes_on_is_saturated() -> None:
    stopped = np.round(np.minimum(angle(), 0.4) / 0.0015) * 0.0015
    inspection = inspect(recording(channel("command", angle()), channel("position", stopped)))
    assert inspection.channel("position").saturated == ("a",)


def test_a_sensor_slower_than_the_log_is_noticed() -> None:
    held = np.repeat(noisy(angle(TIME[::4])), 4)
    inspection = inspect(recording(channel("position", held)))
    assert inspection.channel("position").held == 4
    assert inspection.channel("position").repeats == 1500
    assert any("about 25 Hz, not 100 Hz" in sentence for sentence in inspection.findings())


def test_noise_of_a_slower_sensor_is_that_of_its_own_samples_where_rows_are_missing_too() -> None:
    held = np.repeat(noisy(angle(TIME[::2]), 5e-3), 2)
    kept = np.random.default_rng(1).random(len(TIME)) > 0.03
    found = inspect(recording(channel("position", held[kept], time=TIME[kept]))).channel("position")
    assert found.held == 2
    assert found.noise == pytest.approx(5e-3, rel=0.15)


def test_missing_values_are_counted_per_column() -> None:
    values = noisy(angle())
    values[10:30] = np.nan
    inspection = inspect(recording(channel("position", values, angle())))
    assert inspection.channel("position").missing.tolist() == [20, 0]
    assert any("20 values are missing" in sentence and "of a" in sentence for sentence in inspection.findings())


def test_a_column_without_any_value_is_survived() -> None:
    inspection = inspect(recording(channel("position", np.full(len(TIME), np.nan), angle())))
    assert inspection.channel("position").motionless == ("a",)
    assert np.isnan(inspection.channel("position").lowest[0])


def test_large_angles_are_suspected_to_be_degrees() -> None:
    (sentence,) = inspect(recording(channel("position", noisy(np.rad2deg(angle()), 0.02)))).findings()
    assert "degrees suspected" in sentence
    assert 'unit = "deg"' in sentence


@pytest.mark.parametrize(("joint", "suspected"), [("left_wheel", False), ("left_hip", True)])
def test_wheels_may_turn_on_and_on(joint: str, suspected: bool) -> None:
    log = recording(channel("position", noisy(np.linspace(0.0, 30.0, len(TIME))))).rename({"a": joint})
    assert any("degrees suspected" in sentence for sentence in inspect(log).suspicions) == suspected


def test_whole_numbers_are_suspected_to_be_counts() -> None:
    counts = recording(channel("position", np.round(200.0 * angle() + 512.0), unit=""))
    (sentence,) = (x for x in inspect(counts).suspicions if "suspected" in x)
    assert "counts of an encoder, degrees suspected" in sentence
    assert "with scale and offset for counts" in sentence


@pytest.mark.parametrize(
    ("factor", "word"), [(180.0 / np.pi, "degrees"), (60.0 / (2.0 * np.pi), "revolutions per minute"), (-1.0, "sign")]
)
def test_a_velocity_that_is_not_the_derivative_of_position_is_suspected(factor: float, word: str) -> None:
    small = recording(
        channel("position", noisy(0.1 * angle(), 1e-4), noisy(0.1 * angle(TIME, 1.0), 1e-4)),
        channel("velocity", 0.1 * factor * speed(), 0.1 * factor * speed(TIME, 1.0), unit="rad/s"),
    )
    (sentence,) = inspect(small).suspicions
    assert "velocity of a, b" in sentence
    assert word in sentence


def test_a_velocity_from_encoder_steps_is_not_suspected() -> None:
    position = np.round(angle() / 0.00153) * 0.00153
    velocity = np.round(speed() / 0.0767) * 0.0767
    both = recording(channel("position", position), channel("velocity", velocity, unit="rad/s"))
    assert inspect(both).suspicions == ()


def test_a_command_in_degrees_beside_positions_in_radians_is_suspected() -> None:
    small = recording(
        channel("command", np.rad2deg(0.1 * angle(TIME + 0.02))), channel("position", noisy(0.1 * angle()))
    )
    assert any("command is in degrees and position in radians" in s for s in inspect(small).suspicions)


def test_milliamperes_are_suspected() -> None:
    large = recording(channel("current", 400.0 * angle(), unit="A"))
    assert any("milliamperes suspected" in sentence for sentence in inspect(large).suspicions)


def test_a_torque_without_sign_is_suspected() -> None:
    unsigned = sound().with_channel(channel("torque", np.abs(angle()), np.abs(angle(TIME, 1.0)), unit="N m"))
    assert any("size without a sign" in sentence for sentence in inspect(unsigned).suspicions)


def test_efforts_that_are_whole_numbers_are_hardly_newton_metres() -> None:
    effort = np.round(80.0 * speed())
    whole = inspect(recording(channel("position", angle()), channel("torque", effort, unit="N m"))).findings()
    assert any("nothing but whole numbers" in f for f in whole)
    real = inspect(recording(channel("position", angle()), channel("torque", effort + 0.25, unit="N m"))).findings()
    assert not any("whole numbers" in f for f in real)


def test_a_load_whose_direction_is_a_bit_is_said_to_be() -> None:
    load = np.round(200.0 * speed())
    coded = np.where(load < 0.0, 1024.0 - load, load)
    assert any(
        "which way (1024 + 5 is -5)" in f for f in inspect(recording(channel("load", coded, unit=""))).findings()
    )
    assert not any("which way" in f for f in inspect(recording(channel("load", load, unit=""))).findings())


def test_what_the_reader_left_out_is_among_the_findings() -> None:
    warned = sound().replace(provenance={"warnings": "the last line was dropped", "guesses": "taken as rad"})
    assert inspect(warned).findings() == ("the last line was dropped",)
    assert inspect(warned).guesses == ("taken as rad",)


@pytest.mark.realdata
def test_a_servo_arm_shows_its_encoder_and_its_unsigned_torque(real_data: Path) -> None:
    (run,) = formats.read(real_data / "so101" / "recordings" / "multisine")
    inspection = inspect(run)
    position = inspection.channel("position")
    assert position.rate == pytest.approx(49.85, abs=0.02)
    for step, noise in zip(position.grid[:5], position.noise[:5], strict=True):
        assert step == pytest.approx(2.0 * np.pi / 4096, rel=1e-3)
        assert 4e-4 < noise < 1.5e-3
    assert position.motionless == ()
    assert any("without a sign" in sentence for sentence in inspection.suspicions)
    assert not any("velocity" in sentence for sentence in inspection.suspicions)


@pytest.mark.realdata
def test_ideal_torques_and_a_1_khz_log_are_told_from_real_ones(real_data: Path) -> None:
    (arm,) = formats.read(real_data / "panda")
    assert np.all(estimate_noise(arm.channel("torque").values, arm.channel("torque").time) > 0.01)
    assert inspect(arm).channel("position").rate == pytest.approx(1000.0, rel=0.01)
    assert len(inspect(arm).channel("position").gaps) > 5


def test_commands_that_were_logged_when_they_changed_have_no_jitter_to_mend() -> None:
    rng = np.random.default_rng(0)
    time = TIME[np.sort(rng.choice(len(TIME), len(TIME) // 20, replace=False))]
    found = inspect(recording(channel("position", noisy(angle(TIME))), channel("command", angle(time), time=time)))
    assert not any("log the time at which each was taken" in words for words in found.findings())
    assert any("only changes were logged" in words for words in found.findings())


@pytest.mark.parametrize("lost", [0, 3])
def test_stamps_that_scatter_are_said_to_be_wrong_where_motion_is_smoother_without(lost: int) -> None:
    rng = np.random.default_rng(0)
    scattered = TIME + rng.uniform(-0.4, 0.4, len(TIME)) / RATE
    keep = np.ones(len(TIME), dtype=bool)
    keep[[500, 501, 1200][:lost]] = False
    small = rng.normal(0.0, 1e-4, len(TIME))
    for taken, wrong in ((TIME, True), (scattered, False)):
        values = (angle(taken) + small)[keep]
        found = inspect(recording(channel("position", values, time=scattered[keep])))
        assert any("log the time at which each was taken" in words for words in found.findings()) == wrong
