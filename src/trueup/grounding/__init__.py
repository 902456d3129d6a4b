# SPDX-License-Identifier: Apache-2.0
"""Grounded simulation: what a robot's joints do with a command is learned from its recordings and told to a simulator."""
