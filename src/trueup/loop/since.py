# SPDX-License-Identifier: Apache-2.0
"""What recordings that came since the last calibration say of what the model lacks: the answer of then, and others.

Neither the last fit nor the one with the structure that it was found to lack has seen these recordings: how well each
foretells them is evidence, without a new fit. Where that leaves it open, another structure, which those before did not ask
for, can be asked for now only if these do: it is looked at on them alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.calibration import Lacked
from trueup.engines.simulator import Simulator
from trueup.evidence import EXCERPT, explained, together
from trueup.loop.descent import Fit
from trueup.loop.earlier import Earlier
from trueup.loop.problem import Problem
from trueup.loop.scans import Look, Scan
from trueup.loop.segment import places
from trueup.loop.selection import compared
from trueup.loop.validate import block_errors, by_stretch
from trueup.parameters import ParameterSpace


@dataclass(frozen=True, eq=False)
class Known:
    """The structure that an earlier calibration found to be lacking, after recordings that came since."""

    look: Look
    """As it was fitted then, and how much lower its errors on the new recordings are than those of the fit of then."""
    lacked: Lacked
    """The fit of then, and what all recordings say of it by now."""
    foretells: bool
    """Whether the new recordings alone hold for it, or are foretold to about their noise: they ask for nothing else."""


@dataclass(frozen=True, eq=False)
class Since:
    """Structures after recordings that came since."""

    known: Known | None
    """What was lacking then: None where nothing was."""
    others: Sequence[Look]
    """Other structures that the new recordings ask for, the one that gains most first."""

    @property
    def stands(self) -> bool:
        """Whether the answer of then holds for all recordings, and errs less on the new ones than another structure would."""
        if self.known is None:
            return not self.others
        most = max((look.lower for look in self.others), default=-np.inf)
        return self.known.lacked.shown.holds and self.known.look.lower >= most

    @property
    def looks(self) -> list[Look]:
        """All of them, the one that lowers errors most first."""
        known = [] if self.known is None else [self.known.look]
        return sorted([*known, *self.others], key=lambda look: -look.lower)


def since(problem: Problem, found: Fit, earlier: Earlier, structures: Mapping[str, Simulator]) -> Since | None:
    """What new recordings say of structures, by those of an earlier calibration; None where none or all are new, or other
    parameters are fitted by now.
    """
    new = [k for k, own in enumerate(problem.owners) if not earlier.knew(problem.recordings[own])]
    if not new or len(new) == len(problem.trials):
        return None
    part = problem.replayed_by([problem.trials[k] for k in new], [problem.owners[k] for k in new])
    part = part.shortened(EXCERPT / len(new)) if part.duration > EXCERPT else part
    rows = places(problem.segments, part.segments, new)
    known = None
    if earlier.lacked is not None:
        known = _known(part, found.space, earlier, earlier.lacked, structures)
        if known is None:
            return None
    if explained(found.residual[rows]) if known is None else known.foretells:
        return Since(known, [])
    others = {name: s for name, s in structures.items() if known is None or name != known.look.name}
    return Since(known, Scan.of(problem, found, part, rows).favoured(others))


def _known(
    part: Problem, space: ParameterSpace, earlier: Earlier, lacked: Lacked, structures: Mapping[str, Simulator]
) -> Known | None:
    """The structure that was lacking, on recordings that came since; None where it was fitted beside parameters that are held
    by now. What was held then was so beside the structure, too.
    """
    sizes = {name: value for name, (value, _, _) in lacked.intervals.items() if name not in space.names}
    name = next((n for n, s in structures.items() if sizes.keys() <= set(s.parameters.names)), None)
    fitted = {
        p.name: lacked.intervals[p.name][0] for p in space.parameters if not p.frozen and p.name in lacked.intervals
    }
    if name is None or len(lacked.intervals) != len(fitted) + len(sizes):
        return None
    without = earlier.values_in(space)
    own = np.array([fitted.get(p.name, value) for p, value in zip(space.parameters, without, strict=True)])
    more = structures[name].parameters.parameters[len(space) :]
    values, wider = np.concatenate([own, [sizes.get(p.name, p.nominal) for p in more]]), part.by(structures[name])
    blocks = by_stretch(part)
    came = compared(*(
        block_errors(p, blocks, np.tile(row, (len(blocks), 1))) for p, row in ((part, without), (wider, values))
    ))  # fmt: skip
    shown = together(lacked.shown, len(earlier.recordings), came, len(set(part.owners)))
    look = Look(name, sizes, np.nan, came.gain, own)
    foretells = came.holds or explained(wider.residuals(values[None])[0])
    return Known(look, replace(lacked, shown=shown), foretells)
