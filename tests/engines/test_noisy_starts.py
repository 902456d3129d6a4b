# SPDX-License-Identifier: Apache-2.0
"""What a search of a car with noise of starts begins with: all that the search without it has found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trueup.calibration import Calibration, Estimate
from trueup.engines.simulator import Simulator
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.noisy_starts import confirmed
from trueup.engines.vehicle.vehicle import PURSUED

CAR = VehicleSimulator(Vehicle("car", 0.33, drive=PURSUED), Vehicle("car", 0.33, drive=PURSUED).space())
FOUND = {"steering_dead": 0.03, "push_lasts": 0.7}


def estimate(name: str, fitted: bool) -> Estimate:
    p = CAR.parameters[name]
    value = FOUND.get(name, p.nominal)
    return Estimate(p.name, p.unit, p.nominal, value, value, value, p.lower, p.upper, fitted, "identified", "")


@pytest.mark.parametrize("kept", [True, False])
def test_a_structure_that_a_car_was_found_to_have_is_not_asked_about_again(kept: bool) -> None:
    space, asked = CAR.parameters, {}
    every = (estimate(p.name, not p.frozen and (kept or not p.optional)) for p in space.parameters)
    found = Calibration("car", tuple(every), (), (), np.zeros((0, 0)))

    def fit(simulator: Simulator, *_: object, **how: Any) -> Calibration:
        asked.update(how, space=simulator.parameters)
        return found

    confirmed(CAR, found, False, [], [], fit)
    assert [bool(asked["space"][n].optional) for n in ("steering_dead", "grip")] == [not kept] * 2
    assert asked["start"][space.index("steering_dead")] == FOUND["steering_dead"]
    assert asked["space"]["push_lasts"].nominal == FOUND["push_lasts"]
