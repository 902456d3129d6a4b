# SPDX-License-Identifier: Apache-2.0
"""Robots, real and simulated; `robot.py` says what each must offer."""
