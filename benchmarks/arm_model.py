# SPDX-License-Identifier: Apache-2.0
"""The 6-joint arm of the calibration benchmarks as MJCF, with or without meshes that make it slow to compile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
TIMESTEP = 0.002  # [s]

# Proportions of a common 6-axis arm of 0.8 m reach: body, offset from parent [m], CoM [m], mass [kg],
# principal inertia about the CoM [kg m^2], joint axis, joint range [rad].
BODIES = (
    ("shoulder", (0, 0, 0.163), (0, 0.01, 0), 3.5, (0.011, 0.011, 0.009), (0, 0, 1), 3.1),
    ("upper_arm", (0, 0.138, 0), (0.2, 0, 0.01), 6.5, (0.015, 0.12, 0.12), (0, 1, 0), 3.1),
    ("forearm", (0.425, -0.12, 0), (0.18, 0, 0.01), 2.8, (0.004, 0.035, 0.035), (0, 1, 0), 2.8),
    ("wrist_1_link", (0.392, 0, 0), (0, 0.1, 0), 1.4, (0.0025, 0.0022, 0.0025), (0, 1, 0), 3.1),
    ("wrist_2_link", (0, 0.127, 0), (0, 0.01, -0.08), 1.3, (0.0025, 0.0025, 0.002), (0, 0, 1), 3.1),
    ("tool", (0, 0, -0.1), (0.02, 0.12, 0.03), 1.1, (0.004, 0.003, 0.004), (0, 1, 0), 3.1),
)
DAMPING = (6.0, 6.0, 4.0, 1.2, 1.0, 0.8)  # [N m s/rad]
FRICTION = (6.0, 6.0, 4.0, 1.2, 1.0, 0.8)  # [N m]
ARMATURE = (1.2, 1.2, 0.8, 0.12, 0.1, 0.08)  # [kg m^2]
_KP = (1000.0, 1000.0, 800.0, 200.0, 160.0, 100.0)  # [N m/rad]
_KV = (100.0, 100.0, 75.0, 12.0, 10.0, 7.0)  # [N m s/rad]
FORCE_LIMIT = (150.0, 150.0, 150.0, 30.0, 30.0, 30.0)  # [N m]


def mjcf(meshes: Sequence[str] = ()) -> str:
    """The nominal arm; each name in `meshes` is an STL file beside it, shown on one of the links without contacts."""
    chain = ""
    for i, (name, offset, com, mass, inertia, axis, limit) in reversed(list(enumerate(BODIES))):
        visuals = "".join(f'<geom type="mesh" mesh="{m}" contype="0" conaffinity="0"/>' for m in meshes[i::6])
        chain = (
            f'<body name="{name}" pos="{_text(offset)}">\n'
            f'<inertial pos="{_text(com)}" mass="{mass}" diaginertia="{_text(inertia)}"/>\n'
            f'<joint name="{JOINTS[i]}" axis="{_text(axis)}" range="{-limit} {limit}" damping="{DAMPING[i]}"'
            f' frictionloss="{FRICTION[i]}" armature="{ARMATURE[i]}"/>\n{visuals}{chain}</body>\n'
        )
    drives = "".join(
        f'<position name="{j}" joint="{j}" kp="{p}" kv="{v}" forcerange="{-f} {f}"/>\n'
        for j, p, v, f in zip(JOINTS, _KP, _KV, FORCE_LIMIT, strict=True)
    )
    sensors = "".join(
        f'<{kind} name="{j}_{role}" joint="{j}"/>\n'
        for kind, role in (("jointpos", "position"), ("jointvel", "velocity"), ("jointactuatorfrc", "torque"))
        for j in JOINTS
    )
    assets = "".join(f'<mesh name="{m}" file="{m}.stl"/>' for m in meshes)
    return (
        '<mujoco model="arm">\n<compiler angle="radian" autolimits="true"/>\n'
        f'<option timestep="{TIMESTEP}" integrator="implicitfast" solver="Newton"><flag contact="disable"/></option>\n'
        f"<asset>{assets}</asset>\n<worldbody>\n{chain}</worldbody>\n"
        f"<actuator>\n{drives}</actuator>\n<sensor>\n{sensors}</sensor>\n</mujoco>\n"
    )


def _text(numbers: Sequence[float]) -> str:
    return " ".join(f"{x:g}" for x in numbers)


def write_meshes(folder: Path, count: int) -> list[str]:
    """Writes `count` dented spheres of 20480 triangles as binary STL into `folder`; returns their names."""
    for i in range(count):
        rng = np.random.default_rng(i)
        corners = _sphere(5)
        dents = sum(np.sin(3 * corners @ rng.standard_normal(3) + rng.uniform(0, 6)) for _ in range(4))
        triangles = corners * (0.06 * (1 + 0.05 * np.asarray(dents)))[..., None]
        file = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
        file["corners"] = triangles
        (folder / f"visual_{i}.stl").write_bytes(bytes(80) + np.uint32(len(file)).tobytes() + file.tobytes())
    return [f"visual_{i}" for i in range(count)]


def _sphere(subdivisions: int) -> Array:
    """(20 * 4**subdivisions, 3, 3) corners of triangles on the unit sphere, from an icosahedron."""
    golden = (1 + 5**0.5) / 2
    ring = [(s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([(0, a, b) for a, b in ring] + [(a, b, 0) for a, b in ring] + [(b, 0, a) for a, b in ring])
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 2.1
    faces = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]
    ]
    triangles = points[np.array(faces)]
    turned = (
        np.einsum(
            "ni,ni->n", np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), triangles[:, 0]
        )
        < 0
    )
    triangles[turned] = triangles[turned][:, ::-1]
    for _ in range(subdivisions):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(p, axis=1) for p in parts])
    return triangles / np.linalg.norm(triangles, axis=2, keepdims=True)
