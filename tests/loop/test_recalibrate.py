# SPDX-License-Identifier: Apache-2.0
"""A calibration with more recordings goes on from the last one, unless that leads astray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Calibration
from trueup.engines.family import Family
from trueup.engines.simulator import Simulator
from trueup.loop.prepare import Preparation
from trueup.loop.recalibrate import Earlier
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
TRUTH = {"height": 1.3, "frequency": 3.0, "decay": 0.1, "bent": 0.0}


def swing(time: Array, values: Array, step: float = 0.0) -> Array:
    height, frequency, decay, bent = values if len(values) else (1.0, 2.2, 0.3, 0.0)
    return height * np.exp(-decay * time) * np.sin(frequency * time) * (1.0 + bent * time)


def seen(start: float, stop: float) -> Recording:
    time = np.arange(start, stop, 0.02)
    noise = 5e-3 * np.random.default_rng(round(10 * start)).standard_normal(len(time))
    position = swing(time, np.array(list(TRUTH.values()))) + noise
    return Recording(f"from {start:g} s", {"position": Channel("position", ("swing",), "rad", time, position)})


@pytest.fixture
def pendulum(formula: Callable[..., Simulator]) -> Simulator:
    parameters = (
        Parameter("height", "rad", 1.0, 0.2, 5.0), Parameter("frequency", "rad/s", 2.2, 1.0, 6.0),
        Parameter("decay", "1/s", 0.3, 0.0, 1.0), Parameter("bent", "1/s", 0.0, -0.2, 0.2, optional="a bend"),
    )  # fmt: skip
    return formula(swing, ParameterSpace(parameters))


def calibrated(
    simulator: Simulator, *recordings: Recording, earlier: Calibration | Earlier | None = None
) -> Calibration:
    return Preparation(Family(), simulator, recordings).calibrate(earlier=earlier)


def test_where_the_last_fit_leads_astray_is_searched_anew(pendulum: Simulator) -> None:
    """A moment near zero tells little of the frequency; what came of it then is wrong for everything that follows."""
    old, new = seen(0.0, 0.4), [seen(2.0, 4.0), seen(4.0, 6.0)]
    wrong = {**TRUTH, "frequency": 5.0, "height": 0.75}
    earlier = Earlier(wrong, (), (old.name,))
    found = calibrated(pendulum, old, *new, earlier=earlier)
    assert any("searched anew, which led lower" in note for note in found.notes)
    assert found.values[:2] == pytest.approx([TRUTH["height"], TRUTH["frequency"]], rel=0.02)


def test_a_structure_that_was_left_out_stays_out_while_new_recordings_do_without_it(pendulum: Simulator) -> None:
    old, new = [seen(0.0, 2.0), seen(2.0, 4.0)], [seen(5.0, 7.0), seen(7.0, 9.0)]
    first = calibrated(pendulum, *old)
    bent = replace(first.estimates[3], verdict="not supported", fitted=False, value=0.0)
    earlier = Earlier.of(replace(first, estimates=(*first.estimates[:3], bent)))
    assert earlier.left_out == ("bent",)
    assert earlier.recordings == tuple(r.name for r in old)
    *fitted, left_out = calibrated(pendulum, *old, *new, earlier=earlier).estimates
    assert all(e.fitted for e in fitted)
    assert (left_out.fitted, left_out.value, left_out.verdict) == (False, 0.0, "not supported")
