# SPDX-License-Identifier: Apache-2.0
"""A structure stays where stretches and settings that were left out are foretold better with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.simulator import Rollout
from trueup.loop.calibrate import Options, calibrate
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
SPACE = ParameterSpace((
    Parameter("size", "", 0.5, 0.0, 2.0),
    Parameter("push", "rad", 1.0, 0.0, 4.0, optional="push", absent=0.0),
))  # fmt: skip


@dataclass(frozen=True)
class _Swing:
    """Positions size * sin t + push * cos 3 t."""

    parameters: ParameterSpace = SPACE
    step: float = 0.01
    name: str = "swing"

    def at_step(self, step: float) -> _Swing:
        return replace(self, step=step)

    def shipped(self) -> _Swing:
        return self

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        size, push = np.split(values if values.shape[1] else SPACE.nominal[None], 2, axis=1)
        times = [trial.observed["position"].time for trial in trials]
        read = [_positions(t, size, push)[:, :, None] for t in times]
        return [Rollout(trial, {"position": r}, {}) for trial, r in zip(trials, read, strict=True)]


def _positions(t: Array, size: Array | float, push: Array | float) -> Array:
    return size * np.sin(t) + push * np.cos(3.0 * t)


def _recordings(pushes: dict[str, float]) -> list[Recording]:
    """Two runs of 20 s at each gain."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 20.0, 0.02)
    found = []
    for gain, push in pushes.items():
        for run in "ab":
            values = (_positions(t, 1.0, push) + 0.01 * rng.standard_normal(len(t)))[:, None]
            provenance = {"kp": gain, "log": f"{gain}{run}"}
            channel = Channel("position", ("joint",), "rad", t, values)
            found.append(Recording(f"{gain}{run}", {"position": channel}, provenance))
    return found


@pytest.mark.parametrize(("other", "stays"), [(2.0, True), (6.0, False)])
def test_a_structure_that_another_gain_contradicts_is_left_out(other: float, stays: bool) -> None:
    """At both gains together the push lowers the error of every stretch but those of the smaller one."""
    found = calibrate(_Swing(), _recordings({"100": 2.0, "200": other}), options=Options(cross_validate=False))
    push = next(e for e in found.estimates if e.name == "push")
    assert push.fitted == stays
    assert any(note.startswith(f"push {'kept' if stays else 'left out'}") for note in found.notes)
    assert any("another 'kp'" in note for note in found.notes) != stays
