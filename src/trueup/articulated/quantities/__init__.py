# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated: one object for each quantity, in files by what they belong to; `known.py` finds them by name."""
