# SPDX-License-Identifier: Apache-2.0
"""A servo as recordings show it, and as files: a law in Python that needs nothing, the nearest MJCF, and all figures."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from trueup.actuators import servo
from trueup.actuators.bench import Bench, Run
from trueup.actuators.choose import Asked
from trueup.actuators.experiment import Experiment, Value
from trueup.actuators.servo import Law
from trueup.arrays import Array
from trueup.articulated.kernels import ONSET
from trueup.errors import OutputError
from trueup.formats.aside import write_aside
from trueup.formats.plain import finite
from trueup.rounding import ROUNDED

PYTHON, MJCF, FIGURES = "actuator.py", "actuator.xml", "actuator.json"
HARD = 'solreffriction="0.0001 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'
"""Dry friction that holds, within MuJoCo's limits: it takes all speed in one step."""

_HEAD = '''"""A servo, identified by trueup: replayed recordings are met to {error:.3g} rad in the mean ({which}).

In plain MuJoCo, with one <motor> at the joint and, in the MJCF,
<joint armature="{armature:.6g}" {hard}/>:

    servo = Servo()                        # Servo(gain=0.5) for half the proportional setting{setting}
    servo.reset(data.qpos[q])              # q, v: where the joint stands in qpos and qvel; a: the motor
    mujoco.mj_forward(model, data)
    while data.time < 5.0:
        servo.step(command, data.qpos[q], data.qvel[v], model.opt.timestep, -data.qfrc_bias[v])
        data.ctrl[a] = servo.torque
        model.dof_damping[v], model.dof_frictionloss[v] = servo.damping, servo.friction
        mujoco.mj_step(model, data)
"""

'''


@dataclass(frozen=True)
class Judged:
    """How one recording is replayed: mean absolute errors in rad over the whole of it."""

    name: str
    held_out: bool
    """Whether it was kept from every fit; else errors are those of fits that never saw this recording, or stretch."""
    model: float
    file: float
    """With the nearest law that a file in MJCF can hold."""


@dataclass(frozen=True, eq=False)
class Actuator:
    """A servo as recordings show it."""

    law: Law | None
    """None where nothing is known of the load: then only `experiment` says something."""
    file_law: Law | None
    """The nearest that MJCF can hold."""
    values: tuple[Value, ...]
    """With intervals that count what the model misses."""
    structures: tuple[str, ...]
    asked: tuple[Asked, ...]
    experiment: Experiment
    judged: tuple[Judged, ...]
    runs: tuple[Run, ...]
    """Those fitted, then those held out."""
    bench: Bench
    setting: float
    """The proportional setting of the servo that the law stands for; 0 where recordings name none."""
    step: float
    notes: tuple[str, ...]
    seconds: float

    def error(self, *, held_out: bool, file: bool = False) -> float:
        """Mean over recordings in rad; NaN where there are none."""
        found = [(j.file if file else j.model) for j in self.judged if j.held_out == held_out]
        return float(np.mean(found)) if found else float("nan")

    def write(self, folder: Path | str) -> list[Path]:
        """Writes actuator.py, actuator.xml and actuator.json and returns their paths; without a law only the figures.

        Raises OutputError.
        """
        texts = {FIGURES: json.dumps(figures(self), indent=2, allow_nan=False) + "\n"}
        if self.law is not None and self.file_law is not None:
            texts |= {PYTHON: python_text(self), MJCF: mjcf_text(self.file_law, self.bench, self.step)}
        for name, text in texts.items():
            write_aside(text, Path(folder) / name)
        return [Path(folder) / name for name in texts]


def python_text(actuator: Actuator) -> str:
    """The law's own source with this servo's numbers: Servo() is this servo."""
    if actuator.law is None:
        raise OutputError("no law was found that could be written: the load is unknown")
    held = actuator.error(held_out=True)
    source = Path(servo.__file__).read_text("utf-8")
    body = source[source.index("from __future__") :]
    numbers = ", ".join(
        f"{n}={_number(v)}" for n, v in actuator.law._asdict().items() if v != Law._field_defaults.get(n)
    )
    body = body.replace("def __init__(self, law: Law, gain", "def __init__(self, law: Law = LAW, gain")
    body = body.replace("\n\nREMEMBERED = ", f"\n\nLAW = Law({numbers})\n\nREMEMBERED = ", 1)
    head = _HEAD.format(
        hard=HARD, armature=actuator.law.armature,
        error=held if math.isfinite(held) else actuator.error(held_out=False),
        which="held-out recordings" if math.isfinite(held) else "left out of the fit in turn",
        setting=f" of {actuator.setting:g}" if actuator.setting else "",
    )  # fmt: skip
    return f"# SPDX-License-Identifier: Apache-2.0\n{head}{body}"


