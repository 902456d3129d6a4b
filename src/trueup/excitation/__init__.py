# SPDX-License-Identifier: Apache-2.0
"""Motions that make an identification good, and that the arm can perform; `excite.py` joins the rest."""
