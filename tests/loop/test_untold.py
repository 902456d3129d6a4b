# SPDX-License-Identifier: Apache-2.0
"""What recordings do not tell is asked about again once more is known, and does not count as known meanwhile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Calibration, Estimate
from trueup.engines.simulator import Simulator
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.untold import as_open
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.verdicts import Verdict

Array = NDArray[np.float64]
Formula = Callable[[Callable[[Array, Array, float], Array], ParameterSpace], Simulator]
Positions = Callable[[Array, Array], Array]
NOISE = 0.01  # rad


def _found(
    formula: Formula, positions: Callable[[Array, Array], Array], space: ParameterSpace, hidden: list[float]
) -> Calibration:
    rng, recordings, t = np.random.default_rng(5), [], np.arange(0.0, 20.0, 0.02)
    for name in ("one", "two"):
        values = positions(t, np.array(hidden)) + NOISE * rng.standard_normal(len(t))
        recordings.append(Recording(name, {"position": Channel("position", ("joint",), "rad", t, values[:, None])}))
    simulator = formula(lambda t, v, _: positions(t, v if len(v) else space.nominal), space)
    return calibrate(simulator, recordings, options=Options(cross_validate=False))


def test_what_only_a_structure_shows_is_found_with_it_though_it_was_frozen_before(formula: Formula) -> None:
    def positions(t: Array, v: Array) -> Array:
        return v[0] * np.sin(t) + (v[1] + 1e-3) * np.cos(3.0 * t + v[2])

    space = ParameterSpace((
        Parameter("size", "", 0.5, 0.0, 2.0),
        Parameter("push", "rad", 1.0, 0.0, 4.0, optional="push", absent=0.0),
        Parameter("phase", "rad", 0.0, -1.5, 1.5),
    ))  # fmt: skip
    found = _found(formula, positions, space, [1.0, 2.0, 0.7])
    phase = next(e for e in found.estimates if e.name == "phase")
    assert phase.verdict == "identified"
    assert abs(phase.value - 0.7) < 0.01
    assert not any("phase" in said for said in found.unidentified)


def test_gains_are_not_known_where_nobody_knows_how_heavy_the_rotor_is(formula: Formula) -> None:
    def positions(t: Array, v: Array) -> Array:
        return 0.5 * v[0] / (1.0 + v[2]) * np.sin(t) + 0.3 * v[1] * np.cos(2.0 * t)

    space = ParameterSpace((
        Parameter("stiffness", "", 0.5, 0.01, 30.0, scale="log"),
        Parameter("other", "", 0.5, 0.01, 30.0, scale="log"),
        Parameter("rotor", "kg m2", 1e-5, 1e-5, 4.0, scale="log", vanishes=True, shown_by="fast motion"),
    ))  # fmt: skip
    stiffness, other, rotor = _found(formula, positions, space, [3.0, 1.0, 2.0]).estimates
    assert not rotor.fitted
    assert stiffness.low <= 3.0 <= stiffness.high
    assert stiffness.verdict == "weak"
    assert stiffness.note == "hangs on rotor, which these recordings do not tell; fast motion would show it"
    assert other.verdict == "identified"
    assert other.high - other.low < 0.05


@pytest.mark.parametrize("hidden", [0.0, 0.4, 0.5])
def test_an_interval_holds_though_another_is_held_where_nobody_knows_it_to_be(formula: Formula, hidden: float) -> None:
    def positions(t: Array, v: Array) -> Array:
        return (v[0] + 0.05 * v[1]) * np.sin(t) + 1e-5 * v[1] * np.cos(t)

    space = ParameterSpace((Parameter("size", "", 0.5, 0.0, 2.0), Parameter("other", "", 0.0, 0.0, 1.0)))
    size, other = _found(formula, positions, space, [1.0, hidden]).estimates
    assert not other.fitted
    assert size.verdict == "identified"
    assert size.low <= 1.0 <= size.high
    assert size.high - size.low < 0.1


@pytest.mark.parametrize("untold", [(), ("other",)])
def test_a_limit_that_its_profile_calls_weak_owes_that_to_nothing_that_is_untold(untold: tuple[str, ...]) -> None:
    limit = Estimate("limit", "N m", 5.0, 6.0, 3.0, 9.0, 1.0, 20.0, True, "weak", "met now and then only")
    surely = [Verdict("identified", "")]
    assert as_open([limit], surely, surely, np.zeros((1, len(untold))), untold) == (limit,)
    loose = [Verdict("weak", "known roughly only")]
    told = as_open([limit], surely, loose, np.ones((1, 1)), ["other"])
    assert "do not tell other" in told[0].note
