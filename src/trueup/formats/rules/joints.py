# SPDX-License-Identifier: Apache-2.0
"""Signals of joints and drives, in arms, legs and machines: what a column's name says of kind, command, unit and joint."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trueup.formats.rules.names import AXES, COMMANDED, MEASURED, PLAINLY_MEASURED, SENT, Name, listed, taken_apart
from trueup.formats.rules.rule import Example, Rule
from trueup.units import to_si

RULES = (
    Rule(
        "position",
        "position, positions, pos, q, qpos, angle, angles, theta, ang, jointangle, jointpos, jp, jpos",
        (
            Example("t,q1,q2,q_ref1,q_ref2", "0 .1 .2 .1 .2|.01 .2 .3 .2 .3|.02 .3 .4 .3 .4",
                    "command[rad] joint_1 joint_2; position[rad] joint_1 joint_2"),
            Example("time,shoulder (deg),shoulder cmd (deg)", "0 10 11|.1 20 21|.2 30 31",
                    "command[deg] shoulder; position[deg] shoulder"),
            Example("ms,lift_goal_mm,lift_act_mm", "0 1 1|10 2 1|20 3 2", "command[mm] lift; position[mm] lift"),
            Example("t,th1,th2,th1_d,th2_d,dth1,dth2", "0 .1 .2 .1 .2 1 1|.01 .2 .3 .2 .3 1 1|.02 .3 .4 .3 .4 1 1",
                    "command[rad] joint_1 joint_2; position[rad] joint_1 joint_2; velocity[rad/s] joint_1 joint_2"),
            Example("t,q_th,q_kn,q_cmd_th,q_cmd_kn", "0 .1 .2 .1 .2|.01 .2 .3 .2 .3|.02 .3 .4 .3 .4",
                    "command[rad] th kn; position[rad] th kn"),
            Example("t,AxisPos_A1,AxisPos_A2,SetPos_1,SetPos_2", "0 .1 .2 .1 .2|.01 .2 .3 .2 .3|.02 .3 .4 .3 .4",
                    "command[rad] Axis_A1 Axis_A2; position[rad] Axis_A1 Axis_A2"),
            Example("t,id1_present_position,id1_goal_position", "0 .1 .1|.01 .2 .2|.02 .3 .3",
                    "command[rad] id1; position[rad] id1"),
            Example("t,crank_encoder,lift_height_mm,belt_encoder", "0 .1 60 .2|.01 .2 70 .3|.02 .3 80 .2",
                    "position[rad,mm,rad] crank lift_height belt"),
            Example("t,pos_cmd_j1,pos_fbk_j1", "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] j1; position[rad] j1"),
        ),
        unit="rad", also=("m",),
    ),
    Rule(
        "velocity",
        "velocity, velocities, vel, vels, speed, speeds, qd, dq, qdot, qvel, dth, omega, jointvel, jv, jvel, dot",
        (
            Example("t,q_1,q_dot_1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; velocity[rad/s] joint_1"),
            Example("t,hip_angle,hip_rate", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] hip; velocity[rad/s] hip"),
            Example("t,hip_angle_deg,hip_speed_deg_s", "0 1 2|.1 2 3|.2 3 1", "position[deg] hip; velocity[deg/s] hip"),
        ),
        unit="rad/s", also=("m/s",), rate_of="position",
    ),
    Rule(
        "acceleration",
        "acceleration, accelerations, acc, accel, qdd, ddq, qddot, qacc, ddot",
        (Example("t,q1,qdd1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; acceleration[] joint_1"),),
        unit="rad/s^2", also=("m/s^2",), rate_of="velocity",
    ),
    Rule(
        "torque",
        "torque, torques, tau, taus, effort, efforts, eff, moment, trq, tq, torq, qfrc, jt, jtau, jtrq",
        (
            Example("t,q[0],tau_J[0],tau_J_d[0]", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "command_torque[N m] joint_0; position[rad] joint_0; torque[N m] joint_0"),
            Example("t,FR_0_q,FR_0_tauEst,FR_0_tau_ff", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "command_torque[N m] FR_0; position[rad] FR_0; torque[N m] FR_0"),
            Example("t_ms,motor_force_cmd_N,axis_x_mm,tilt_deg", "0 1 1 1|10 2 2 2|20 3 1 2",
                    "command_torque[N] joint_1; position[mm,deg] axis_x tilt"),
            Example("t,axis_force_cmd,axis_pos_m", "0 1 .1|.01 2 .2|.02 3 .1", "command_torque[N] axis; position[m] axis"),
            Example("t,q1,force_cmd_x,force_cmd_y,gripper_force_cmd", "0 1 1 1 1|.01 2 2 2 2|.02 3 1 2 3",
                    "position[rad] joint_1; force_cmd[N] x y; gripper_force_cmd[] gripper_force_cmd"),
        ),
        unit="N m", also=("N",),
    ),
    Rule(
        "current",
        "current, currents, cur, curr, amps, amperage, iq",
        (
            Example("t,q1,current_1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; current[] joint_1"),
            Example("t,q1_deg,i1_A", "0 .1 1|.01 .2 2|.02 .3 1", "position[deg] joint_1; current[A] joint_1"),
        ),
        unit="A",
    ),
    Rule(
        "load", "load, loads",
        (
            Example("t,present_load", "0 1|.1 2|.2 3", "load[] joint_1"),
            Example("t,q_hip,torque_percent_hip", "0 .1 10|.1 .2 20|.2 .3 30", "position[rad] hip; load[%] hip"),
            Example("t,hip_pos,hip_effort_pct", "0 .1 10|.1 .2 20|.2 .3 30", "position[rad] hip; load[%] hip"),
            Example("t,q_1,q_2,Torque_1 [%],Torque_2 [%]", "0 .1 .1 10 9|.1 .2 .1 20 9|.2 .3 .1 30 9",
                    "position[rad] joint_1 joint_2; load[%] joint_1 joint_2"),
        ),
        also=("",),
    ),
    Rule("voltage", "voltage, voltages, volt, volts",
         (Example("t,motor_voltage_V", "0 12|.1 11|.2 12", "voltage[V] voltage"),), unit="V"),
    Rule("temperature", "temperature, temperatures, temp, temps",
         (Example("t,hip_temp_degC", "0 20|.1 21|.2 22", "temperature[degC] hip"),), unit="K"),
    Rule(
        "kp", "kp, p gain, kp gain, position p gain, p coefficient",
        (
            Example("t,q_FL_hip_joint,kp_FL_hip_joint", "0 .1 20|.1 .2 20|.2 .3 20",
                    "position[rad] FL_hip_joint; kp[] FL_hip_joint"),
            Example("t,motor_state_0_q,motor_state_1_q,motor_cmd_0_kp,motor_cmd_1_kp",
                    "0 .1 .1 20 60|.1 .2 .1 20 60|.2 .3 .1 20 60", "position[rad] joint_0 joint_1; kp[] joint_0 joint_1"),
            Example("t,id1_present_position,id1_position_p_gain,id1_velocity_p_gain", "0 .1 800 90|.1 .2 800 90|.2 .3 800 90",
                    "position[rad] id1; kp[] id1; id_velocity_p_gain[] 1"),
            Example("t,hip_angle,kp", "0 .1 20|.1 .2 20|.2 .3 20", "position[rad] hip; kp[] kp"),
        ),
        also=("N m/rad",),
    ),
    Rule("kd", "kd, kv, d gain, kd gain, position d gain, d coefficient",
         (Example("t,q_1,q_2,Kd_1 [Nms/rad],Kd_2 [Nms/rad]", "0 .1 .1 1 2|.1 .2 .1 1 2|.2 .3 .1 1 2",
                  "position[rad] joint_1 joint_2; kd[N m s/rad] joint_1 joint_2"),), also=("N m s/rad",)),
)  # fmt: skip
KINDS: Mapping[str, str] = MappingProxyType({word: rule.kind for rule in RULES for word in rule.names.split(", ")})
BY_KIND: Mapping[str, Rule] = MappingProxyType({rule.kind: rule for rule in RULES})

SETTINGS = ("kp", "kd")
"""Kinds that are settings of a drive: no signals, whoever commands them."""
_GAINS = sorted(
    ((frozenset(name.split()), kind) for kind in SETTINGS for name in BY_KIND[kind].names.split(", ")),
    key=lambda gain: -len(gain[0]),
)
"""The words of a gain, and its kind, the longest first."""
SHARES = MappingProxyType(
    {**dict.fromkeys(("percent", "pct", "perc"), "%"), "permille": "permille", "promille": "permille"}
)
"""Words of a share of what a drive is rated for, as a unit."""
_RATES = MappingProxyType({"dot": "velocity", "ddot": "acceleration"})
"""Words that make a rate of change of what stands before them: q_dot, theta_ddot."""
ENCODERS = listed("encoder encoders enc counts ticks")
"""Words of a position where no other word tells a kind."""
_SHORT = frozenset(["th"])
"""Words of a position that may also be part of a joint's name: theta, or thigh."""
_OF_A_LOG = frozenset(["sample", "sampling", "frame", "update", "data", "loop", "log"])
"""Whose rate is no speed."""
_ITSELF = frozenset(["throttle", "steering"])  # words that are a command and its name at once
_NEUTRAL = listed("controller controllers trajectory lowstate lowcmd")
_FORCES = listed("force forces")
"""Words of what slides push with, where they are commanded: what was measured is more often a tool's."""
_NOT_PUSHED = listed("grip gripper grasp finger fingers limit limits max min")
"""Whose commanded force is a setting, and drives no joint."""
_PARTS = listed("joint joints motor motors")
_NOT_JOINT = listed(
    "tcp ee pose imu mode status enable enabled flag index frame episode id seq count counter error err errors done "
    "success force wrench quat orientation gain kp kd ki vicon mocap gps odom cov covariance"
)


