# SPDX-License-Identifier: Apache-2.0
"""The ways that are compared, by name: simulators, with and without the robot's scores told, and guidance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trueup.errors import unknown_name
from trueup.studies.walk.comparison import OnTheRobot, Searching, Way
from trueup.studies.walk.fitted import Fitted
from trueup.studies.walk.guidance import Automatic, Expert
from trueup.studies.walk.methods import Calibrated, Grounded, Ungrounded
from trueup.studies.walk.paces import paced
from trueup.studies.walk.study import alone

CONTROL, CHALLENGER = "noisy", "pace and lean"
"""The way that others must beat, and the one that is put beside it by default."""
DARING = 0.35
"""m/s that a fall costs where pace and lean are found: half of what searches in simulators reckon with (`Budget.fall`), whose
walks fall twice as often. Of 0.7, 0.5, 0.35 and 0.25 the one with two falls more in a hundred than at 0.7 on the formulas
of `benchmarks/dosing.py`, and chosen there alone."""
_SCORED = Ungrounded(corrected=True)
WAYS: Mapping[str, Way] = {
    CONTROL: Searching(Ungrounded()),
    "noisy, daring": Searching(Ungrounded(), fall=DARING),
    "noisy + expert": Searching(Ungrounded(), Expert()),
    "noisy + automatic": Searching(Ungrounded(), Automatic()),
    "noisy, daring + expert": Searching(Ungrounded(), Expert(), fall=DARING),
    "noisy, daring + automatic": Searching(Ungrounded(), Automatic(), fall=DARING),
    "noisy + corrected": Searching(_SCORED),
    "fitted": Searching(Fitted()),
    "grounded + linear 0.3": Searching(Grounded()),
    "grounded + tree 0.3": Searching(Grounded(learner="model-tree")),
    "grounded + linear chained": Searching(Grounded(share=1.0, chained=True)),
    "calibrated": Searching(Calibrated()),
    "calibrated + grounded": Searching(Grounded(Calibrated(), share=1.0, chained=True)),
    "grounded + linear 0.3 + corrected": Searching(Grounded(_SCORED)),
    "grounded + tree 0.3 + corrected": Searching(Grounded(_SCORED, learner="model-tree")),
    "grounded + linear chained + corrected": Searching(Grounded(_SCORED, share=1.0, chained=True)),
    "calibrated + corrected": Searching(Calibrated(_SCORED)),
    "calibrated + grounded + corrected": Searching(Grounded(Calibrated(_SCORED), share=1.0, chained=True)),
    CHALLENGER: OnTheRobot(paced, "the robot alone, pace and lean", DARING),
    "pace and lean, wary": OnTheRobot(paced, "the robot alone, pace and lean, wary of falls"),
    "robot alone": OnTheRobot(alone, "the robot alone"),
}


def ways(names: Sequence[str]) -> dict[str, Way]:
    """Those of these names. Raises UnknownNameError."""
    for name in names:
        if name not in WAYS:
            raise unknown_name("way", name, WAYS, "the study of walks")
    return {name: WAYS[name] for name in names}