def mjcf_text(law: Law, bench: Bench, step: float) -> str:
    """The bench with the nearest servo that MJCF can hold: stiffness, back-EMF and viscous friction as damping, quadratic and
    Coulomb friction, rotor, zero error, delay, and full duty or a limit of force as a range of force (which ends before
    back-EMF, as a motor's voltage does).
    """
    bench = bench.as_one
    pendulum = bench.moment > 0.0 or not math.isnan(bench.mass)
    mass, length = (bench.mass, bench.length) if pendulum else (1.0, 0.0)
    inertia = max(bench.inertia, ROUNDED)
    damping = f"{law.back_emf + law.viscous:.6g}" + (f" {law.quadratic:.6g}" if law.quadratic > 0.0 else "")
    return f"""<mujoco model="servo on its bench">
  <!-- the setting of the servo's gain scales gainprm and biasprm (kp) in proportion -->
  <option timestep="{step:g}" integrator="implicitfast" gravity="0 0 {-bench.gravity:g}"/>
  <worldbody><body name="load">
    <joint name="joint" axis="0 1 0" ref="{math.degrees(bench.hangs_at):.9g}" armature="{law.armature:.6g}"
           damping="{damping}" frictionloss="{law.coulomb:.6g}" {HARD}/>
    <inertial pos="0 0 {-length:.9g}" mass="{mass:.9g}" diaginertia="{inertia:.6g} {inertia:.6g} {inertia:.6g}"/>
  </body></worldbody>
  <actuator>
    {_drives(law, step)}
  </actuator>
</mujoco>
"""


def _drives(law: Law, step: float) -> str:
    """The actuators of a law, as MJCF."""
    limit = min(law.voltage_limit, law.force_limit) - law.punch
    shared, hint = "", ""
    if law.delay > 0.5 * step:  # MuJoCo delays by a step at least; it goes in a line between steps, as commands held do
        late = max(law.delay, step)
        shared = f' nsample="{math.ceil(late / step) + 2}" interp="linear" delay="{late:.6g}"'
        hint = "<!-- what is delayed begins with commands of zero: call mj_initCtrlHistory after a reset -->\n    "
    drives = f"{hint}{_spring('servo', law.stiffness, law.zero, limit)}{shared}/>"
    if law.punch > 0.0:  # a spring so stiff that it is at its limit from the first encoder steps on
        drives += f"""
    <!-- takes the same command: the least torque once there is an error -->
    {_spring("onset", law.punch / ONSET, law.zero, law.punch)}{shared}/>"""
    return drives


def _spring(name: str, stiffness: float, zero: float, limit: float) -> str:
    """A servo's element in MJCF, still open: a <position>, or a <general> where its sensor reads `zero` rad too little."""
    ranged = f' forcerange="{-limit:.6g} {limit:.6g}"' if math.isfinite(limit) else ""
    if zero == 0.0:
        return f'<position name="{name}" joint="joint" kp="{stiffness:.6g}"{ranged}'
    bias = f'biastype="affine" biasprm="{-stiffness * zero:.6g} {-stiffness:.6g} 0"'
    return f'<general name="{name}" joint="joint" gainprm="{stiffness:.6g}" {bias}{ranged}'


def replay_file(path: Path, run: Run) -> Array:
    """(T,) rad at the run's samples: a written MJCF, stepped by MuJoCo itself with the run's commands held.

    It stands for the load that is in the file. Raises OutputError where it cannot be read back.
    """
    try:
        return replay_text(path.read_text("utf-8"), run)
    except ValueError as error:
        raise OutputError(f"{path} cannot be read back: {error}") from None


def replay_text(text: str, run: Run) -> Array:
    """As `replay_file`, of a text as `mjcf_text` gives it. Raises ValueError where MuJoCo cannot read it."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    model.actuator_gainprm[0, 0] *= run.gain
    model.actuator_biasprm[0, :2] *= run.gain
    (data.qpos[0], data.qvel[0]) = run.states(np.zeros(1))[0]
    for a, (samples, _) in enumerate(model.actuator_history):  # before the first command it is that one
        if samples > 0:
            mujoco.mj_initCtrlHistory(model, data, a, None, np.full((samples, 1), run.command[0]))
    step = model.opt.timestep
    instants = step * np.arange(int(np.ceil(run.time[-1] / step)) + 1)
    out = np.empty(len(instants))
    for k, s in enumerate(run.given(instants)):
        out[k] = data.qpos[0]
        data.ctrl[:] = run.command[s]
        model.opt.disableactuator = 0 if run.on[s] else 1
        mujoco.mj_step(model, data)
    return np.interp(run.time, instants, out)


def figures(actuator: Actuator) -> dict[str, Any]:
    """All that was found, as plain numbers in SI units; None for what is infinite or unknown."""

    def plain(thing: Any) -> dict[str, Any]:
        return finite(dataclasses.asdict(thing))

    seen = actuator.experiment
    return {
        "law": None if actuator.law is None else finite(actuator.law._asdict()),
        "mjcf": None if actuator.file_law is None else finite(actuator.file_law._asdict()),
        "values": [plain(v) for v in actuator.values],
        "structures": list(actuator.structures),
        "asked": [
            {"structure": a.name, "kept": a.name in actuator.structures, "without_rad": finite(a.without),
             "with_rad": finite(a.with_it), **plain(a.evidence)}
            for a in actuator.asked
        ],
        "experiment": {"ratios": [plain(v) for v in seen.ratios], "gains": [plain(v) for v in seen.gains],
                       "explained": seen.explained, "cannot": list(seen.cannot)},
        "errors_rad": [plain(j) for j in actuator.judged],
        "bench": plain(actuator.bench), "setting": actuator.setting, "step_s": actuator.step, "notes": list(actuator.notes),
    }  # fmt: skip


def _number(value: float) -> str:
    return "math.inf" if math.isinf(value) else f"{value:.9g}"
