# SPDX-License-Identifier: Apache-2.0
"""How far a simulated recording is from the real one; `discrepancy.py` says what each must offer."""
