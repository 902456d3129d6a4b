# SPDX-License-Identifier: Apache-2.0
"""What the study consists of: how much is done on each robot, and the parts that are computed and kept one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from trueup.loop.surest import Effort
from trueup.studies.balance.campaign import Scale

SCENES: tuple[str, ...] = ("lean-to-stand", "sit-to-stand", "kneel-to-stand", "stand-to-handstand")
"""The paper's tasks I to IV."""


@dataclass(frozen=True)
class Depth:
    """How much is done on each robot: what is computed with another depth is another study."""

    rounds: int = 2
    generations: int = 10
    """Of CMA-ES in each calibration, of 32."""
    searched: int = 16
    """Generations of each search at most, of 32; at most half as many follow in several models."""
    hunted: int = 3200
    """Simulations that the search of a first motion may take."""
    seed: int = 0

    @property
    def scale(self) -> Scale:
        """Of each campaign."""
        return Scale(self.rounds, generations=self.generations, effort=Effort(generations=self.searched))


@dataclass(frozen=True)
class Size:
    """How far a study goes: a folder may be gone on with by more robots and tasks."""

    stand_ins: int = 10
    scenes: tuple[str, ...] = SCENES
    depth: Depth = field(default_factory=Depth)
    randomised: bool = True
    """Whether a motion searched in many random models is tried beside."""
    oracle: int = 24
    """Runs of the robot that a search on it may take; 0: none is made."""
    subsets: int = 2
    """Stand-ins on which the paper's Table I is regenerated."""
    first: int = 0
    """Number of the first stand-in; those of the study are 0 to 9."""

    @property
    def numbers(self) -> range:
        """The stand-ins."""
        return range(self.first, self.first + self.stand_ins)


@dataclass(frozen=True)
class Part:
    """One thing that is computed and kept under its name."""

    kind: str
    """'first', 'wide', 'rounds', 'randomised', 'oracle' or 'table'."""
    scene: str = ""
    number: int = 0
    on: tuple[str, ...] = ()
    """Of the table: the scenes that are calibrated on; `scene` is empty."""
    runs: int = 0
    """Of the oracle: runs of the robot."""

    @property
    def name(self) -> str:
        """Says what it is."""
        where = f"{self.scene}, stand-in {self.number}"
        return {
            "first": f"{self.scene}, first motion", "wide": f"{self.scene}, motion for many models",
            "rounds": where, "randomised": f"{where}, randomised",
            "oracle": f"{where}, searched on it {self.runs}",
            "table": f"calibrated on {'+'.join(self.on)}, stand-in {self.number}",
        }[self.kind]  # fmt: skip


def stages(size: Size) -> tuple[list[Part], ...]:
    """Stages of parts that need none of each other; campaigns first, robot by robot: one that stops tells of all tasks."""
    robots = [(scene, n) for n in size.numbers for scene in size.scenes]
    table = [s for s in SCENES[:3] if s in size.scenes]
    beside = [Part("randomised", scene, n) for scene, n in robots if size.randomised]
    beside += [Part("table", number=n, on=on) for n in list(size.numbers)[: size.subsets] for on in subsets(table)]
    beside += [Part("oracle", scene, n, runs=size.oracle) for scene, n in robots if size.oracle]
    return (
        [Part("first", scene) for scene in size.scenes], [Part("rounds", scene, n) for scene, n in robots],
        [Part("wide", scene) for scene in size.scenes if size.randomised], beside,
    )  # fmt: skip


def subsets(scenes: Sequence[str]) -> list[tuple[str, ...]]:
    """One, two, three of them, as the paper's Table I has them."""
    masks = sorted(
        range(1, 2 ** len(scenes)), key=lambda m: (m.bit_count(), [-(m >> k & 1) for k in range(len(scenes))])
    )
    return [tuple(s for k, s in enumerate(scenes) if m >> k & 1) for m in masks]
