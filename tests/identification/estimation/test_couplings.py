# SPDX-License-Identifier: Apache-2.0
"""Couplings of drives that were found beside basic friction are asked about again beside the friction that was selected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.identification.estimation.couplings import confirmed, coupling_notes
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.selection import Choice

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
