# SPDX-License-Identifier: Apache-2.0
"""From logs to a dynamic model that predicts torque; `identify.py` is the sentence that joins the rest."""
