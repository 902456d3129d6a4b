# SPDX-License-Identifier: Apache-2.0
"""A balancing spring is no weight: declared it is estimated beside it, undeclared found, or said to be possible."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import identify
from trueup.identification.estimation.result import Identification, Parameter, relative_error
from trueup.identification.inertial import link_names
from trueup.identification.kinematic_tree import KinematicTree
from trueup.recording import Recording

AXES = {"apart": 0.3, "crossing": 0.0}
"""m between the axes of the first two joints: whether the first tells what hangs on the second, or gravity alone."""
COSINE = -25.0  # N m
STIFFNESS, SLACK = 30.0, 0.2


def robot(arms: SimpleNamespace, apart: float, rng: np.random.Generator) -> tuple[KinematicTree, KinematicTree]:
    """An arm, and its file: each mass off by a twentieth or so."""
    tree = arms.arm()
    offset = np.array(tree.offset)
    offset[1, 0] = apart
    tree = tree.replace(offset=offset)
    return tree, tree.replace(inertial=tree.inertial * np.exp(rng.normal(0.0, 0.05, (4, 1))))


def logs(arms: SimpleNamespace, tree: KinematicTree, kind: str) -> list[Recording]:
    """Three, the last of which is held out; a spring at the second joint."""
    made = []
    for seed in range(3):
        run = arms.recording(tree, np.random.default_rng(seed), f"run{seed}")
        q, torque = run.channel("position").values[:, 1], run.channel("torque")
        spring = {"": 0.0 * q, "strut": COSINE * np.cos(q), "torsion": STIFFNESS * (q - SLACK)}[kind]
        values = torque.values + spring[:, None] * (np.arange(4) == 1)
        made.append(run.replace(channels={**run.channels, "torque": torque.replace(values=values)}))
    return made


def found(
    arms: SimpleNamespace, apart: float, kind: str, declared: str = ""
) -> tuple[Identification, dict[str, float]]:
    """What is identified, and the truth of each number."""
    tree, file = robot(arms, apart, np.random.default_rng(5))
    *train, held = logs(arms, tree, kind)
    joint = tree.joints[1]
    drives = Drives.from_dict({"joints": {joint: {"spring": declared}}} if declared else {}, tree.joints)
    springs = {"kt_2": STIFFNESS * (kind == "torsion"), "ks_2": 0.0, "kc_2": COSINE * (kind == "strut")}
    rotors = {f"I{k + 1}m": float(value) for k, value in enumerate(arms.rotors)}
    bodies = dict(zip(link_names(4), np.ravel(tree.inertial).tolist(), strict=True))
    return identify(file, train, [held], drives=drives), {**bodies, **rotors, **springs}


def held(parameter: Parameter, truth: dict[str, float]) -> bool:
    """Whether four standard deviations and the digits of its name hold the truth of a combination."""
    parts = re.findall(r"(^|[-+]) ?(?:([\d.]+) )?([A-Za-z]\w*)", parameter.name)
    true = sum((-1.0 if sign == "-" else 1.0) * float(times or 1.0) * truth[name] for sign, times, name in parts)
    return abs(parameter.value - true) < 4.0 * parameter.deviation + 5e-3 * max(abs(true), 1.0)


def of_weight(result: Identification) -> list[Parameter]:
    """First moments that hang on the second joint."""
    return [p for p in result.parameters if p.name.startswith("mc2")]


@pytest.mark.parametrize("kind", ["strut", "torsion"])
@pytest.mark.parametrize("axes", AXES)
def test_a_declared_spring_is_estimated_beside_weight(arms: SimpleNamespace, axes: str, kind: str) -> None:
    result, truth = found(arms, AXES[axes], kind, declared=kind)
    named = [p for p in result.parameters if p.name.startswith("mc2") or re.search(r"k[tsc]_2", p.name)]
    assert all(held(p, truth) for p in named)
    assert any("identified" in p.verdict and re.search("kc_2" if kind == "strut" else "kt_2", p.name) for p in named)
    # Where only gravity tells what hangs on the joint, nothing but the sum of both is claimed.
    together = [p for p in of_weight(result) if "kc_2" in p.name]
    assert bool(together) == (axes == "crossing" and kind == "strut")


def test_a_spring_that_other_torque_tells_from_weight_is_found(arms: SimpleNamespace) -> None:
    result, truth = found(arms, AXES["apart"], "strut")
    assert "sine of a strut" in result.structure[1]
    assert all(held(p, truth) for p in of_weight(result))
    assert relative_error(result.held_out()) < 0.02


@pytest.mark.parametrize(
    ("kind", "declared", "doubt"), [("strut", "", True), ("strut", "none", False), ("", "", False)]
)
def test_a_spring_that_nothing_tells_from_weight_is_a_doubt(
    arms: SimpleNamespace, kind: str, declared: str, doubt: bool
) -> None:
    result, truth = found(arms, AXES["crossing"], kind, declared)
    said = [w for w in result.warnings if "may be balanced by a spring" in w]
    (along,) = [p for p in of_weight(result) if p.name.startswith("mc2x")]
    assert bool(said) == doubt == (along.verdict == "shared")
    assert said == [] or said[0].startswith(result.joints[1])
    assert held(along, truth) != (declared == "none")


def test_a_strut_at_a_joint_that_slides_is_refused(arms: SimpleNamespace) -> None:
    tree = arms.arm()
    tree = tree.replace(prismatic=[False, True, False, False])
    drives = Drives.from_dict({"joints": {"joint2": {"spring": "strut"}}}, tree.joints)
    with pytest.raises(IdentificationError, match=r"'joint2' slides.* choices of spring: torsion .*, none"):
        identify(tree, logs(arms, tree, "")[:1], drives=drives)
