# SPDX-License-Identifier: Apache-2.0
"""Stretches in which something acted on an arm whose torques are commanded, known before anything is searched.

A search bends the model to what acted in every recording, so that nothing stands out from its replays any more; from the
arm's own dynamics, fitted to the half of the samples that agree best, it does.
"""

from __future__ import annotations

from collections.abc import Sequence

from trueup.engines.family import Family
from trueup.engines.simulator import Simulator
from trueup.errors import TrueupError
from trueup.loop.disturbed import LeftOut
from trueup.recording import Recording


def pushed(family: Family, simulator: Simulator, recordings: Sequence[Recording]) -> LeftOut:
    """What is to be left out of recordings that are replayed by a simulator; nothing unless its family can tell the joint
    torques of all of them, of an arm whose dynamics are linear in its bodies (not of a free base, or a closed loop).
    """
    arm, told = family.torques(simulator, recordings)
    if arm is None:
        return LeftOut()
    # Imported here: calibrations of servos and of vehicles begin without it.
    from trueup.identification.estimation.disturbed import disturbed
    from trueup.identification.estimation.drives import Drives
    from trueup.identification.estimation.matching import matched
    from trueup.identification.estimation.motion import log_of

    try:
        tree, (named, _), _ = matched(arm, (list(told), []))
        drives = Drives.direct(tree.joints)
        spans, note = disturbed([log_of(r, tree, drives) for r in named], tree, drives)
    except TrueupError:
        return LeftOut()
    gaps = {name: [(first, last - first) for first, last in own] for name, own in spans.items()}
    return LeftOut((gaps,), (note,)) if gaps else LeftOut()
