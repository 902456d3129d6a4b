# SPDX-License-Identifier: Apache-2.0
"""The Stanley study: simulator calibrated on one drive, gains tuned in it, the robot drives better."""
