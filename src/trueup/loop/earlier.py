# SPDX-License-Identifier: Apache-2.0
"""What an earlier calibration leaves for one with recordings that came since."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Lacked
from trueup.parameters import ParameterSpace
from trueup.recording import PART_OF, Recording

_LEFT_OUT = "not supported"


@dataclass(frozen=True)
class Earlier:
    """What an earlier calibration of the same simulator leaves for the next one."""

    values: Mapping[str, float]
    """By parameter."""
    left_out: tuple[str, ...]
    """Parameters of structures that it did without."""
    recordings: tuple[str, ...]
    """Names of those it was fitted to."""
    lacked: Lacked | None = None
    """What its model lacks."""

    @classmethod
    def of(cls, calibration: Calibration) -> Earlier:
        """What a calibration leaves."""
        e = calibration.estimates
        recordings = tuple(dict.fromkeys(r.recording for r in calibration.training()))
        return cls.estimated(
            [x.name for x in e], [x.value for x in e], [x.verdict for x in e], recordings, calibration.lacked
        )

    @classmethod
    def estimated(
        cls, names: Sequence[str], values: Sequence[float], verdicts: Sequence[str], recordings: Sequence[str],
        lacked: Lacked | None = None,
    ) -> Earlier:  # fmt: skip
        """The same from its parts, (n,) each but for the recordings and what is lacked."""
        left_out = tuple(name for name, verdict in zip(names, verdicts, strict=True) if verdict == _LEFT_OUT)
        return cls(dict(zip(names, values, strict=True)), left_out, tuple(recordings), lacked)

    def knew(self, recording: Recording) -> bool:
        """Whether it was fitted to a recording, or to the one that this is a part of."""
        return recording.provenance.get(PART_OF, recording.name) in self.recordings

    def values_in(self, space: ParameterSpace) -> Array:
        """(n,) its values of the parameters of a space; nominal ones of those that it had not."""
        return np.array([self.values.get(p.name, p.nominal) for p in space.parameters])
