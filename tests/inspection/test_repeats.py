# SPDX-License-Identifier: Apache-2.0
"""Repeats of one run: gaps are closed or named, runs that part are averaged no further, and the spread is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trueup.ends import Ended, ended, with_end
from trueup.errors import RecordingError
from trueup.inspection.repeats import bridged, grouped, together
from trueup.loop.checks import check
from trueup.recording import Channel, Recording

TIME = np.arange(0.0, 2.0, 0.01)
AXES = ("x", "y", "z")


def run(
    name: str, noise: float, seed: int, falls_at: float = np.inf, lost: tuple[float, float] = (9.0, 9.0)
) -> Recording:
    rng = np.random.default_rng(seed)
    lean = 0.3 * np.sin(3.0 * TIME) + 2.0 * np.maximum(TIME - falls_at, 0.0)
    angles = np.stack([0.0 * TIME, lean, 0.0 * TIME], axis=1) + noise * rng.standard_normal((len(TIME), 3))
    angles[(lost[0] <= TIME) & (lost[1] > TIME)] = np.nan
    return Recording(
        name, {"base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", TIME, angles)}
    )


def test_the_average_of_repeats_is_less_noisy_by_the_root_of_their_number_and_the_spread_is_the_noise() -> None:
    found = together([run(f"r{k}", 0.02, k) for k in range(9)])
    error = found.average.channel("base_orientation").column("pitch") - 0.3 * np.sin(3.0 * TIME)
    assert found.parted is None
    assert error.std() == pytest.approx(0.02 / 3.0, rel=0.2)
    assert found.spread["base_orientation"] == pytest.approx(0.02, rel=0.1)


def test_repeats_that_disagree_are_averaged_until_they_part_and_the_spread_is_said() -> None:
    found = together([run("a", 0.004, 0), run("b", 0.004, 1), run("c", 0.004, 2, falls_at=1.2)])
    assert found.parted is not None
    assert 1.2 < found.parted < 1.5
    assert found.average.stop <= found.parted + 1e-9
    assert "they disagree from" in found.summary
    assert "they disagree from" in found.average.provenance["warnings"]
    assert "base_orientation 0.0" in found.summary


def test_an_end_that_all_runs_had_is_the_end_of_their_average() -> None:
    runs = [with_end(run(f"r{k}", 0.004, k), Ended(1.5 + 0.01 * k, "fallen")) for k in range(3)]
    assert ended(together(runs).average) == Ended(1.5, "fallen")
    assert ended(together([*runs[:2], run("stands", 0.004, 3)]).average) is None


def test_short_gaps_are_bridged_and_long_ones_are_named_with_their_instants() -> None:
    closed = bridged(run("short", 0.0, 0, lost=(0.5, 0.58))).channel("base_orientation")
    np.testing.assert_allclose(closed.column("pitch"), 0.3 * np.sin(3.0 * TIME), atol=0.003)
    with pytest.raises(
        RecordingError, match=r"'long': 'base_orientation' was lost from 0\.49 to 1 s \(0\.51 s; .*perform"
    ):
        bridged(run("long", 0.0, 0, lost=(0.5, 1.0)))


def commanded(name: str, seed: int, **how: Any) -> Recording:
    """A run with a command and a place, as calibrations get it."""
    made, still = run(name, 0.004, seed, **how), np.zeros((len(TIME), 3))
    given = Channel("command", ("hip",), "rad", TIME, np.sin(TIME))
    return made.with_channel(given).with_channel(Channel("base_position", ("x", "y", "z"), "m", TIME, still))


def test_a_calibration_says_which_repeats_disagree_and_where_the_motion_capture_was_lost() -> None:
    runs = [commanded("a", 0), commanded("b", 1, falls_at=1.2), commanded("c", 2, lost=(0.4, 1.1))]
    other = commanded("d", 3)
    other = other.with_channel(other.channel("command").replace(values=np.cos(TIME)))
    assert [[r.name for r in group] for group in grouped([*runs, other])] == [["a", "b", "c"]]
    said = "\n".join(check([*runs, other], []))
    assert "repeats of 'a' differ by" in said
    assert "they disagree from 1." in said
    assert "'c': 'base_orientation' was lost from 0.39 to 1.1 s; nothing is compared there" in said
    assert "disagree" not in "\n".join(check([runs[0], other], []))
