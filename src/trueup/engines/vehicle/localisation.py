# SPDX-License-Identifier: Apache-2.0
"""How noisy a vehicle's localisation is: what acts in closed loop only cannot be seen in a replay."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

from trueup.calibration import Calibration
from trueup.engines.vehicle.quantities import NOISES


def with_noise(calibration: Calibration, noise: tuple[float, float], said: Collection[str] = ()) -> Calibration:
    """The same with the localisation's noise (m, rad) as the drives show it, where the simulator declares it and no fit
    has found it; what is `said` of it elsewhere, or what they are too short to show (nan), stays as it is.
    """
    shown = {name: value for name, value in zip(NOISES, noise, strict=True) if name not in said and value == value}
    return dataclasses.replace(calibration, estimates=tuple(
        dataclasses.replace(e, value=min(max(shown[e.name], e.lower_bound), e.upper_bound), note="measured in the drives")
        if e.name in shown and not e.fitted else e
        for e in calibration.estimates
    ))  # fmt: skip
