# SPDX-License-Identifier: Apache-2.0
"""The Stanley path follower: `law.py` in plain numpy, `kernel.py` compiled, both the same law."""

from trueup.controllers.stanley.law import GAINS, Stanley, StanleySettings

__all__ = ["GAINS", "Stanley", "StanleySettings"]
