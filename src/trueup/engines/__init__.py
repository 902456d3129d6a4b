# SPDX-License-Identifier: Apache-2.0
"""Simulators of robots, one engine a module; `simulator.py` says what each must offer."""
