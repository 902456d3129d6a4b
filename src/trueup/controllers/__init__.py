# SPDX-License-Identifier: Apache-2.0
"""Controllers that command a robot or its simulators; `controller.py` says what each must offer."""
