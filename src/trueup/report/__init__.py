# SPDX-License-Identifier: Apache-2.0
"""The report: one HTML file that tells whether a calibration is better, where, how sure, and what is missing."""

from trueup.report.picture import before_after_picture, replay_picture, write_pictures
from trueup.report.report import write_report

__all__ = ["before_after_picture", "replay_picture", "write_pictures", "write_report"]
