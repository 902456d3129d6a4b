# SPDX-License-Identifier: Apache-2.0
"""The signals of joints and drives: what people call them, their units, and examples that a test runs."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from trueup.formats.rules.rule import Example, Rule

RULES = (
    Rule(
        "position",
        "position, positions, pos, q, qpos, angle, angles, theta, ang, jointangle, jointpos, jp, jpos, winkel, "
        "posicion, posizione",
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
            Example("Zeit,Istwinkel_Knie [Grad],Sollwinkel_Knie [Grad]", "0 10 11|.1 20 21|.2 30 31",
                    "command[deg] Knie; position[deg] Knie"),
            Example("t,axis0.encoder.pos_estimate,axis0.controller.input_pos", "0 .1 .1|.01 .2 .1|.02 .3 .2",
                    "command[rad] axis0; position[rev] axis0"),
            Example("t,low_state.motor_state[0].q,low_cmd.motor_cmd[0].q", "0 .1 .1|.01 .2 .1|.02 .3 .2",
                    "command[rad] joint_0; position[rad] joint_0"),
            Example("t,m1_pos_cmd,m1_pos_fb,m1_xyz_fb", "0 .1 .1 5|.01 .2 .1 6|.02 .3 .2 7",
                    "command[rad] m1; position[rad] m1; m_xyz_fb[] 1"),
            Example("t,q_hip,q_filt_hip,q_cmd_hip", "0 .1 .1 .2|.01 .2 .1 .3|.02 .3 .2 .4",
                    "command[rad] hip; position[rad] hip; position_filt[] hip"),
            Example("us,sim_q_hip,real_q_hip", "0 .1 .1|9000 .2 .1|18000 .3 .2", "position[rad] hip; position_sim[] hip"),
            Example("t,leader_hip.pos,follower_hip.pos", "0 .1 .1|.1 .2 .1|.2 .3 .2", "command[rad] hip; position[rad] hip"),
            Example("t,master_hip,puppet_hip", "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] hip; position[rad] hip"),
            Example("t,j1/enc_rad,j1/cmd_rad,j1/i_meas_A", "0 .1 .1 1|.01 .2 .1 1|.02 .3 .2 2",
                    "command[rad] j1; position[rad] j1; current[A] j1"),
            Example("t,axis1_6064h_position_actual,axis1_0x607A_target_position", "0 .1 .1|.01 .2 .1|.02 .3 .2",
                    "command[rad] axis1; position[rad] axis1"),
            Example("t,theta_1,theta_ref_1,u_1", "0 .1 .1 1|.01 .2 .1 1|.02 .3 .2 2",
                    "command[rad] joint_1; position[rad] joint_1; u[] 1"),
            Example("t,hip.q.sp,hip.q.pv", "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] hip; position[rad] hip"),
            Example("t,Device/SubDeviceList/LKneePitch/Position/Sensor/Value,Device/SubDeviceList/LKneePitch/Position/Actuator/Value",
                    "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] LKneePitch; position[rad] LKneePitch"),
            Example("t,leg_control_data.q[0],leg_control_command.q_des[0]", "0 .1 .1|.01 .2 .1|.02 .3 .2",
                    "command[rad] leg_0; position[rad] leg_0"),
            Example("temps,position_axe_1,consigne_axe_1,couple_axe_1", "0 .1 .1 1|.01 .2 .1 2|.02 .3 .2 1",
                    "command[rad] axe_1; position[rad] axe_1; torque[N m] axe_1"),
            Example("t,pos_id1,goal_id1,q_mes2", "0 .1 .1 .1|.01 .2 .1 .1|.02 .3 .2 .1",
                    "command[rad] id1; position[rad] id1 joint_2"),
            Example("t,joint_states.position.hip,joint_group_controller.command.hip", "0 .1 .1|.01 .2 .1|.02 .3 .2",
                    "command[rad] hip; position[rad] hip"),
            Example("t,Feedback_J1,Feedback_J2,Planned_J1,Planned_J2", "0 .1 .2 .1 .2|.01 .2 .1 .2 .2|.02 .3 .1 .2 .1",
                    "command[rad] J1 J2; position[rad] J1 J2"),
            Example("t,pos_cmd_j1,pos_fbk_j1", "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] j1; position[rad] j1"),
            Example("t,current_position_1,target_position_1,motor_current_1", "0 .1 .1 1|.01 .2 .1 2|.02 .3 .2 1",
                    "command[rad] joint_1; position[rad] joint_1; current[] motor_1"),
            Example("t,AIPos.A1,AIPos.A2,ASPos.A1,ASPos.A2,MACur.A1,MACur.A2",
                    "0 .1 .2 .1 .2 1 1|.01 .2 .1 .2 .2 2 1|.02 .3 .1 .2 .1 1 2",
                    "command[rad] A1 A2; position[rad] A1 A2; current[] A1 A2"),
            Example("t,curAngleHip,cmdAngleHip", "0 .1 .1|.01 .2 .1|.02 .3 .2", "command[rad] Hip; position[rad] Hip"),
            Example("t,p_act_1,v_act_1,t_act_1,p_des_1,v_des_1,kp_1,kd_1,t_ff_1",
                    "0 .1 1 1 .1 1 20 1 0|.01 .2 2 2 .1 1 20 1 1|.02 .3 1 1 .2 2 20 1 0",
                    "command[rad] joint_1; command_torque[N m] joint_1; command_velocity[rad/s] joint_1; "
                    "position[rad] joint_1; velocity[rad/s] joint_1; torque[N m] joint_1; kp[] joint_1; kd[] joint_1"),
        ),
        unit="rad", also=("m",),
    ),
    Rule(
        "velocity",
        "velocity, velocities, vel, vels, velo, speed, speeds, qd, dq, qdot, qvel, dth, omega, jointvel, jv, jvel, dot, "
        "geschwindigkeit, drehzahl, vitesse, velocidad, velocita",
        (
            Example("t,q_1,q_dot_1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; velocity[rad/s] joint_1"),
            Example("t,actual_q_0,actual_qd_0,speed_scaling", "0 .1 1 1|.01 .2 2 1|.02 .3 1 .9",
                    "position[rad] joint_0; velocity[rad/s] joint_0; speed_scaling[] speed_scaling"),
            Example("t,hip_angle,hip_rate", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] hip; velocity[rad/s] hip"),
            Example("t,hip_pos_rev,hip_vel_rev_s", "0 .1 .2|.1 .2 .3|.2 .3 .1", "position[rev] hip; velocity[rev/s] hip"),
            Example("t,hip_angle_deg,hip_speed_deg_s", "0 1 2|.1 2 3|.2 3 1", "position[deg] hip; velocity[deg/s] hip"),
        ),
        unit="rad/s", also=("m/s",),
    ),
    Rule(
        "acceleration",
        "acceleration, accelerations, acc, accel, qdd, ddq, qddot, qacc, ddot",
        (Example("t,q1,qdd1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; acceleration[] joint_1"),),
        unit="rad/s^2", also=("m/s^2",),
    ),
    Rule(
        "torque",
        "torque, torques, tau, taus, effort, efforts, eff, moment, trq, tq, torq, tor, qfrc, jt, jtau, jtrq, "
        "drehmoment, couple, coppia",
        (
            Example("t,q[0],tau_J[0],tau_J_d[0]", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "command_torque[N m] joint_0; position[rad] joint_0; torque[N m] joint_0"),
            Example("t,q_1,ExternalTorque_1,MeasuredTorque_1", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "position[rad] joint_1; torque[N m] joint_1; torque_external[] joint_1"),
            Example("t,pos_1,trq_act_1,vel_1", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "position[rad] joint_1; velocity[rad/s] joint_1; torque[N m] joint_1"),
            Example("t,q_1,tau_1,tau_act_1", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "command_torque[N m] joint_1; position[rad] joint_1; torque[N m] joint_1"),
            Example("t,FR_0_q,FR_0_tauEst,FR_0_tau_ff", "0 .1 1 2|.01 .2 2 3|.02 .3 1 2",
                    "command_torque[N m] FR_0; position[rad] FR_0; torque[N m] FR_0"),
            Example("t,q_hip,q_knee,tau_cmd_1,tau_cmd_2", "0 .1 .1 1 2|.01 .2 .2 2 3|.02 .3 .2 1 2",
                    "command_torque[N m] joint_1 joint_2; position[rad] hip knee"),
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
        "current, currents, cur, curr, amps, amperage, iq, strom",
        (
            Example("t,q1,current_1", "0 .1 1|.01 .2 2|.02 .3 1", "position[rad] joint_1; current[] joint_1"),
            Example("t,axis0.pos_estimate,axis0.current_control.Iq_measured", "0 .1 1|.01 .2 2|.02 .3 1",
                    "position[rev] axis0; current[] axis0"),
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
    Rule("voltage", "voltage, voltages, volt, volts, vin, vbat, vbus",
         (Example("t,vin,q_hip", "0 12 .1|.1 11 .2|.2 12 .1", "voltage[] voltage; position[rad] hip"),
          Example("t,motor_voltage_V", "0 12|.1 11|.2 12", "voltage[V] voltage"),), unit="V"),
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
            Example("t,q_hip,stiffness_hip,damping_hip", "0 .1 20 1|.1 .2 20 1|.2 .3 20 1",
                    "position[rad] hip; kp[] hip; kd[] hip"),
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
