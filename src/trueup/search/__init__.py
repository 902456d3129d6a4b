# SPDX-License-Identifier: Apache-2.0
"""Searches over the unit box, ask and tell; `search.py` says what each must offer."""
