# SPDX-License-Identifier: Apache-2.0
"""A robot that people run: trials go out as files, logs come back as files."""

from trueup.robots.by_hand.robot import ByHand

__all__ = ["ByHand"]
