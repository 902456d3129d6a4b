# SPDX-License-Identifier: Apache-2.0
"""Arms, hands and legs as a family: MJCF and URDF files, simulated by MuJoCo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trueup.articulated.declaration_file import read_declarations, read_gains, write_parameters
from trueup.articulated.declarations import declare
from trueup.articulated.gains import Gains
from trueup.calibration import Calibration
from trueup.engines.family import Family, Request, Suited
from trueup.engines.mujoco.base import check_base, floating, held
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.drives import driven, suited, undriven
from trueup.engines.mujoco.setup.floor import Stopped, stopped_by_floor
from trueup.engines.mujoco.setup.overlaps import passable
from trueup.engines.mujoco.setup.proposal import LOAD, propose
from trueup.engines.mujoco.setup.scales import of_slides, with_units
from trueup.engines.mujoco.setup.still import with_still_joints
from trueup.engines.mujoco.writing.write import write_model
from trueup.errors import unknown_name
from trueup.formats.joint_names import named_as
from trueup.formats.strangers import several_robots, without_strangers
from trueup.recording import Recording

STEP = 0.002
"""s: the step of MuJoCo models unless told otherwise."""
_UNEXPLAINED = 5.0  # noise units


class Articulated(Family):
    """Robots of joints and links; a model is an MJCF or URDF file."""

    describes = "another MJCF or URDF file"
    later = (LOAD,)

    def load(self, path: Path) -> Model:
        """The model in a file. Raises ModelError."""
        return load(path)

    def drives(self, model: Model) -> Mapping[str, str]:
        """See Family."""
        return model.drives()

    def in_units(self, model: Model, recordings: Sequence[Recording]) -> Sequence[Recording]:
        """See Family: metres where a joint slides."""
        named, _ = named_as(recordings, model.drives())
        return of_slides(model, with_units(model, named)[0])[0]

    def suited(self, model: Model, training: Sequence[Recording], held_out: Sequence[Recording] = ()) -> Suited:
        """See Family: joints by the model's names, commands that its drives take."""
        drives = model.drives()
        others = [name for name in model.names("actuator") if name and name not in drives.values()]
        named, renamed = named_as([*training, *held_out], drives, others)
        named, strange = without_strangers(named, drives, others)
        taken, changed = suited(model, named)
        fitted, judged = taken[: len(training)], taken[len(training) :]
        return Suited(tuple(fitted), tuple(judged), (*renamed, *strange, *changed))

    def simulator(
        self, model: Model, training: Sequence[Recording], replayed: Sequence[Recording], request: Request
    ) -> tuple[MujocoSimulator, tuple[str, ...]]:
        """See Family. A model without actuators gets servos or motors for the joints that the recordings command."""
        everything = (*training, *replayed)
        _check_joints(model, everything)
        for change in (floating, held, driven, passable, with_still_joints):
            model = change(model, everything)
        notes = (*model.notes, *undriven(model, everything), *check_base(model, everything))
        floor = None
        if request.parameters is not None:
            lines = read_declarations(request.parameters)
        elif request.propose:
            floor = stopped_by_floor(model, training)
            height = floor.height if floor else None
            lines = propose(model, training, request.clocks, height, request.beyond_mjcf)
        else:
            lines = []
        names = {
            "recording": tuple(r.name for r in everything),
            "channel": tuple(dict.fromkeys(c for r in everything for c in r.channels)),
        }
        space, quantities = declare(model, lines, names)
        gains, named = Gains.named_by(everything, {**model.settings(), **read_gains(request.parameters)})
        simulator = MujocoSimulator(model, space, quantities, gains=gains, step=request.step or STEP)
        return simulator, (*notes, *([_of_floor(floor)] if floor else []), *named)

    def write(
        self, simulator: MujocoSimulator, calibration: Calibration, model: Path, parameters: Path
    ) -> tuple[str, ...]:
        """Writes the calibrated MJCF and the parameters file; notes on what the MJCF cannot say."""
        write_parameters(calibration, simulator.parameters, simulator.quantities, parameters, simulator.gains.given_for)
        return write_model(simulator, calibration.values, model)

    def kinds(self, simulator: MujocoSimulator) -> tuple[tuple[str, str, int], ...]:
        """See Family."""
        free = [a for a, p in zip(simulator.quantities, simulator.parameters.parameters, strict=True) if not p.frozen]
        counts = Counter((a.kind, a.quantity.family) for a in free)
        return tuple((name, family, count) for (name, family), count in counts.items())

    def advice(self, simulator: MujocoSimulator, calibration: Calibration | None = None) -> tuple[str, ...]:
        """See Family: smaller steps before a calibration, friction with load after it."""
        return _about_step(simulator) if calibration is None else _about_load(simulator, calibration)


def _about_step(simulator: MujocoSimulator) -> tuple[str, ...]:
    """A note where the model takes smaller steps than it is simulated at."""
    own = float(simulator.model.compiled.opt.timestep)
    if own > 0.99 * simulator.step:
        return ()
    return (
        f"the model steps by {1e3 * own:g} ms, here it is simulated at {1e3 * simulator.step:g} ms; with --step {own:g} the "
        f"values are those of its own step, for about {simulator.step / own:.1f} times the time",
    )


def _about_load(simulator: MujocoSimulator, calibration: Calibration) -> tuple[str, ...]:
    """A note where servos stay far above the noise, and friction that grows with their load has not been tried."""
    kinds = {q.kind for q in simulator.quantities}
    seen = [r for r in calibration.training() if r.channel == "position"]
    if "kp" not in kinds or "friction_load" in kinds or not seen or not all(r.noise.all() for r in seen):
        return ()
    times = float(np.sqrt(np.nanmean([np.nanmean(((r.after - r.measured) / r.noise) ** 2) for r in seen])))
    if not times > _UNEXPLAINED:
        return ()
    return (
        f"the replay error stays at {times:.0f} times the noise. Small geared servos may have friction that grows with their "
        "load: --beyond-mjcf tries that too (in twice the time), and `trueup replay --parameters` replays it",
    )


def _of_floor(floor: Stopped) -> str:
    return (
        f"the robot was stopped above where its commands would take it, about {100 * floor.height:.1f} cm high "
        f"({', '.join(floor.recordings)}), and the model has no floor: one is added and its height calibrated (quantities "
        "floor_height, floor_roll, floor_pitch, floor_friction)"
    )


def _check_joints(model: Model, recordings: Sequence[Recording]) -> None:
    """Raises UnknownNameError for a joint that the model does not have, and says how to rename it."""
    joints, file = model.scalar_joints(), model.path.name
    for recording in recordings:
        if recording.has("position"):
            labels = recording.channel("position").labels
            left = [j for j in joints if j not in labels]
            for label in labels:
                if label not in joints:
                    raise unknown_name(
                        "joint", label, left or joints,
                        f"model '{file}' (recording '{recording.name}', channel 'position'; rename it in the mapping's "
                        f"[joints]: `trueup inspect RECORDINGS --model {file}` proposes{several_robots(labels, joints)})",
                    )  # fmt: skip
