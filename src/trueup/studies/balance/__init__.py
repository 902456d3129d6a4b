# SPDX-License-Identifier: Apache-2.0
"""The humanoid-balancing paper's robot and experiments."""
