# SPDX-License-Identifier: Apache-2.0
"""Contract checks for whoever writes a robot, simulator, search, evaluator, engine or quantity, to be called from a test."""

from trueup.testing.evaluator import check_evaluator
from trueup.testing.quantity import check_attributes, check_quantity
from trueup.testing.robot import check_robot
from trueup.testing.search import check_search
from trueup.testing.simulator import check_simulator

__all__ = ["check_attributes", "check_evaluator", "check_quantity", "check_robot", "check_search", "check_simulator"]
