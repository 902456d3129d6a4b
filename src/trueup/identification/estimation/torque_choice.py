# SPDX-License-Identifier: Apache-2.0
"""Which of several torques in a log is fitted: names decide where they can, else whoever asked is asked.

Never which is explained best: torque that a controller computed from a model of its own is explained by a model without
friction, and nothing could be better.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.errors import IdentificationError, counted
from trueup.identification.estimation.motion import TORQUES
from trueup.identification.estimation.quick import rough_error
from trueup.identification.kinematic_tree import KinematicTree
from trueup.noise import spread
from trueup.recording import Channel, Recording
from trueup.rounding import TINY

_ASKED = frozenset(re.split(r"\s+", """command cmd commanded desired des target ref reference setpoint sp computed calculated
calc model predicted prediction estimated feedforward ff ideal nominal control controller ctrl con compensation comp friction
fric gravity grav coriolis"""))  # fmt: skip
"""Words of a torque that nobody measured."""


@dataclass(frozen=True, eq=False)
class Torque:
    """One of the torques that a log holds."""

    title: str
    """How it is chosen."""
    channel: Channel
    """With the joints of the tree as its labels."""
    measured: bool


def with_one_torque(recording: Recording, tree: KinematicTree, wanted: str = "") -> tuple[Recording, str]:
    """The recording with one channel of torque, and a note where it holds others; `wanted` names the one to take.

    Raises IdentificationError, listing them with what is known of each, where names do not decide.
    """
    found = _torques(recording, tree)
    if not found or not recording.has("position"):
        return recording, ""
    chosen = choice(found, recording, tree, wanted)
    others = [t for t in found if t is not chosen]
    rest = {name: c for name, c in recording.channels.items() if _kind(name) is None}
    kind = _kind(chosen.channel.name) or "torque"
    made = recording.replace(channels={**rest, kind: chosen.channel.replace(name=kind)})
    if not others:
        return made, ""
    listed = ", ".join(f"'{t.title}'" for t in others)
    return made, f"torque was taken from '{chosen.title}'; the log has {listed} too (--torque takes another)"


def choice(found: Sequence[Torque], recording: Recording, tree: KinematicTree, wanted: str) -> Torque:
    """The one of several that is `wanted`, or that names decide on. Raises IdentificationError."""
    if wanted:
        named = [t for t in found if t.title == wanted] or [t for t in found if wanted in t.title]
        if len(named) == 1:
            return named[0]
    else:
        measured = [t for t in found if t.measured]
        # Filtered or external ones beside them have a channel of their own: torque_filtered.
        measured = [t for t in measured if t.title.split(" ")[0] in TORQUES] or measured
        plain = [t for kind in TORQUES for t in measured if t.title == kind]
        kinds = {_kind(t.channel.name) for t in measured}
        if len(measured) == 1 or (plain and len(kinds) == len(measured)):  # torque before current before load
            return plain[0] if plain else measured[0]
    said = f"no single one is '{wanted}'" if wanted else "names do not say which was measured"
    listed = "\n".join(f"  --torque '{t.title}': {_evidence(t, recording, tree)}" for t in found)
    raise IdentificationError(
        f"recording '{recording.name}' holds {counted(len(found), 'torque')}, and {said}; choose one:\n{listed}\n"
        "What a controller computes or asks for is smooth and explained best, with little friction: that does not make it "
        "what drives gave"
    )


def _evidence(torque: Torque, recording: Recording, tree: KinematicTree) -> str:
    values = torque.channel.values
    size = float(np.sqrt(np.nanmean(values**2)))
    noise = float(np.sqrt(np.mean(spread(np.diff(np.nan_to_num(values), n=2, axis=0)) ** 2) / 6.0))
    error = rough_error(
        tree, recording, {"position": recording.channel("position"), torque.channel.name: torque.channel}
    )
    left = f"a rough model leaves {100 * error:.2g} % of it" if np.isfinite(error) else "no rough model fits it"
    share = 100 * noise / max(size, TINY)
    return f"{size:.3g} {torque.channel.unit or 'of no unit'} on average, noise {share:.2g} %, {left}"


def _torques(recording: Recording, tree: KinematicTree) -> list[Torque]:
    """Every set of columns that could be the torque of all joints."""
    found = []
    for name, channel in recording.channels.items():
        if (kind := _kind(name)) is None:
            continue
        asked = name.startswith("command_")
        rest = [x for x in channel.labels if x not in tree.joints]
        if len(rest) < len(channel.labels) and set(tree.joints) <= set(channel.labels):
            found.append(Torque(name, channel.select(tree.joints).replace(name=kind), not asked))
        groups: dict[str, list[str]] = {}
        for label in rest:
            groups.setdefault(re.sub(r"[\W_]*\d+$", "", label), []).append(label)
        for word, labels in groups.items():
            if len(labels) == tree.n and len(groups) + (len(rest) < len(channel.labels)) > 1:
                own = channel.select(labels).replace(name=kind, labels=tree.joints)
                measured = not asked and not _ASKED & set(re.split(r"[\W_]+", word.casefold()))
                found.append(Torque(f"{name} {word}".strip(), own, measured))
    return found


def _kind(channel: str) -> str | None:
    """'torque', 'current' or 'load' of a channel's name; None for others."""
    plain = channel.removeprefix("command_")
    return next((kind for kind in TORQUES if plain == kind or plain.startswith(f"{kind}_")), None)
