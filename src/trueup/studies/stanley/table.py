# SPDX-License-Identifier: Apache-2.0
"""The paper's Table III: tracking error, time and energy, by the formulas of its appendix."""

from __future__ import annotations

from dataclasses import dataclass

RUN, REPOSITION = 170.0, 120.0
"""t_a and sigma_a in s: one run on the course, and bringing the robot back for the next one."""
ROBOT_POWER, COMPUTER_POWER = 1.0, 0.030
"""p_r and p_c in kW."""
PAPER_SIMULATION = 45.0
"""t_s of the paper in s, for one simulated run."""


@dataclass(frozen=True)
class Costs:
    """Time in hours and energy in kWh for tuning on the robot, and in simulation."""

    robot_hours: float
    simulation_hours: float
    robot_energy: float
    simulation_energy: float
    real_runs_hours: float
    """What the method needs of the robot all the same, which the paper leaves out."""

    @property
    def saved(self) -> tuple[float, float]:
        """Hours and kWh saved."""
        return self.robot_hours - self.simulation_hours, self.robot_energy - self.simulation_energy


def improvement(before: float, after: float) -> float:
    """Percent by which an error has fallen (eq. 12)."""
    return 100.0 * (before - after) / before


def costs(calibration_trials: int, tuning_trials: int, simulated_seconds: float, *, real_runs: int = 2) -> Costs:
    """Appendix B and C: `simulated_seconds` for one simulated trial; energy is power x hours."""
    robot = (RUN + REPOSITION) * tuning_trials / 3600.0
    simulation = simulated_seconds * (tuning_trials + calibration_trials) / 3600.0
    return Costs(robot, simulation, ROBOT_POWER * robot, COMPUTER_POWER * simulation,
                 (RUN + REPOSITION) * real_runs / 3600.0)  # fmt: skip
