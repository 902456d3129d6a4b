# SPDX-License-Identifier: Apache-2.0
"""The ways that are compared, by name: simulators, with and without the robot's scores told, and guidance."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.errors import unknown_name
from trueup.studies.walk.comparison import Way
from trueup.studies.walk.fitted import Fitted
from trueup.studies.walk.guidance import Automatic, Expert
from trueup.studies.walk.methods import Bounded, Calibrated, Grounded, Ungrounded

CONTROL, CHALLENGER = "noisy", "fitted"
"""The way that others must beat, and the one that is put beside it by default."""
WAYS = {
    CONTROL: Way(Ungrounded()),
    "noisy + expert": Way(Ungrounded(), Expert()),
    "noisy + automatic": Way(Ungrounded(), Automatic()),
    "noisy + corrected": Way(Ungrounded(corrected=True)),
    CHALLENGER: Way(Fitted()),
    "bounded": Way(Bounded()),
    "grounded + linear 0.3": Way(Grounded()),
    "grounded + tree 0.3": Way(Grounded(learner="model-tree")),
    "grounded + linear chained": Way(Grounded(share=1.0, chained=True)),
    "calibrated": Way(Calibrated()),
    "calibrated + grounded": Way(Grounded(Calibrated(), share=1.0, chained=True)),
    "robot alone": Way(None),
}


def ways(names: Sequence[str]) -> dict[str, Way]:
    """Those of these names. Raises UnknownNameError."""
    for name in names:
        if name not in WAYS:
            raise unknown_name("way", name, WAYS, "the study of walks")
    return {name: WAYS[name] for name in names}
