# SPDX-License-Identifier: Apache-2.0
"""Makes a robot's simulator agree with the robot, from a handful of recordings.

The public names live in the modules that `_HOME` names and are imported when first used (PEP 562): `import trueup`
itself loads nothing heavy, so the command line answers at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for type checkers and editors; the same names as in _HOME
    from trueup.actuators.bench import Bench as Bench
    from trueup.actuators.identify import identify_actuator as identify_actuator
    from trueup.actuators.simulated import servo_quantity as servo_quantity
    from trueup.articulated.declarations import Declaration as Declaration
    from trueup.articulated.declarations import declare as declare
    from trueup.articulated.quantities.quantity import Quantity as Quantity
    from trueup.articulated.simulator import ArticulatedSimulator as ArticulatedSimulator
    from trueup.calibration import Calibration as Calibration
    from trueup.campaign.motions import transition as transition
    from trueup.campaign.walks import walk as walk
    from trueup.engines.mujoco.filming import filmed as filmed
    from trueup.engines.mujoco.rollout import MujocoSimulator as MujocoSimulator
    from trueup.engines.mujoco.setup.proposal import propose as propose
    from trueup.engines.mujoco.writing.write import write_model as write_model
    from trueup.engines.vehicle import BicycleSimulator as BicycleSimulator
    from trueup.engines.vehicle import Vehicle as Vehicle
    from trueup.errors import TrueupError as TrueupError
    from trueup.formats import ChannelMap as ChannelMap
    from trueup.formats import read as read
    from trueup.formats import write as write
    from trueup.identification.estimation.identify import identify as identify
    from trueup.identification.model_file import load_tree as load_tree
    from trueup.identification.torque_model import load as load
    from trueup.inspection import inspect as inspect
    from trueup.loop.belief import Belief as Belief
    from trueup.loop.calibrate import Options as Options
    from trueup.loop.calibrate import calibrate as calibrate
    from trueup.loop.confirm import hunt as hunt
    from trueup.loop.experiment import most_telling as most_telling
    from trueup.loop.optimize import TrustRegion as TrustRegion
    from trueup.loop.optimize import optimize as optimize
    from trueup.loop.prepare import Preparation as Preparation
    from trueup.loop.prepare import prepare as prepare
    from trueup.loop.prepare import simulator_for as simulator_for
    from trueup.loop.surest import surest as surest
    from trueup.loop.transfer import shortlist as shortlist
    from trueup.loop.transfer import transfer as transfer
    from trueup.loop.whole_calibration import calibrate_whole as calibrate_whole
    from trueup.loop.whole_runs import whole_body as whole_body
    from trueup.loop.whole_runs import whole_runs as whole_runs
    from trueup.loop.worth import worth_calibrating as worth_calibrating
    from trueup.parameters import Parameter as Parameter
    from trueup.parameters import ParameterSpace as ParameterSpace
    from trueup.paths import Path as Path
    from trueup.recording import Channel as Channel
    from trueup.recording import Recording as Recording
    from trueup.report import write_report as write_report
    from trueup.report.film_replay import write_film as write_film
    from trueup.robots.by_hand import ByHand as ByHand
    from trueup.tasks.follow_path import FollowPath as FollowPath
    from trueup.trial import Trial as Trial

__version__ = "0.1.0"

_HOME = {
    "ArticulatedSimulator": "trueup.articulated.simulator",
    "Belief": "trueup.loop.belief",
    "Bench": "trueup.actuators.bench",
    "BicycleSimulator": "trueup.engines.vehicle",
    "ByHand": "trueup.robots.by_hand",
    "Calibration": "trueup.calibration",
    "Channel": "trueup.recording",
    "ChannelMap": "trueup.formats",
    "Declaration": "trueup.articulated.declarations",
    "FollowPath": "trueup.tasks.follow_path",
    "MujocoSimulator": "trueup.engines.mujoco.rollout",
    "Options": "trueup.loop.calibrate",
    "Parameter": "trueup.parameters",
    "ParameterSpace": "trueup.parameters",
    "Path": "trueup.paths",
    "Preparation": "trueup.loop.prepare",
    "Quantity": "trueup.articulated.quantities.quantity",
    "Recording": "trueup.recording",
    "Trial": "trueup.trial",
    "TrueupError": "trueup.errors",
    "TrustRegion": "trueup.loop.optimize",
    "Vehicle": "trueup.engines.vehicle",
    "calibrate": "trueup.loop.calibrate",
    "declare": "trueup.articulated.declarations",
    "filmed": "trueup.engines.mujoco.filming",
    "hunt": "trueup.loop.confirm",
    "identify": "trueup.identification.estimation.identify",
    "identify_actuator": "trueup.actuators.identify",
    "inspect": "trueup.inspection",
    "load": "trueup.identification.torque_model",
    "load_tree": "trueup.identification.model_file",
    "most_telling": "trueup.loop.experiment",
    "optimize": "trueup.loop.optimize",
    "prepare": "trueup.loop.prepare",
    "propose": "trueup.engines.mujoco.setup.proposal",
    "read": "trueup.formats",
    "shortlist": "trueup.loop.transfer",
    "servo_quantity": "trueup.actuators.simulated",
    "simulator_for": "trueup.loop.prepare",
    "transfer": "trueup.loop.transfer",
    "transition": "trueup.campaign.motions",
    "walk": "trueup.campaign.walks",
    "surest": "trueup.loop.surest",
    "calibrate_whole": "trueup.loop.whole_calibration",
    "whole_body": "trueup.loop.whole_runs",
    "whole_runs": "trueup.loop.whole_runs",
    "worth_calibrating": "trueup.loop.worth",
    "write": "trueup.formats",
    "write_film": "trueup.report.film_replay",
    "write_model": "trueup.engines.mujoco.writing.write",
    "write_report": "trueup.report",
}
"""Public name -> module that defines it."""


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'trueup' has no attribute '{name}'; public names are: {', '.join(sorted(_HOME))}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value  # the next access does not come here
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
