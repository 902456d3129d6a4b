# SPDX-License-Identifier: Apache-2.0
"""Calibrated values and identified bodies back into model files."""
