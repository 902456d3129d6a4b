# SPDX-License-Identifier: Apache-2.0
"""Joints replayed one by one against the load of all else, which is taken from the measured motion: an approximation."""
