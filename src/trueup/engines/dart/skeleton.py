# SPDX-License-Identifier: Apache-2.0
"""Robots as DART has them: a skeleton of bodies, joints and shapes in a world, from a compiled MJCF or URDF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import dartpy
import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.floor_plane import plane_of, turned
from trueup.engines.mujoco.shapes import PLATE
from trueup.errors import ModelError

_GEOM = mujoco.mjtGeom


def new_world(model: mujoco.MjModel, hulls: Mapping[int, Any]) -> Any:
    """A `dartpy.simulation.World` with the robot, and with the shapes of the model's world as a second, unmoved skeleton.

    `hulls` are those of the model's meshes (`hulls.hulls`). Contacts are found by Bullet, which knows all primitive shapes,
    and where there are hulls by ODE, in which they slide as boxes do (Bullet lets them turn and sink); they are solved as a
    linear complementarity problem with a pyramid of friction. Raises ModelError for joints and shapes that it cannot have.
    """
    world = dartpy.simulation.World()
    world.setGravity(np.array(model.opt.gravity))
    solver = world.getConstraintSolver()
    finder = dartpy.collision.OdeCollisionDetector if hulls else dartpy.collision.BulletCollisionDetector
    solver.setCollisionDetector(finder())
    ground, robot = _ground(model, hulls), _robot(model, hulls)
    world.addSkeleton(ground)
    world.addSkeleton(robot)
    blocked = solver.getCollisionOption().collisionFilter
    for signature in model.exclude_signature:
        first, second = (_body(model, int(i)) for i in (signature >> 16, signature & 0xFFFF))
        if first and second and robot.getBodyNode(first) and robot.getBodyNode(second):
            blocked.addBodyNodePairToBlackList(robot.getBodyNode(first), robot.getBodyNode(second))
    return world


def transform(position: Array, quaternion: Array) -> Any:
    """A `dartpy.math.Isometry3` of a place in m and a quaternion (w first)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, dtype=np.float64))
    made = dartpy.math.Isometry3()
    made.set_rotation(matrix.reshape(3, 3))
    made.set_translation(np.asarray(position, dtype=np.float64))
    return made


def shapes_of(world: Any, geom: str) -> list[Any]:
    """All of one name."""
    bodies = [body for name in ("world", "robot") for body in world.getSkeleton(name).getBodyNodes()]
    return [shape for body in bodies for shape in body.getShapeNodes() if shape.getName() == geom]


def plane_name(model: mujoco.MjModel) -> str:
    """That of the plane on which the robot stands."""
    return _geom(model, plane_of(model))


def lay_floor(model: mujoco.MjModel, world: Any, height: float, tilt: Array) -> None:
    """Moves the plane on which the robot stands to a height in m, and turns it about x and y, (2,) in rad."""
    own = plane_of(model)
    (turn,) = turned(model.geom_quat[own], *np.asarray(tilt)[:, None])
    for shape in shapes_of(world, plane_name(model)):
        shape.setRelativeTransform(_placed(np.array([*model.geom_pos[own, :2], height]), turn, -PLATE[2]))


def _placed(position: Array, quaternion: Array, offset: float = 0.0) -> Any:
    """A shape's place in m and quaternion, moved by `offset` m along its own z axis."""
    there = transform(position, quaternion)
    return there.multiply(transform(np.array([0.0, 0.0, offset]), np.array([1.0, 0.0, 0.0, 0.0]))) if offset else there


def _body(model: mujoco.MjModel, i: int) -> str:
    return model.body(i).name or f"body{i}"


def _geom(model: mujoco.MjModel, i: int) -> str:
    return model.geom(i).name or f"geom{i}"


def _ground(model: mujoco.MjModel, hulls: Mapping[int, Any]) -> Any:
    ground = dartpy.dynamics.Skeleton("world")
    _, node = ground.createWeldJointAndBodyNodePair()
    node.setName("world")
    _add_shapes(model, 0, node, hulls)
    ground.setMobile(False)
    return ground


def _robot(model: mujoco.MjModel, hulls: Mapping[int, Any]) -> Any:
    robot = dartpy.dynamics.Skeleton("robot")
    nodes: dict[int, Any] = {0: None}
    for i in range(1, model.nbody):
        nodes[i] = _add_body(model, robot, i, nodes[int(model.body_parentid[i])])
        nodes[i].setGravityMode(float(model.body_gravcomp[i]) < 1.0)
        _add_shapes(model, i, nodes[i], hulls)
    robot.setSelfCollisionCheck(True)
    robot.setAdjacentBodyCheck(False)
    return robot


