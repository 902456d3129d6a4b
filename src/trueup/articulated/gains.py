# SPDX-License-Identifier: Apache-2.0
"""Gains that recordings name (kp 100, 200, 400 in the servo's own unit): stiffness and damping follow them in proportion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueup.articulated.model import Model, Writable, servos
from trueup.recording import Recording

_WORDS = {
    "kp": ("kp", "p_gain", "kp_gain", "position_p_gain", "p_coefficient"),
    "kv": ("kd", "kv", "d_gain", "kd_gain", "position_d_gain", "d_coefficient"),
}
"""Quantity to the words under which a log names the servo's setting."""


@dataclass(frozen=True)
class Gains:
    """Settings of the servos that recordings name, by quantity ('kp', 'kv')."""

    factors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Of each recording: its setting over that which the model stands for."""
    given_for: Mapping[str, float] = field(default_factory=dict)
    """The setting that the model stands for."""

    @classmethod
    def named_by(
        cls, recordings: Sequence[Recording], known: Mapping[str, float] | None = None
    ) -> tuple[Gains, list[str]]:
        """Those of recordings, and notes in words.

        A model stands for the setting that is `known` of it, by quantity, else for that of most recordings, the larger
        of two. Empty where not all recordings name a setting, or all name that of the model.
        """
        factors: dict[str, dict[str, float]] = {}
        given_for: dict[str, float] = {}
        notes: list[str] = []
        for quantity in _WORDS:
            named = {r.name: value for r in recordings if (value := _setting(r, quantity)) > 0.0}
            own = (known or {}).get(quantity, 0.0)
            if len(named) < len(recordings) or len({*named.values(), *([own] if own else [])}) < 2:
                continue
            counts = Counter(named.values())
            given_for[quantity] = own or max(counts, key=lambda v: (counts[v], v))
            factors[quantity] = {name: value / given_for[quantity] for name, value in named.items()}
            notes.append(
                f"the recordings name the gain of their servos ({', '.join(f'{v:g}' for v in sorted(counts))}), which "
                f"'{quantity}' follows in proportion; it is given for {given_for[quantity]:g}"
            )
        return cls(factors, given_for), notes

    def scale(self, model: Model, copies: Writable, recordings: Sequence[str], rows: int) -> None:
        """Multiplies stiffness and damping of the position servos; `rows` simulations for each of `recordings`."""
        if not self.factors:
            return
        stiffness, damping = (
            np.repeat([self.factors.get(q, {}).get(r, 1.0) for r in recordings], rows) for q in ("kp", "kv")
        )
        for servo in servos(model):
            zero = copies.get("actuator.zero", servo)
            copies.set("actuator.kp", servo, stiffness * copies.get("actuator.kp", servo))
            copies.set("actuator.kv", servo, damping * copies.get("actuator.kv", servo))
            copies.set("actuator.zero", servo, zero)


def _setting(recording: Recording, quantity: str) -> float:
    """What a recording says of the servos' gain, as a fact beside its signals or a column that never changes; 0 if not."""
    facts = {key.lower().rsplit(".", 1)[-1]: value for key, value in recording.provenance.items()}
    for word in _WORDS[quantity]:
        if word in facts:
            try:
                return float(facts[word])
            except ValueError:
                return 0.0
        if recording.has(word) and (column := recording.channel(word)).values.shape[1] == 1:
            values = column.values[np.isfinite(column.values)]
            return float(values[0]) if len(values) and np.ptp(values) == 0.0 else 0.0
    return 0.0
