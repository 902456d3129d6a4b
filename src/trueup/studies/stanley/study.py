# SPDX-License-Identifier: Apache-2.0
"""What the whole study found: made by run.py, told by report.py."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trueup.arrays import Array
from trueup.campaign.history import History
from trueup.studies.stanley.courses import Courses
from trueup.studies.stanley.paper import PaperStudy, Searched
from trueup.studies.stanley.profile import Profile


@dataclass(frozen=True, eq=False)
class Study:
    """All that the report tells."""

    paper: PaperStudy
    paper_seconds: float
    """Wall time of the paper's part, both runs of the robot and all trials."""
    rounds: History
    """The campaign of the shipped plan."""
    noise: Searched
    """The paper's search with localisation noise among the parameters."""
    noise_truth: tuple[float, float]
    """What the stand-in really has, in m and rad."""
    profiles: tuple[Profile, ...]
    courses: Courses
    errors: Array
    """(3,) true distance of the robot from the path, in m: initial gains, the paper's way, in rounds."""
    driven: tuple[Array, Array]
    """(n, 2) in m: where the robot drove with its initial gains, and with the best that the rounds found."""
    seconds: float
    report: Path | None = None