def _add_body(model: mujoco.MjModel, robot: Any, i: int, parent: Any) -> Any:
    dynamics, count, first = dartpy.dynamics, int(model.body_jntnum[i]), int(model.body_jntadr[i])
    name = _body(model, i)
    node = dynamics.BodyNodeProperties(dynamics.BodyNodeAspectProperties(name))
    there = transform(model.body_pos[i], model.body_quat[i])
    if count == 0:
        weld = dynamics.WeldJointProperties()
        weld.mName, weld.mT_ParentBodyToJoint = f"{name}/weld", there
        return robot.createWeldJointAndBodyNodePair(parent, weld, node)[1]
    joint, kind = model.joint(first).name or f"joint{first}", int(model.jnt_type[first])
    if count > 1:
        raise ModelError(f"body '{name}' has {count} joints; in DART it can have one: split it into several bodies")
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        free = dynamics.FreeJointProperties()
        free.mName = joint
        return robot.createFreeJointAndBodyNodePair(parent, free, node)[1]
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        raise ModelError(f"joint '{joint}' is a ball; in DART hinges, slides and free bases can be had")
    hinge = kind == mujoco.mjtJoint.mjJNT_HINGE
    properties = dynamics.RevoluteJointProperties() if hinge else dynamics.PrismaticJointProperties()
    anchor = transform(model.jnt_pos[first], np.array([1.0, 0.0, 0.0, 0.0]))
    properties.mName, properties.mAxis = joint, np.array(model.jnt_axis[first])
    properties.mT_ParentBodyToJoint, properties.mT_ChildBodyToJoint = there.multiply(anchor), anchor
    create = robot.createRevoluteJointAndBodyNodePair if hinge else robot.createPrismaticJointAndBodyNodePair
    made, body = create(parent, properties, node)
    if model.jnt_limited[first]:
        zero = model.qpos0[model.jnt_qposadr[first]]
        made.setPositionLowerLimit(0, float(model.jnt_range[first, 0] - zero))
        made.setPositionUpperLimit(0, float(model.jnt_range[first, 1] - zero))
        made.setLimitEnforcement(True)
    return body


def _add_shapes(model: mujoco.MjModel, body: int, node: Any, hulls: Mapping[int, Any]) -> None:
    for geom in range(model.ngeom):
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if int(model.geom_bodyid[geom]) != body or not touches:
            continue
        shape, offset = _shape(model, geom, hulls)
        made = node.createShapeNode(shape)
        made.setName(_geom(model, geom))
        made.setRelativeTransform(_placed(model.geom_pos[geom], model.geom_quat[geom], offset))
        made.createCollisionAspect()
        made.createDynamicsAspect().setFrictionCoeff(float(model.geom_friction[geom, 0]))


def _shape(model: mujoco.MjModel, geom: int, hulls: Mapping[int, Any]) -> tuple[Any, float]:
    """A shape, and how far along its own z axis it has to be moved, in m. Raises ModelError."""
    dynamics, kind, (a, b, c) = dartpy.dynamics, int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_PLANE:
        return dynamics.BoxShape([2 * half for half in PLATE]), -PLATE[2]
    if kind == _GEOM.mjGEOM_BOX:
        return dynamics.BoxShape([2 * a, 2 * b, 2 * c]), 0.0
    if kind == _GEOM.mjGEOM_SPHERE:
        return dynamics.SphereShape(a), 0.0
    if kind == _GEOM.mjGEOM_CAPSULE:
        return dynamics.CapsuleShape(a, 2 * b), 0.0
    if kind == _GEOM.mjGEOM_CYLINDER:
        return dynamics.CylinderShape(a, 2 * b), 0.0
    if kind == _GEOM.mjGEOM_MESH:
        return hulls[int(model.geom_dataid[geom])], 0.0
    if kind == _GEOM.mjGEOM_ELLIPSOID and not hulls:
        return dynamics.EllipsoidShape([2 * a, 2 * b, 2 * c]), 0.0
    raise ModelError(
        f"shape '{_geom(model, geom)}' is a {_GEOM(kind).name}; in DART boxes, spheres, capsules, cylinders, planes and "
        "meshes can be had, and ellipsoids where there are no meshes"
    )
