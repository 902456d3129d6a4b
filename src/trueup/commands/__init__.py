# SPDX-License-Identifier: Apache-2.0
"""What each command of `trueup` does: one command a file; printing goes through a console that cli.py makes."""
