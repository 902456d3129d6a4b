# SPDX-License-Identifier: Apache-2.0
"""`python -m trueup`: the same as the command `trueup`, where that is not on the path."""

import sys

from trueup.cli import main

sys.exit(main())
