# SPDX-License-Identifier: Apache-2.0
"""What is learned from is what was measured: never the line over a gap; and what may be asked is told by its range."""

from __future__ import annotations

import numpy as np

from trueup.grounding.domain import domain_of
from trueup.grounding.frames import measured_at
from trueup.grounding.rows import inputs_of, rows_of
from trueup.recording import Channel, Recording


def test_a_gap_is_not_bridged_and_a_single_missing_sample_is() -> None:
    time = np.delete(np.arange(0.0, 2.0, 0.01), [20, *range(100, 140)])
    position = Channel("position", ("lift",), "rad", time, np.sin(time)[:, None])
    known = np.isfinite(measured_at(position, np.arange(0.0, 1.985, 0.0125), 0.02)[:, 0])
    assert known[np.arange(0.0, 1.985, 0.0125) < 0.99].all()
    assert not known[(np.arange(0.0, 1.985, 0.0125) > 1.0) & (np.arange(0.0, 1.985, 0.0125) < 1.395)].any()


def test_frames_that_fall_between_samples_are_not_learned_from_in_a_gap() -> None:
    time = np.arange(0.0, 4.0, 0.0125)  # no part of a frame of 20 ms
    time = time[(time < 1.0) | (time > 1.4)]
    command, position = (
        Channel(n, ("lift",), "rad", time, np.sin(6.0 * time)[:, None]) for n in ("command", "position")
    )
    recording = Recording("run", {"command": command, "position": position})
    rows = rows_of([recording], inputs_of([recording]))
    instants = 0.02 * rows.frame
    assert not np.any((instants > 1.0) & (instants < 1.39))


def test_an_input_far_outside_of_a_narrow_range_is_named_before_one_a_little_outside_of_a_wide_one() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    rng = np.random.default_rng(0)
    # 'pan' rests and jumps now and then: its range is ten standard deviations, that of 'tilt' is three.
    pan = np.where(rng.random(len(t)) < 0.01, 1.0, 0.0) + 0.001 * rng.standard_normal(len(t))
    asked = np.column_stack([pan, np.sign(np.sin(t)) * 0.1])
    channels = {n: Channel(n, ("pan", "tilt"), "rad", t, asked) for n in ("command", "position")}
    run = Recording("run", channels)
    rows = rows_of([run], inputs_of([run]))
    domain = domain_of(rows)
    x = np.array(rows.X[0])
    x[rows.inputs.command_columns] = [1.9, 0.5]  # 0.9 of its range beyond it; 2 of its range beyond it
    (block,) = range(len(domain.blocks))
    told = domain.reason(x, block, 40)
    assert "farthest is command.tilt = 0.5, learned from -0.1 to 0.1" in told
    assert domain.reason(x, block, 1).count("for 1 frame in a row") == 1


def test_inputs_that_are_strange_only_together_are_said_to_be() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    both = np.column_stack([np.sin(t), np.sin(t) + 0.001 * np.cos(7.0 * t)])
    run = Recording("run", {n: Channel(n, ("pan", "tilt"), "rad", t, both) for n in ("command", "position")})
    rows = rows_of([run], inputs_of([run]))
    x = np.array(rows.X[0])
    x[rows.inputs.command_columns] = [0.5, -0.5]
    assert "each input is within its range, and together they are strange" in domain_of(rows).reason(x, 0, 9)
