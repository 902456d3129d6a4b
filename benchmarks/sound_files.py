# SPDX-License-Identifier: Apache-2.0
"""Sound files of every kind that trueup reads, small, for benchmarks/robustness.py to damage."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from trueup import formats
from trueup.cli import main
from trueup.recording import Channel, Recording

JOINTS = ("hinge", "wrist")
ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option integrator="implicitfast"/>
  <default><joint armature="0.01" damping="0.05"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" pos="0 0 -1"/>
    <body name="link" pos="0 0 0.1">
      <joint name="hinge" axis="0 1 0" frictionloss="0.02" range="-2 2"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.2"/>
      <body name="end" pos="0.2 0 0">
        <joint name="wrist" axis="0 1 0" frictionloss="0.01"/>
        <inertial pos="0.05 0 0" mass="0.05" diaginertia="0.0001 0.0001 0.0001"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hinge" joint="hinge" kp="6" kv="0.1" forcerange="-5 5"/>
    <position name="wrist" joint="wrist" kp="4" kv="0.05"/>
  </actuator>
  <keyframe><key name="home" qpos="0.1 0.2"/></keyframe>
</mujoco>
"""
URDF = """<robot name="arm">
  <link name="base"/>
  <link name="link"><inertial><origin xyz="0.1 0 0"/><mass value="0.2"/>
    <inertia ixx="1e-4" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="end"><inertial><origin xyz="0.05 0 0"/><mass value="0.05"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="5"/><dynamics damping="0.05" friction="0.02"/></joint>
  <joint name="wrist" type="continuous"><parent link="link"/><child link="end"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
    <limit effort="5" velocity="5"/></joint>
</robot>
"""
CAR = """[vehicle]
name = "small"
wheelbase = 0.17
drive = "throttle"
enabled_by = "safety"
middle = [0.01, 0.02]
full = [0.9, 0.8]

[vehicle.values]
steering_delay = 0.2
steering_left = 0.6
steering_right = 0.6
throttle_lag = 0.3
drive = 20.0
"""
PARAMETERS = """[[parameter]]
quantity = "kp"
of = "*"
nominal = 6.0
lower = 1.0
upper = 40.0
scale = "log"

[[parameter]]
quantity = "damping"
of = ["hinge", "wrist"]
tie = "all"

[[parameter]]
quantity = "delay"
of = "hinge"
nominal = 0.01
frozen = true
"""
DRIVES = """positions = "joint"
torques = "motor"

[joints.hinge]
ratio = 32.0
offset = 0.1
torque_constant = 0.05

[[couplings]]
drive = "wrist"
joint = "hinge"
ratio = 1.0
"""
MAPPING = """[time]
column = "time"
unit = "s"
repair = "drop"

[channels.command]
columns = ["cmd_hinge", "cmd_wrist"]
labels = ["hinge", "wrist"]
unit = "rad"

[channels.position]
columns = ["pos_*"]
labels = ["a", "b"]
unit = "rad"
scale = [1.0, 1.0]
sign = 1
offset = 0.0

[channels.torque]
columns = ["tau_hinge", "tau_wrist"]
labels = ["hinge", "wrist"]
unit = "N m"

[joints]
a = "hinge"
b = "wrist"
"""
PLAN = """name = "small"
seed = 3

[robot]
type = "cart_pole:Robot"

[simulator]
type = "cart_pole:simulator"
parameters = "parameters.toml"

[task]
type = "cart_pole:SwingUp"
price = 0.1

[experiment]
settings = 1

[calibrate]
search = "auto"
robust = 3.0

[optimize]
search = {type = "cma-es"}
evaluations = 8
samples = 2

[transfer]
candidates = 1
confirm = false

[stop]
rounds = 1

[limits.joints.cart]
range = [-20.0, 20.0]
"""


def signals(samples: int = 300) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(T,) s, and (T, 6) commands, positions and torques of the two joints, simulated."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    rows, time = [], np.arange(samples, dtype=np.float64) / 100.0
    for t in time:
        data.ctrl[:] = 0.5 * np.sin(4 * t), 0.4 * np.sin(7 * t)
        rows.append([*data.ctrl, *(data.qpos + 1e-3 * rng.standard_normal(2)), *data.qfrc_actuator])
        mujoco.mj_step(model, data, nstep=5)
    return time, np.array(rows)