@dataclass(frozen=True)
class Reading:
    """What a column's name says of a joint."""

    kind: str
    """position, velocity, ...; '' if no word tells."""
    command: bool
    sent: bool
    measured: bool
    """Whether a word says so that is no part of a joint's name."""
    unit: str
    label: str
    """What is left of the name without the words for kind and unit."""
    joint: bool
    """False where a word says that this is no joint's signal (a pose, a mode, a counter)."""


@functools.lru_cache(1 << 15)
def read(name: Name) -> Reading:
    """What a column's name says of a joint."""
    plain = name.words
    kinds = [_kind(word) for word in plain]
    commands = [_is_command(i, plain) for i in range(len(plain))]
    told = any(commands) or bool(PLAINLY_MEASURED & set(plain))
    kind, kinds, gain = _gain(plain, kinds)
    kind = kind or next((_RATES[w] for w in plain if w in _RATES), next((k for k in kinds if k), ""))
    pushes = not kind and any(commands) and bool(_FORCES & set(plain)) and not _NOT_PUSHED & set(plain)
    if pushes:
        kind, kinds = "torque", ["torque" if word in _FORCES else k for word, k in zip(plain, kinds, strict=True)]
    unit, where = _unit(name, kind)
    if pushes and not (name.bracketed or name.tail):
        unit = "N"
    if not kind and (told or not (AXES | {"heading"}) & set(plain[:1])):
        kind, unit, where = _kind_by_unit(name, told=told)
    if not kind:
        amperes = (name.bracketed or name.tail) in ("A", "mA")
        kind, kinds = _by_letter(plain, kinds, current=told or amperes, position=told and not any(commands))
        unit, where = _unit(name, kind)
    keep = _kept_words(name, kinds, commands, where)
    return Reading(
        kind=kind,
        command=any(commands),
        sent=any(word in SENT for word in plain),
        measured=bool((MEASURED - _PARTS) & set(plain)),
        unit=unit,
        label=name.cut_out(keep),
        # A drive with a number, id1_position, is one.
        joint=not (_NOT_JOINT - gain - ({"id"} if kind else set()) - (_FORCES if pushes else set())) & set(plain),
    )


