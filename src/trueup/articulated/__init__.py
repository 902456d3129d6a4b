# SPDX-License-Identifier: Apache-2.0
"""Robots of bodies, joints and drives as far as no engine matters: what may be calibrated, signals, names, their file."""
