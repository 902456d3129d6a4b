# SPDX-License-Identifier: Apache-2.0
"""Looks at recordings before anything is fitted to them: `inspect(recording).findings()` says what to mind."""

from __future__ import annotations

from trueup.inspection.inspection import ChannelInspection, Inspection, inspect
from trueup.inspection.stamps import Gap
from trueup.noise import estimate_grid, estimate_noise

__all__ = ["ChannelInspection", "Gap", "Inspection", "estimate_grid", "estimate_noise", "inspect"]
