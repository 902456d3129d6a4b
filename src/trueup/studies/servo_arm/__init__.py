# SPDX-License-Identifier: Apache-2.0
"""A simulated servo arm with a hidden truth, recorded and calibrated: what `trueup demo --robot arm` runs."""
