# SPDX-License-Identifier: Apache-2.0
"""Contract checks for those who write a simulator or a search: call them from a test of your own."""

from trueup.testing.search import check_search
from trueup.testing.simulator import check_simulator

__all__ = ["check_search", "check_simulator"]
