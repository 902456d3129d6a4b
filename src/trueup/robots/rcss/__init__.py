# SPDX-License-Identifier: Apache-2.0
"""A running RoboCup 3D simulation server as a robot: `robot.py` performs trials, the other files speak its protocol."""

from trueup.robots.rcss.robot import RcssRobot

__all__ = ["RcssRobot"]
