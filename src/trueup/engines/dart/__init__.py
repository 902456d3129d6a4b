# SPDX-License-Identifier: Apache-2.0
"""DART as an engine: the same robots and trials with another engine's contacts (extra: pip install trueup[dart])."""

from trueup.engines.dart.model import DartModel, load, simulator

__all__ = ["DartModel", "load", "simulator"]
