# SPDX-License-Identifier: Apache-2.0
"""Contract checks for those who write a robot, simulator, search, engine or quantity: call them from a test of your own."""

from trueup.testing.quantity import check_attributes, check_quantity
from trueup.testing.robot import check_robot
from trueup.testing.search import check_search
from trueup.testing.simulator import check_simulator

__all__ = ["check_attributes", "check_quantity", "check_robot", "check_search", "check_simulator"]
