"""An SO-101 that follows a hand, through the interface of LeRobot's `RobotKinematics`.

pip install "lerobot" and, with a robot at hand, send `action` to it at every step.
"""

import time

import numpy as np

import ikjax

MOTORS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]
# With the file: RobotKinematics("so101_new_calib.urdf", "gripper_frame_link", MOTORS).
arm = ikjax.load("so101")
kinematics = ikjax.RobotKinematics(arm, joint_names=[f"joint{i}" for i in range(1, 6)] + ["gripper"])

action = np.array([0.0, -40.0, 60.0, 20.0, 0.0, 30.0])  # degrees; the last one is the gripper's
start = kinematics.forward_kinematics(action)
kinematics.inverse_kinematics(action, start)  # compiles
times, moves, errors = [], [], []
for step in range(200):  # four seconds at 50 Hz
    phase = 2 * np.pi * step / 100
    goal = start.copy()
    goal[:3, 3] += 0.04 * np.array([np.cos(phase) - 1, np.sin(phase), 0.5 * np.sin(2 * phase)])
    before, clock = action, time.perf_counter()
    action = kinematics.inverse_kinematics(action, goal)
    times.append(time.perf_counter() - clock)
    moves.append(np.abs(action - before).max())
    errors.append(np.linalg.norm(kinematics.forward_kinematics(action)[:3, 3] - goal[:3, 3]))
print(f"median {1e3 * np.median(times):.1f} ms a step, largest move {max(moves):.1f} deg")
print(f"worst distance {1e3 * max(errors):.1f} mm")
assert np.median(times) < 0.02 and max(moves) < 8 and action[5] == 30.0
