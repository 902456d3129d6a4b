# SPDX-License-Identifier: Apache-2.0
"""Long drives are searched by a share of their stretches, from all over them; all have the last word."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Estimate
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.family import Vehicles
from trueup.engines.vehicle.judging import Ahead
from trueup.engines.vehicle.quantities import LASTING
from trueup.engines.vehicle.share import ENOUGH, shared
from trueup.engines.vehicle.vehicle import PURSUED
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
CAR = Vehicle("car", 0.4, drive=PURSUED, values=dict.fromkeys(LASTING, 0.0))


def circling(name: str, seconds: float) -> Recording:
    """A car that drives a circle of 4 m at 1 m/s, as a tracker sees it at 20 Hz."""
    time = np.arange(0.0, seconds, 0.05)
    turned = 0.25 * time
    noise = np.random.default_rng(0).normal(0.0, 2e-3, (len(time), 3))
    told = np.tile([1.0, np.arctan(0.1)], (len(time), 1))
    place = 4.0 * np.stack([np.sin(turned), 1.0 - np.cos(turned)], axis=1) + noise[:, :2]
    channels = (
        Channel("command", ("throttle", "steering"), "", time, told, ("m/s", "rad")),
        Channel("position", ("x", "y"), "m", time, place),
        Channel("heading", ("heading",), "rad", time, (turned + noise[:, 2])[:, None]),
    )
    return Recording(name, {c.name: c for c in channels})


def predicted(simulator: VehicleSimulator, drive: Recording) -> float:
    """How long a drive is predicted for, in s."""
    trial = Trial.of(drive, simulator.observable(drive))
    return 0.05 * float(np.isfinite(simulator.ahead(trial, drive.channel("position").time)).sum())


@pytest.mark.parametrize(("count", "seconds"), [(2, 900.0), (150, 12.0)])
def test_a_share_is_as_long_as_is_enough_and_from_all_over_the_drives(count: int, seconds: float) -> None:
    car, drives = VehicleSimulator(CAR), [circling(f"d{k}", seconds) for k in range(count)]
    part, seen, _ = shared(car, drives)
    each = [predicted(part, drive) for drive in seen]
    assert 0.8 * ENOUGH < sum(each) < 1.05 * ENOUGH
    halves = len(seen) // 2
    assert sum(each[:halves]) == pytest.approx(sum(each[halves:]), rel=0.2)
    assert [predicted(car, drive) for drive in drives] == pytest.approx([seconds] * count, abs=1.0)


def test_what_is_predicted_of_a_share_is_what_is_predicted_of_all() -> None:
    car, drives = VehicleSimulator(CAR), [circling("d", 1200.0)]
    part, seen, _ = shared(car, drives)
    trial = Trial.of(drives[0], car.observable(drives[0]))
    whole, some = (Ahead(s, drives).residuals(np.zeros(0), seen)[0] for s in (car, part))
    compared = Ahead(part).compared(drives[0], trial)
    assert 0.2 < compared.mean() < 0.3
    np.testing.assert_allclose(some[compared], whole[compared], atol=1e-9)
    predicted_at = np.isfinite(part.ahead(trial, drives[0].channel("position").time))
    began = np.flatnonzero(np.diff(predicted_at.astype(int)) == 1)
    assert len(Counter(np.diff(began).tolist())) > 2, "evenly spaced stretches would be the same places of every lap"


@dataclass(frozen=True)
class Fitted:
    """What stands for a calibration: values, and nothing to say."""

    values: Array
    estimates: tuple[Estimate, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@pytest.mark.parametrize(("seconds", "calls"), [(140.0, "all"), (200.0, "part, then all")])
def test_all_of_long_drives_have_the_last_word(seconds: float, calls: str) -> None:
    simulator = VehicleSimulator(CAR, CAR.space())
    drives, told = [circling(f"d{k}", seconds) for k in range(2)], []

    def fit(car: VehicleSimulator, some: Any, others: Any, *, start: Any = None, **how: Any) -> Fitted:
        told.append((sum(predicted(car, d) for d in some) > 0.9 * 2 * seconds, start is not None, len(others)))
        return Fitted(car.parameters.nominal if start is None else start)

    found = Vehicles().calibrate(simulator, drives, [circling("judge", 20.0)], fit)  # type: ignore[arg-type]
    assert sum("from all over the drives" in note for note in found.notes) == (calls != "all")
    if calls == "all":
        assert all(whole and others for whole, _, others in told)
    else:
        assert not any(whole for whole, begun, _ in told if not begun)
        assert told[-1] == (True, True, 1)