def label_of(rest: str) -> str:
    """A label from what is left of a column's name: a bare number or nothing becomes "joint_n"."""
    return f"joint_{rest or 1}" if not rest or rest.isdigit() else rest


def joint_labels(names: Sequence[str]) -> tuple[str, ...]:
    """Labels for columns: what distinguishes their names, "joint_3" where that is a number; unique."""
    labels = [label_of(read(taken_apart(name)).label) for name in names]
    return tuple(labels) if len(set(labels)) == len(labels) else tuple(names)


def _kind(word: str) -> str:
    """The kind of signal a word names; "qdes" and "cmdpos" are taken apart."""
    if word in KINDS:
        return KINDS[word]
    for i in range(1, len(word)):
        for kind, other in ((word[:i], word[i:]), (word[i:], word[:i])):
            if kind in KINDS and len(other) > 2 and other in COMMANDED:
                return KINDS[kind]
    return ""


def _gain(plain: Sequence[str], kinds: Sequence[str]) -> tuple[str, list[str], frozenset[str]]:
    """The setting of a drive that words name, the kinds of all words then, and which of them say so; of a position alone.

    What a speed or a current is controlled with tells nothing of a servo's stiffness.
    """
    for said, kind in _GAINS:
        others = {k for word, k in zip(plain, kinds, strict=True) if word not in said}
        if said <= set(plain) and others <= {"", "position"}:
            return kind, [kind if word in said else k for word, k in zip(plain, kinds, strict=True)], said
    return "", list(kinds), frozenset()


