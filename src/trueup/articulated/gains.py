# SPDX-License-Identifier: Apache-2.0
"""Gains that recordings name (kp 100, 200, 400 in the servo's own unit): stiffness and damping follow them in proportion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isclose, isnan, nan
from typing import Any

import numpy as np

from trueup.articulated.model import Model, Writable, servos
from trueup.errors import listed
from trueup.inspection.settings import ALL, GAINS, setting
from trueup.recording import Recording
from trueup.rounding import PRINTED


@dataclass(frozen=True)
class Gains:
    """Settings of the servos that recordings name, by quantity ('kp', 'kv')."""

    factors: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    """Of each recording and joint (`ALL` for all): its setting over that which the model stands for."""
    given_for: Mapping[str, float] = field(default_factory=dict)
    """The setting that the model stands for: 'kp' for all joints, else 'kp.JOINT'."""

    @classmethod
    def named_by(
        cls, recordings: Sequence[Recording], known: Mapping[str, float] | None = None,
        shipped: Mapping[str, float] | None = None, quantities: Sequence[str] = tuple(GAINS),
    ) -> tuple[Gains, list[str]]:  # fmt: skip
        """Those of recordings, and notes in words.

        A model stands for the settings that are `known` of it, as in `given_for`; else for those of recordings that were
        made with what its file has (`shipped`, alike); else for those of most recordings, the larger of two. What only
        some recordings name is not followed.
        """
        factors: dict[str, dict[str, dict[str, float]]] = {}
        given_for: dict[str, float] = {}
        notes: list[str] = []
        for quantity in quantities:
            named = {r.name: setting(r, quantity) for r in recordings}
            joints = list(dict.fromkeys(j for each in named.values() for j in each))
            joints = [j for j in joints if j != ALL] or joints
            lacking = [name for name, each in named.items() if not each]
            if lacking and joints:
                notes += _lacking(quantity, lacking, {v for each in named.values() for v in each.values()})
                continue
            values = {j: [each.get(j, each.get(ALL, nan)) for each in named.values()] for j in joints}
            values = {joint: each for joint, each in values.items() if not any(map(isnan, each))}
            idle = [joint for joint, each in values.items() if quantity == "kp" and max(each) == 0.0]
            values = {joint: each for joint, each in values.items() if max(each) > 0.0}
            idle = idle if values else []  # zero everywhere says that nobody filled it in
            given = _given(quantity, values, known or {}, shipped or {})
            factors[quantity] = {
                name: {**{j: each[i] / given[j] for j, each in values.items()}, **dict.fromkeys(idle, 0.0)}
                for i, name in enumerate(named)
            }
            notes += [f"gains of {listed(idle)} are 0 in all recordings: their servos do not pull"] if idle else []
            same = len(set(given.values())) < 2
            given_for |= {quantity if same else f"{quantity}.{joint}": own for joint, own in given.items()}
            notes += _sentences(quantity, given, {joint: sorted(set(each)) for joint, each in values.items()})
        return cls(factors, given_for), notes

    def factor(self, quantity: str, recording: str, *names: str) -> float:
        """The setting of a servo in a recording over that which the model stands for, by the first of its `names`."""
        each = self.factors.get(quantity, {}).get(recording, {})
        return next((each[name] for name in (*names, ALL) if name in each), 1.0)

    def scales(self, recordings: Sequence[str]) -> bool:
        """Whether any of these was made with other settings than the model stands for."""
        changed = [v for each in self.factors.values() for r in recordings for v in each.get(r, {}).values()]
        return any(value != 1.0 for value in changed)

    def scale(self, model: Model, copies: Writable, recordings: Sequence[str], rows: int) -> None:
        """Multiplies stiffness and damping of the position servos; `rows` simulations for each of `recordings`."""
        if not self.scales(recordings):
            return
        joints = {actuator: joint for joint, actuator in model.drives().items()}
        for servo in servos(model):
            names = (joints.get(servo, servo), servo)
            stiffness, damping = (
                np.repeat([self.factor(q, r, *names) for r in recordings], rows) for q in ("kp", "kv")
            )
            zero = copies.get("actuator.zero", servo)
            copies.set("actuator.kp", servo, stiffness * copies.get("actuator.kp", servo))
            copies.set("actuator.kv", servo, damping * copies.get("actuator.kv", servo))
            copies.set("actuator.zero", servo, zero)


def _given(
    quantity: str, values: Mapping[str, Sequence[float]], known: Mapping[str, float], shipped: Mapping[str, float]
) -> dict[str, float]:
    """The setting of each joint that a model stands for, above 0: those of one recording where nothing else is known."""
    keys = {joint: f"{quantity}.{joint}" for joint in values}
    together = Counter(zip(*values.values(), strict=True))

    def rank(settings: tuple[float, ...]) -> tuple[Any, ...]:
        own = sum(
            isclose(v, shipped.get(k, 0.0), rel_tol=PRINTED) for v, k in zip(settings, keys.values(), strict=True)
        )
        return own, together[settings], settings

    chosen = dict(zip(values, max(together, key=rank, default=()), strict=True))
    return {j: known.get(keys[j], known.get(quantity, 0.0)) or chosen[j] or max(values[j]) for j in values}


def _sentences(quantity: str, given: Mapping[str, float], values: Mapping[str, Sequence[float]]) -> list[str]:
    """What recordings with different gains are taken for."""
    differing = [joint for joint, each in values.items() if len({*each, given[joint]}) > 1]
    if not differing:
        return []
    alike: dict[tuple[str, float], list[str]] = {}
    for joint in differing:
        alike.setdefault((", ".join(f"{v:g}" for v in values[joint]), given[joint]), []).append(joint)
    if len(alike) == 1:
        (shown, own), joints = next(iter(alike.items()))
        whose = f" of {listed(joints)}" if len(joints) < len(given) else ""
        return [
            f"the recordings name the gain of their servos{whose} ({shown}), which '{quantity}' follows in proportion; it is "
            f"given for {own:g}"
        ]
    shown = "; ".join(f"{listed(joints)} {text}, given for {own:g}" for (text, own), joints in alike.items())
    return [f"the recordings name the gains of their servos, which '{quantity}' of each follows in proportion: {shown}"]


def _lacking(quantity: str, lacking: Sequence[str], values: Iterable[float]) -> list[str]:
    """What is said where only some recordings name a gain."""
    shown, word = ", ".join(f"{v:g}" for v in sorted(values)), GAINS[quantity][0]
    return [
        f"only some recordings name the gain of their servos ({shown}): '{quantity}' is taken to be the same in all. If not, "
        f"name it in {listed(lacking)} too: a column '{word}', or [channels.{word}] in the mapping"
    ]
