# SPDX-License-Identifier: Apache-2.0
"""What a robot is to do well; `task.py` says what each task must offer."""