def _is_command(i: int, plain: Sequence[str]) -> bool:
    word = plain[i]
    if word in COMMANDED or word in _ITSELF:
        return True
    if word == "d":  # q_d, tau_J_d: desired
        return any(previous in KINDS or previous in _SHORT for previous in plain[:i])
    return word not in KINDS and bool(_kind(word))


def _unit(name: Name, kind: str) -> tuple[str, range]:
    """The unit that a name says, and the words that say it, where it is one of the kind."""
    if name.bracketed:
        return name.bracketed, range(0)
    if kind in ("torque", "current", "load"):
        for i, word in enumerate(name.words):
            if word in SHARES:
                return SHARES[word], range(i, i + 1)
    if name.tail and kind and BY_KIND[kind].fits(to_si(name.tail)[0]):
        return name.tail, name.tail_words
    return "", range(0)


def _kind_by_unit(name: Name, *, told: bool) -> tuple[str, str, range]:
    """The kind that a unit speaks of where no word does: "goal_elbow_deg", "tool (N m)"; with the unit and its words.

    Single letters say so only where the name is `told` to be a command or a measurement.
    """
    unit = name.bracketed or name.tail
    short = len(name.bracketed or "".join(name.words[i] for i in name.tail_words)) < 2
    kind = next((rule.kind for rule in RULES if unit and rule.unit and rule.fits(to_si(unit)[0])), "")
    if kind and (told or not short):
        return kind, unit, range(0) if name.bracketed else name.tail_words
    return "", name.bracketed, range(0)


def _by_letter(plain: Sequence[str], kinds: Sequence[str], *, current: bool, position: bool) -> tuple[str, list[str]]:
    """Kinds of last resort: i for a current, a rate, an encoder for a position, or what is plainly measured."""
    if current and "i" in plain and len(plain) > 1:
        return "current", ["current" if word == "i" else kind for word, kind in zip(plain, kinds, strict=True)]
    if "rate" in plain and len(plain) > 1 and not _OF_A_LOG & set(plain):
        return "velocity", ["velocity" if word == "rate" else kind for word, kind in zip(plain, kinds, strict=True)]
    if (ENCODERS | _SHORT) & set(plain):
        return "position", [
            "position" if w in ENCODERS | _SHORT else kind for w, kind in zip(plain, kinds, strict=True)
        ]
    return ("position" if position else ""), list(kinds)


def _kept_words(name: Name, kinds: Sequence[str], commands: Sequence[bool], unit: range) -> list[bool]:
    """Which words belong to the joint's name."""
    plain = name.words
    franka = [word == "j" and i > 0 and plain[i - 1] == "tau" for i, word in enumerate(plain)]  # tau_J
    keep = [
        word in _ITSELF or not (kinds[i] or commands[i] or franka[i] or word in SENT or i in unit)
        for i, word in enumerate(plain)
    ]
    dropped = MEASURED | _NEUTRAL
    named = any(kept and word not in dropped for kept, word in zip(keep, plain, strict=True))
    # "joint" and "motor" are part of a name such as FL_hip_joint or Joint_1, "actual" in actual_q_0 is not.
    for i, word in enumerate(plain):
        if word in dropped:
            following = plain[i + 1] if i + 1 < len(plain) else ""
            topic = following in ("state", "states") or (following == "cmd" and "lowcmd" in plain)
            keep[i] = keep[i] and word in _PARTS and named and not topic
    return keep