def names() -> list[str]:
    """Of the columns of `signals`."""
    return [f"{kind}_{joint}" for kind in ("cmd", "pos", "tau") for joint in JOINTS]


def write_logs(folder: Path) -> None:
    """The same recording in every format."""
    time, values = signals()
    whole = np.column_stack([time, values])
    for name, separator in (("log.csv", ","), ("semicolons.csv", ";"), ("blanks.txt", " ")):
        rows = [separator.join(f"{x:.6f}" for x in row) for row in whole]
        (folder / name).write_text("\n".join([separator.join(["time", *names()]), *rows]) + "\n")
    lists = [f'{t:.4f},"{v[:2].tolist()}","{v[2:4].tolist()}"' for t, v in zip(time, values, strict=True)]
    (folder / "lists.csv").write_text("\n".join(["timestamp,command,position", *lists]) + "\n")
    entries = [dict(zip(["time", *names()], row, strict=True)) for row in whole.tolist()]
    (folder / "log.json").write_text(json.dumps({"mass": 0.4, "entries": entries}))
    (folder / "log.jsonl").write_text("\n".join(json.dumps(e) for e in entries) + "\n")
    np.savez(folder / "log.npz", time=time, q=values[:, 2:4], q_des=values[:, :2].T, joint_names=np.array(JOINTS))
    np.save(folder / "log.npy", whole)
    columns = {"timestamp": time, "action": values[:, :2].tolist(), "observation.state": values[:, 2:4].tolist()}
    pq.write_table(pa.table(columns), folder / "foreign.parquet")
    units = {"command": "rad", "position": "rad", "torque": "N m"}
    parts = {n: Channel(n, JOINTS, u, time, values[:, 2 * k : 2 * k + 2]) for k, (n, u) in enumerate(units.items())}
    formats.write(Recording("own", parts, {}), folder / "own.parquet")
    drive = np.column_stack(
        [time, 0.2 + 0.1 * np.sin(time), 0.3 * np.sin(time), time, 0.1 * time**2, 0.2 * time, 0 * time + 1]
    )
    rows = [",".join(f"{x:.6f}" for x in row) for row in drive]
    (folder / "drive.csv").write_text("\n".join(["time,throttle,steering,x,y,yaw,safety", *rows]) + "\n")


def write_bags(folder: Path) -> None:
    """Joint states and commands as SQLite and MCAP bags."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    make, empty = store.types, np.zeros(0)
    time, values = signals(60)
    for name, plugin in (("bag_sqlite", StoragePlugin.SQLITE3), ("bag_mcap", StoragePlugin.MCAP)):
        with Writer(folder / name, version=9, storage_plugin=plugin) as writer:
            states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
            told = writer.add_connection("/commands", "std_msgs/msg/Float64MultiArray", typestore=store)
            for t, v in zip(1.7e9 + time, values, strict=True):
                nanoseconds = round(t * 1e9)
                stamp = make["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
                header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="")
                measured = {"position": v[2:4].copy(), "velocity": empty, "effort": v[4:].copy()}
                state = make["sensor_msgs/msg/JointState"](header=header, name=list(JOINTS), **measured)
                layout = make["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
                array = make["std_msgs/msg/Float64MultiArray"](layout=layout, data=v[:2].copy())
                writer.write(states, nanoseconds, store.serialize_cdr(state, states.msgtype))
                writer.write(told, nanoseconds, store.serialize_cdr(array, told.msgtype))


def write_sound(folder: Path) -> None:
    """Logs, mapping, parameters, models, plan, and a campaign that was run to its end, in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_logs(folder)
    with contextlib.suppress(ImportError):
        write_bags(folder)
    texts = {"arm.xml": ARM, "arm.urdf": URDF, "car.toml": CAR, "kp.toml": PARAMETERS, "drives.toml": DRIVES,
             "map.toml": MAPPING, "plan.toml": PLAN}  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    for file in (Path(__file__).resolve().parents[1] / "examples" / "cart_pole").glob("[cp]*_pole.py"):
        shutil.copy(file, folder)
    shutil.copy(Path(__file__).resolve().parents[1] / "examples" / "cart_pole" / "parameters.toml", folder)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if main(["run", str(folder / "plan.toml"), "--out", str(folder / "campaign"), "--yes", "-q"]):
            raise RuntimeError("the sound campaign failed")
