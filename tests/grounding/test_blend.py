# SPDX-License-Identifier: Apache-2.0
"""How much of what is predicted a simulator is told: by all of the robot that is compared, not by its joints alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.grounding import blend
from trueup.grounding.blend import SHARES, Errors
from trueup.grounding.grounding import Grounding

CHANNELS = ("position", "base_position", "base_orientation")


class Weighted:
    """What `blended` needs of a grounding."""

    def weighted(self, own: float, share: float) -> tuple[float, float]:
        """The weights alone."""
        return own, share


def chosen(monkeypatch: pytest.MonkeyPatch, by_share: Sequence[Array]) -> blend.Blend:
    """What is chosen where errors of each channel go with the share like this, in eight recordings that differ."""
    rng = np.random.default_rng(0)
    values = 0.05 * np.stack(by_share, axis=1)[:, None] * np.exp(rng.normal(0.0, 0.05, (len(SHARES), 8, len(by_share))))
    errors = Errors(CHANNELS[: len(by_share)], values)
    monkeypatch.setattr(blend, "GroundedSimulator", lambda *_, **__: None)
    monkeypatch.setattr(blend, "compared", lambda *_: errors)
    nothing = cast("Grounding", Weighted())
    return blend.blended(
        nothing, cast("blend.Simulator", None), cast("list[blend.Recording]", [None] * 8), np.zeros(0)
    )[1]


def test_a_share_by_which_the_base_surely_leans_more_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    joints, place = np.exp(-1.5 * SHARES), np.ones_like(SHARES)
    leaning = np.exp(4.0 * np.maximum(SHARES - 0.35, 0.0))  # up to a share of 0.3 it stands as it is
    assert chosen(monkeypatch, [joints]).best == 1.0
    found = chosen(monkeypatch, [joints, place, leaning])
    assert 0.1 <= found.best <= 0.4
    assert chosen(monkeypatch, [joints, place, np.exp(3.0 * SHARES)]).best == 0.0


def test_what_grounding_leaves_as_it_is_hides_no_gain_of_the_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    found = chosen(monkeypatch, [np.exp(-1.5 * SHARES), np.ones_like(SHARES), np.ones_like(SHARES)])
    assert found.best >= 0.8
    assert found.least == pytest.approx(0.05 * np.exp(-0.5 * found.best), rel=0.1)
    assert "base_orientation" in found.why


def test_a_recording_without_a_base_counts_by_its_joints() -> None:
    values = np.full((2, 2, 2), 0.1)
    values[1] = 0.05
    values[:, 1, 1] = np.nan
    assert Errors(CHANNELS[:2], values).typical() == pytest.approx(np.array([[0.1, 0.1], [0.05, 0.05]]))
