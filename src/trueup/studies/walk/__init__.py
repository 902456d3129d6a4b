# SPDX-License-Identifier: Apache-2.0
"""The robot and the experiments of the paper on grounded simulation learning."""
