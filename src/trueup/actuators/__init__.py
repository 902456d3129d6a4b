# SPDX-License-Identifier: Apache-2.0
"""One servo by itself: its law, what an experiment with it tells, and how its model is delivered."""
