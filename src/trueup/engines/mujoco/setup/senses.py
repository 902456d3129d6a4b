# SPDX-License-Identifier: Apache-2.0
"""Whether joints of an arm on servos turn the other way in the log than in the model, as their loads show."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.lone.loads import Motion, inverse_dynamics, measured_motion, rigid
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import joint_id
from trueup.evidence import EXCERPT, HALVED
from trueup.instant import usual_step
from trueup.noise import FEWEST
from trueup.recording import Recording
from trueup.rounding import ROUNDED, TINY
from trueup.trial import LOOK

_DELAYS = np.arange(0.0, 0.1, 0.01)
"""s by which servos are late: longer ones than those of slow buses."""


@dataclass(frozen=True, eq=False)
class _Servos:
    """A motion, and how far its k servos are behind what they were told each of DELAYS before: (D, L, k)."""

    motion: Motion
    behind: Array


def turned_otherwise(model: Model, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence where servos lag behind their commands as if a joint, or two, turned the other way than in the model.

    A servo is behind its command by what it carries over its stiffness, beside friction, damping and its rotor, all linear in
    unknown numbers; what it carries is inverse dynamics along the measured motion (C. Atkeson, C. An, J. Hollerbach,
    "Estimation of inertial parameters of manipulator loads and links", IJRR 5, 1986). () where other senses do not halve the
    squares that are left, as of joints that carry nothing of one another.
    """
    joints = _on_servos(model, recordings) if recordings else {}
    if len(joints) < 2:
        return ()
    known = rigid(model.compiled)
    seen = _excerpt(known, joints, recordings)
    if not seen:
        return ()
    dofs = [joint_id(known, joint) for joint in joints]
    same = np.ones(known.nv)
    as_told, loads = _left(known, dofs, seen, same)
    for count in (1, 2):
        found = {}
        for names, senses in _ways(list(joints), dofs, same, count):
            left, others = _left(known, dofs, seen, senses)
            differ = np.abs(others - loads).max(axis=0) > ROUNDED * np.abs(loads).max(axis=0)
            found[names] = float(left[differ].sum() / max(as_told[differ].sum(), TINY)) if differ.any() else 1.0
        least = min(found.values())
        if least < HALVED:
            return (
                _sentence(
                    [names for names in sorted(found, key=found.__getitem__) if HALVED * found[names] <= least], least
                ),
            )
    return ()


def _sentence(ways: Sequence[tuple[str, ...]], least: float) -> str:
    either = ", or ".join(" and ".join(f"'{name}'" for name in names) for names in ways)
    several = len(ways[0]) > 1
    return (
        f"servos lag behind their commands as if {either} turned the other way than in the model: squares of what their "
        f"loads leave unexplained fall to {100.0 * least:.2g} %. If {'they do' if several else 'it does'}, set sign = -1 of "
        f"{'them' if several else 'it'} in the mapping, for command and position; or turn the axis in the model"
    )


def _ways(
    joints: Sequence[str], dofs: Sequence[int], same: Array, count: int
) -> Iterator[tuple[tuple[str, ...], Array]]:
    for chosen in itertools.combinations(range(len(joints)), count):
        senses = same.copy()
        senses[[dofs[i] for i in chosen]] = -1.0
        yield tuple(joints[i] for i in chosen), senses


def _on_servos(model: Model, recordings: Sequence[Recording]) -> dict[str, str]:
    """Joints whose positions all recordings command and measure, each to the label of its command; none of models with a free
    base or with loops, whose loads are not known by the joints alone.
    """
    compiled = model.compiled
    looped = np.any(compiled.eq_type != int(mujoco.mjtEq.mjEQ_JOINT))
    if looped or compiled.nq != compiled.nv or not all(r.has("command") and r.has("position") for r in recordings):
        return {}
    told, measured = (
        set.intersection(*(set(r.channel(name).labels) for r in recordings)) for name in ("command", "position")
    )
    labels = {joint: next((n for n in (joint, drive) if n in told), "") for joint, drive in model.drives().items()}
    return {joint: label for joint, label in labels.items() if label and joint in measured}


def _excerpt(known: mujoco.MjModel, joints: Mapping[str, str], recordings: Sequence[Recording]) -> list[_Servos]:
    """Up to EXCERPT s of the beginnings of all recordings: what turns the other way does so in every motion."""
    found = []
    for recording in recordings:
        command, begin = recording.channel("command"), recording.channel("position").time[0]
        cut = recording.slice(begin, begin + EXCERPT / len(recordings)).channel("position")
        if len(cut.time) < FEWEST:
            continue
        motion = _thinned(measured_motion(known, cut, known.qpos0))
        dofs, asked = [joint_id(known, joint) for joint in joints], command.select(tuple(joints.values()))
        behind = np.stack([asked.at(motion.time - delay, hold=True) - motion.position[:, dofs] for delay in _DELAYS])
        if np.isfinite(behind).all():
            found.append(_Servos(motion, behind))
    return found


def _thinned(motion: Motion) -> Motion:
    """Every n-th instant of a motion, so that none is left much closer than LOOK."""
    step = max(1, int(LOOK / usual_step(motion.time)))
    return Motion(motion.time[::step], motion.position[::step], motion.speed[::step], motion.acceleration[::step])


def _left(known: mujoco.MjModel, dofs: Sequence[int], seen: Sequence[_Servos], senses: Array) -> tuple[Array, Array]:
    """(k,) shares of the squares of how far servos are behind their commands that loads do not explain, with joints in these
    senses (nv,), and the loads (L, k).
    """
    behind = np.concatenate([s.behind for s in seen], axis=1)
    speed, rate = (np.concatenate([getattr(s.motion, n) for s in seen]) for n in ("speed", "acceleration"))
    places = np.concatenate([s.motion.position for s in seen])
    loads = senses * inverse_dynamics(known, senses * places, senses * speed, senses * rate)[1]
    left = np.empty(len(dofs))
    for i, dof in enumerate(dofs):
        own = np.column_stack([np.ones(len(loads)), speed[:, dof], np.sign(speed[:, dof]), rate[:, dof]])
        left[i] = min(_unexplained(late, loads[:, dof], own) for late in behind[:, :, i])
    return left / np.maximum(np.sum((behind[0] - behind[0].mean(axis=0)) ** 2, axis=0), TINY), loads[:, dofs]


def _unexplained(behind: Array, load: Array, own: Array) -> float:
    """The squares that are left of (L,) by a load (L,), of which no servo takes less than none, and by the columns (L, m)."""
    basis, _ = np.linalg.qr(own)
    rest, carried = behind - basis @ (basis.T @ behind), load - basis @ (basis.T @ load)
    by = max(float(carried @ rest), 0.0) / max(float(carried @ carried), TINY)
    return float(np.sum((rest - by * carried) ** 2))
