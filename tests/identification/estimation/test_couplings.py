# SPDX-License-Identifier: Apache-2.0
"""Couplings of drives that were found beside basic friction are asked about again beside the friction that was selected."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.identification.estimation.couplings import confirmed, coupling_notes
from trueup.identification.estimation.couplings import coupled as find_coupled
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.motion import log_of
from trueup.identification.estimation.selection import Choice
from trueup.identification.kinematic_tree import from_dh
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording

DIRECT = Drives.direct(["a", "b", "c"])
PLAIN = Choice(np.ones(4, dtype=bool), 0.0, np.ones(3))


def coupled(**ratios: float) -> Drives:
    """Drives of which `ba` turns with joint a too, and so on."""
    coupling = np.eye(3)
    for (drive, joint), ratio in ratios.items():
        coupling["abc".index(drive), "abc".index(joint)] = ratio
    return replace(DIRECT, coupling=coupling)


ERRORS = np.random.default_rng(0).uniform(0.9, 1.1, (16, 3))


def truly_coupled(drives: Drives) -> tuple[Choice, Choice]:
    """A model that predicts well with the drive of c turning with b, a little better or worse with b turning with a."""
    well = ERRORS * (0.2 if drives.coupling[2, 1] else 1.0)
    of_time, of_kinds = (1.02, 0.98) if drives.coupling[1, 0] else (1.0, 1.0)
    return replace(PLAIN, errors=of_time * well), replace(PLAIN, errors=of_kinds * well)


def in_a_narrow_log(drives: Drives) -> tuple[Choice, Choice]:
    """A model that predicts half of the blocks better with a coupling, the others worse: no clear evidence."""
    coupled_well = np.where(np.arange(16)[:, None] < 8, 0.6, 1.2) if drives.coupling[2, 1] else 1.0
    choice = replace(PLAIN, errors=ERRORS * coupled_well)
    return choice, choice


def test_a_coupling_that_other_friction_explains_as_well_is_left_out() -> None:
    kept = confirmed(coupled(ba=0.02, cb=0.8), DIRECT, truly_coupled)
    np.testing.assert_array_equal(kept.coupling, coupled(cb=0.8).coupling)
    assert [note[:32] for note in coupling_notes(kept, DIRECT)] == ["the drive of c turns with b too "]
    assert confirmed(coupled(ba=0.02), DIRECT, truly_coupled) is DIRECT


def test_a_coupling_stays_where_friction_that_stands_in_for_it_predicts_a_little_worse() -> None:
    with_it, without = (in_a_narrow_log(drives)[0] for drives in (coupled(cb=0.6), DIRECT))
    assert not with_it.beats(without)
    np.testing.assert_array_equal(
        confirmed(coupled(cb=0.6), DIRECT, in_a_narrow_log).coupling, coupled(cb=0.6).coupling
    )


def test_drives_that_nothing_couples_are_fitted_once() -> None:
    asked: list[Drives] = []
    assert confirmed(DIRECT, DIRECT, lambda drives: asked.append(drives) or [PLAIN]) is DIRECT
    assert not asked


@pytest.mark.parametrize(("pitch", "nut", "spline"), [(0.016, 2, 3), (0.05, 2, 3), (0.0, 2, 3), (0.02, 3, 2)])
def test_the_screw_of_a_scara_is_found_with_its_pitch(
    arms: SimpleNamespace, pitch: float, nut: int, spline: int
) -> None:
    """A lift that turns with the tool, by so many m a turn; the lift comes before the tool's joint, or behind it."""
    rng, lead = np.random.default_rng(4), pitch / (2.0 * np.pi)
    tree = from_dh(
        a=[0.3, 0.25, 0.0, 0.0], alpha=[0.0, 0.0, 0.0, 0.0], d=[0.2, 0.0, 0.0, 0.0], name="scara",
        prismatic=[False, False, nut == 2, nut == 3], inertial=arms.bodies(rng, np.array([6.0, 4.0, 1.0, 0.8])),
    )  # fmt: skip
    time, size = np.arange(6000) / 200.0, np.array([1.0, 1.0, 1.0, 1.0])
    size[nut] = 0.08
    q, v, a = (size * x for x in arms.sines(rng, time, 4))
    C, rotors, rubbing, slow = np.eye(4), np.full(4, 0.05), np.full(4, 0.4), np.full(4, 0.02)
    C[nut, spline], rotors[nut], rubbing[nut], slow[nut] = lead, 8.0, 15.0, 1e-3
    torque = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a)
    torque += (rotors * (a @ C.T) + rubbing * np.tanh(v @ C.T / slow)) @ C
    noise = 0.01 * np.sqrt(np.mean(torque**2, axis=0))
    channels = {
        "position": Channel("position", tree.joints, "rad", time, q + 2e-6 * rng.normal(size=q.shape)),
        "torque": Channel("torque", tree.joints, "N m", time, torque + noise * rng.normal(size=q.shape)),
    }
    drives = Drives.direct(tree.joints)
    log = log_of(Recording("run", channels), tree, drives)
    found = find_coupled([log.motion(5.0, measured_speed=False)], tree, drives, 5.0, 0.0)
    np.testing.assert_allclose(found.coupling, C, rtol=0.05, atol=0.0)
