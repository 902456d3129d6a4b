# SPDX-License-Identifier: Apache-2.0
"""Stretches in which a joint has no values are left out, as gaps in time are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.missing import bridged
from trueup.identification.estimation.result import Identification
from trueup.recording import Recording

FAST = Options(consistent=False, structure="common")


def without(recording: Recording, name: str, joint: int, first: float, last: float) -> Recording:
    channel = recording.channel(name)
    values = np.array(channel.values)
    values[(channel.time > first) & (channel.time < last), joint] = np.nan
    return recording.with_channel(channel.replace(values=values))


def error(found: Identification) -> float:
    (judged,) = found.held_out()
    return float(np.sqrt(np.mean((judged.fitted - judged.measured) ** 2)))


@pytest.mark.parametrize("name", ["torque", "position"])
def test_a_stretch_without_values_of_one_joint_costs_no_accuracy_and_is_said(arms: SimpleNamespace, name: str) -> None:
    whole, judged = (arms.recording(arms.arm(), np.random.default_rng(k), f"run{k}", seconds=16.0) for k in (1, 2))
    torn = without(without(whole, name, 1, 4.0, 4.9), name, 2, 9.0, 9.5)
    plain, found = (identify(arms.arm(), [run], [judged], options=FAST) for run in (whole, torn))
    assert error(found) < 1.1 * error(plain)
    assert any(
        f"{name} is missing of joint2 from 4 to 4.9 s, of joint3 from 9 to 9.5 s" in said for said in found.warnings
    )


def test_single_missing_samples_are_bridged_without_a_word(arms: SimpleNamespace) -> None:
    made = arms.recording(arms.arm(), np.random.default_rng(1), seconds=2.0)
    channel = made.channel("torque")
    whole, gaps, notes = bridged(
        channel.replace(values=np.where(np.arange(400)[:, None] % 2, np.nan, channel.values)), "run"
    )
    assert (gaps, notes) == ((), [])
    np.testing.assert_array_equal(whole.values[::2], channel.values[::2])
    assert np.isfinite(whole.values).all()


@pytest.mark.parametrize("first", [-1.0, 0.9])
def test_a_joint_that_lacks_most_of_its_values_is_named(arms: SimpleNamespace, first: float) -> None:
    made = without(arms.recording(arms.arm(), np.random.default_rng(1), seconds=2.0), "torque", 3, first, 3.0)
    with pytest.raises(IdentificationError, match=r"samples of 'joint4' are missing; cut the log .* \(--lock joint4\)"):
        bridged(made.channel("torque"), "run")


def test_what_was_left_out_when_a_log_was_read_is_said(arms: SimpleNamespace) -> None:
    made = arms.recording(arms.arm(), np.random.default_rng(1), seconds=8.0)
    read = made.replace(provenance={"warnings": "run.csv: 3 rows were left out"})
    assert "'run': run.csv: 3 rows were left out" in identify(arms.arm(), [read], options=FAST).warnings
