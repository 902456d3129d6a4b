# SPDX-License-Identifier: Apache-2.0
"""The whole study: each transition on stand-ins with different hidden truths, beside two other ways; into a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from trueup.studies.balance.campaign import most
from trueup.studies.balance.once import Firsts, computed
from trueup.studies.balance.plan import SCENES, Depth, Part, Size, stages
from trueup.studies.saved import Parts

Told = Callable[[str, float], None]

QUICK = Size(stand_ins=3, scenes=SCENES[:2], randomised=False, oracle=0, subsets=0)


@dataclass
class Findings:
    """All that the report tells, as it was saved."""

    size: Size
    first: dict[str, Any] = field(default_factory=dict)
    """Scene to the motions found in the model as it is, and in many random ones."""
    campaigns: dict[str, dict[int, Any]] = field(default_factory=dict)
    """Scene to stand-in to rounds."""
    randomised: dict[str, dict[int, list[bool]]] = field(default_factory=dict)
    oracle: dict[str, dict[int, int]] = field(default_factory=dict)
    """Runs of the robot until a search on it succeeded; 0: it did not."""
    subsets: dict[str, dict[str, list[bool]]] = field(default_factory=dict)
    """Table I: scenes calibrated on, joined by '+', to scene tried to whether each stand-in succeeded."""

    def share(self, scene: str, rounds: int) -> float:
        """Of the stand-ins on which a scene's motion worked after so many calibrations; NaN without any."""
        done = self.campaigns.get(scene, {}).values()
        return (
            float(np.mean([any(r["succeeded"] for r in each[: rounds + 1]) for each in done])) if done else float("nan")
        )

    def overall(self, rounds: int) -> float:
        """The mean share over tasks, after so many calibrations; NaN without any."""
        shares = [self.share(scene, rounds) for scene in self.campaigns]
        return float(np.mean(shares)) if shares else float("nan")

    def needed(self, scene: str) -> list[int]:
        """Calibrations until it worked, of the stand-ins on which it did."""
        done = [[r["succeeded"] for r in each] for each in self.campaigns.get(scene, {}).values()]
        return [each.index(True) for each in done if True in each]

    def blindly(self, scene: str) -> float:
        """Share of the stand-ins on which the motion searched in random models works."""
        return (
            float(np.mean([most(x) for x in self.randomised[scene].values()])) if scene in self.randomised else np.nan
        )

    def generalised(self) -> tuple[int, float]:
        """Trials of Table I after a calibration on several tasks, and the share of them that worked; NaN without any."""
        cells = [x for on, per in self.subsets.items() if "+" in on for worked in per.values() for x in worked]
        return len(cells), float(np.mean(cells)) if cells else float("nan")

    def unfitted(self) -> tuple[int, float, float]:
        """How many motions were tried after one calibration on others, and in them the root mean square angles in rad between
        the robot's torso and the simulated one: by the model file, and as calibrated.
        """
        return _errors([r["errors"] for per in self.campaigns.values() for each in per.values() for r in each[1:2]])

    def left_out(self) -> tuple[int, float, float]:
        """The same of repeats of the fitted motions that were left out of the fit, as in the paper's Figure 5."""
        first = [each[0] for per in self.campaigns.values() for each in per.values()]
        return _errors([r["repeat"] for r in first if "repeat" in r])

    def put(self, part: Part, found: Any) -> None:
        """Keeps what was found."""
        match part.kind:
            case "first" | "wide":
                self.first[part.scene] = {**self.first.get(part.scene, {}), **found}
            case "table":
                for scene, worked in found.items():
                    self.subsets.setdefault("+".join(part.on), {}).setdefault(scene, []).append(worked)
            case _:
                table = {"rounds": self.campaigns, "randomised": self.randomised, "oracle": self.oracle}[part.kind]
                table.setdefault(part.scene, {})[part.number] = found


def _errors(pairs: Sequence[Sequence[float]]) -> tuple[int, float, float]:
    before, after = np.sqrt(np.mean(np.square(pairs), axis=0)) if pairs else (np.nan, np.nan)
    return len(pairs), float(before), float(after)


def studied(folder: Path, size: Size, told: Told, *, compute: bool = True, workers: int = 1) -> Findings:
    """Computes what is not in the folder yet, or leaves it out, with so many processes at a time.

    Raises OutputError where a study of another depth is in it.
    """
    kept, findings = Parts.at(folder, size.depth), Findings(size)
    whole = stages(size)
    done, count = 0, sum(len(stage) for stage in whole)
    for number, stage in enumerate(whole):
        # Those that stand in their own simulator; a robot's row of the table needs all of its scenes.
        known = {scene: f for scene, f in findings.first.items() if f["share"] >= 0.5}
        possible = [p for p in stage if not number or ((p.scene in known) if p.scene else set(p.on) <= set(known))]
        for part in _there(kept, possible, size.depth, known, compute, workers):
            told(part.name, done / count)
            done += 1
        for part in possible:
            if kept.has(part.name):
                findings.put(part, kept.text(part.name, dict))
    return findings


def _there(
    kept: Parts, wanted: Sequence[Part], depth: Depth, known: Firsts, compute: bool, workers: int
) -> Iterator[Part]:
    """Each part once it is in the folder: those that were there already come first."""
    missing = [p for p in wanted if not kept.has(p.name)]
    yield from (p for p in wanted if p not in missing)
    if not compute:
        return
    many = min(workers, len(missing))
    with ProcessPoolExecutor(many, mp_context=get_context("spawn")) if many > 1 else nullcontext() as pool:
        made = map if pool is None else pool.map
        for wait in (False, True):  # what another process in this folder computes comes last
            done = list(missing)
            try:
                for part, there in zip(done, made(partial(_kept, kept, depth, known, wait), done), strict=True):
                    if there:
                        missing.remove(part)
                        yield part
            except BaseException:
                if pool is not None:
                    pool.shutdown(wait=False, cancel_futures=True)
                raise


def _kept(kept: Parts, depth: Depth, known: Firsts, wait: bool, part: Part) -> bool:
    """Whether a part is there now, computed if nobody else does."""
    with kept.claimed(part.name, wait=wait) as own:
        if own:

            def led(name: str, make: Callable[[], object]) -> Any:
                return kept.text(f"{part.name}, {name}", make)

            kept.text(part.name, lambda: computed(part, depth, known, led))
        return own
