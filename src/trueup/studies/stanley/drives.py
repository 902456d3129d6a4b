# SPDX-License-Identifier: Apache-2.0
"""The name by which plans of earlier versions ask for the method 'drives'."""

from trueup.campaign.kinds import drives as calibrate_under_doubt

__all__ = ["calibrate_under_doubt"]
