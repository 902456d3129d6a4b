# SPDX-License-Identifier: Apache-2.0
"""What a channel of the servo's own output (load, duty, current) says of its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.actuators.bench import Run
from trueup.samples import correlation

_FIRMWARE = 0.99  # least correlation with the error by which a channel is the firmware's own output


@dataclass(frozen=True)
class Output:
    """The firmware's output as a channel shows it."""

    full_error: float
    """rad of error, at the setting that the model stands for, from which on it gives all it can; inf: never so in these."""
    reached: float
    """rad, the largest error that was seen."""
    sentence: str


def output_of(runs: Sequence[Run]) -> Output | None:
    """None where no channel follows the error in proportion: it shows current or torque, or there is none."""
    shown = [r for r in runs if len(r.output)]
    if len(shown) < len(runs):
        return None
    parts = []
    for run in shown:
        at = run.given(run.time)
        good = run.on[at] & np.isfinite(run.output)
        parts.append(np.stack([run.gain * (run.command[at] - run.position), run.output], axis=1)[good])
    error, value = np.concatenate(parts).T
    top = float(np.max(np.abs(value), initial=0.0))
    low = np.abs(value) < 0.8 * top
    if top == 0.0 or low.sum() < 100 or correlation(error[low], value[low]) < _FIRMWARE:
        return None
    slope = float(error[low] @ value[low] / (error[low] @ error[low]))
    full, reached = top / slope, float(np.max(np.abs(error)))
    flat = int(np.sum(np.abs(value) == top))
    if flat >= 5 and reached > 1.05 * full:
        return Output(
            full, reached, f"the servo's output ends at {top:g}: full duty from an error of {full:.3g} rad on"
        )
    return Output(np.inf, reached, f"the servo's output follows the error up to {reached:.3g} rad: no limit was reached, "
                                   "what lies beyond is unknown")  # fmt: skip
