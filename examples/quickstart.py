import jax

jax.config.update("jax_enable_x64", True)  # float64; without it jax computes in float32

import ikjax

arm = ikjax.robots.puma560()  # or Arm.from_urdf("arm.urdf"), Arm.from_dh(a=..., alpha=..., d=..., ...)
goal = ikjax.pose(xyz=(0.4, 0.2, 0.3), rpy=(3.1, 0, 0.6))
sol = ikjax.solve(arm, goal)  # sol.q is (8, 6): a slot for each branch; sol.valid is (8,)
for name, q, valid in zip(arm.branches, sol.q, sol.valid, strict=True):
    print(f"{name:18} {'valid' if valid else '-':6}", *(f"{x:7.3f}" for x in q))

q, found = ikjax.nearest(arm, ikjax.within_limits(arm, sol), q_now=[0, 1, -3, 0, 1, 0])
print("nearest within limits:", q.round(3), found)


def height_of_elbow(goal):  # of the first branch, a function of the goal
    return ikjax.frames(arm, ikjax.solve(arm, goal).q[0])[2, 2, 3]


print("gradient in x, y, z:", jax.grad(height_of_elbow)(goal)[:3, 3].round(3))
