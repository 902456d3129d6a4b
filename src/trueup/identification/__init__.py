# SPDX-License-Identifier: Apache-2.0
"""Dynamic models of arms from recordings of motion and torque, and the motion that makes them good."""
