# SPDX-License-Identifier: Apache-2.0
"""Which rotors are asked about when nobody says."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from trueup.articulated.declarations import Declaration
from trueup.articulated.quantities.known import quantity
from trueup.engines.mujoco.model import Model


def of_rotors(model: Model, joints: Sequence[str]) -> list[Declaration]:
    """Inertia of rotors at these joints, in proportion. A joint that nothing drives has none, unless the file says so: what
    adds to its link begins at nothing and may stay there, in parts of what the joint moves. A pendulum's period tells that to
    a ten thousandth, where as little as a drive's gear may have would bend all else.
    """
    kind, loose = quantity("armature"), _loose(model, joints)
    light = {j: kind.reach(model, j) for j in loose if kind.reach is not None and not kind.nominal(model, j)}
    rest = tuple(j for j in joints if j not in light)
    lines = [Declaration(kind.name, rest)] if rest else []
    return lines + [Declaration(kind.name, (j,), lower=0.0, upper=most, scale="linear") for j, most in light.items()]


def _loose(model: Model, joints: Sequence[str]) -> list[str]:
    """Those that no actuator, tendon or constraint drives."""
    m, by_joint = model.compiled, int(mujoco.mjtEq.mjEQ_JOINT)
    if any(int(kind) != by_joint for kind in m.eq_type):
        return []
    pulled = m.wrap_objid[m.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)]
    tied = {
        *model.actuator_of_joint(),
        *(model.names("joint")[j] for j in (*pulled, *m.eq_obj1id, *m.eq_obj2id) if j >= 0),
    }
    return [joint for joint in joints if joint not in tied]
