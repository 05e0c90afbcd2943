"""Every branch of the closed form as a seed of a PyRoki problem: a pose, and a ball to keep away from.

Needs PyRoki, module `pyroki`, and what it brings. Run with almond-pyroki 0.1.1, a fork of it in the package
index.
"""

import io
import itertools

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import jaxlie
import jaxls
import numpy as np
import pyroki
import yourdfpy

import ikjax

arm = ikjax.load("ur5e")
goal = ikjax.pose(xyz=(0.45, 0.1, 0.3), rpy=(3.1, 0, 0))
ball, radius = jnp.array([0.2, 0.0, 0.55]), 0.25  # an obstacle


def urdf_of(arm):
    """The arm as a file: a joint turns about z, and what its link adds is the origin of the next one."""
    rest = np.asarray(ikjax.frames(arm, np.zeros(arm.n)), float)
    steps = [rest[0], *(np.linalg.inv(a) @ b for a, b in itertools.pairwise(rest))]
    steps[-1] = steps[-1] @ np.asarray(arm.tool, float)
    rows = ['<robot name="arm"><link name="l0"/>']
    for i, T in enumerate(steps):
        joint = "fixed" if i == arm.n else "revolute"
        xyz = " ".join(map(str, T[:3, 3]))
        pitch = np.arctan2(-T[2, 0], np.hypot(T[0, 0], T[1, 0]))
        rpy = f"{np.arctan2(T[2, 1], T[2, 2])} {pitch} {np.arctan2(T[1, 0], T[0, 0])}"
        low, high = np.asarray(arm.limits)[min(i, arm.n - 1)]
        rows.append(
            f'<link name="l{i + 1}"/><joint name="j{i}" type="{joint}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>'
        )
    return "".join(rows) + "</robot>"


robot = pyroki.Robot.from_urdf(yourdfpy.URDF.load(io.StringIO(urdf_of(arm)), load_meshes=False))
link = robot.links.names.index("l7")
q = jnp.array([0.3, -1.0, 1.2, -0.8, 0.5, 0.2])
there = jaxlie.SE3(robot.forward_kinematics(q)[link]).as_matrix()
assert max(ikjax.pose_error(ikjax.fk(arm, q), there)) < 1e-6  # both mean the same joints


def clearance(q):
    """Least distance [m] from the ball's surface to points along the links."""
    stations = ikjax.frames(arm, q)[1:, :3, 3]
    share = jnp.linspace(0, 1, 8)[:, None, None]
    points = (1 - share) * stations[:-1] + share * stations[1:]
    return jnp.linalg.norm(points - ball, axis=-1).min() - radius


@jaxls.Cost.factory
def keep_away(vals, var):
    return jnp.maximum(0.02 - clearance(vals[var]), 0)[None]


joints = robot.joint_var_cls(0)
target = jaxlie.SE3.from_matrix(goal)
costs = [
    pyroki.costs.pose_cost(robot, joints, target, jnp.array(link, jnp.int32), 1.0, 0.1),
    keep_away(joints),
]
problem = jaxls.LeastSquaresProblem(costs, [joints]).analyze()
sol = ikjax.within_limits(arm, ikjax.solve(arm, goal))
free = 0
for name, seed in zip(arm.branches, sol.q, strict=True):
    start = jaxls.VarValues.make([joints.with_value(seed)])
    end = problem.solve(initial_vals=start, verbose=False)[joints]
    distance, angle = ikjax.pose_error(ikjax.fk(arm, end), goal)
    free += bool((clearance(end) > 0) & (distance < 1e-4) & (angle < 1e-3))
    gaps = f"{100 * clearance(seed):6.1f} -> {100 * clearance(end):6.1f} cm from the ball"
    print(f"{name:18} {gaps}, {1000 * distance:.2f} mm off")
assert 0 < free < len(arm.branches)
