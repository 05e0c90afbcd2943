"""Closed-form inverse kinematics inside an MJX rollout, with gradients through both.

A PD controller holds the joints that the closed form gives for a moving target. The loss is how far the tool
is from it; its gradient by the amplitude of the path goes through the physics and through the solver.
Needs mujoco-mjx: pip install mujoco-mjx.
"""

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

import ikjax

LINK = '<geom type="capsule" fromto="0 0 0 {0}" size="0.02" mass="1" contype="0" conaffinity="0"/>'
MODEL = f"""
<mujoco model="positioner"><compiler angle="radian"/>
  <option timestep="0.005" gravity="0 0 0" integrator="Euler"/>
  <default><joint damping="2" armature="0.1"/></default>
  <worldbody>
    <body name="turn" pos="0 0 0.2"><joint name="pan" axis="0 0 1"/>{LINK.format("0 0 0.1")}
    <body name="upper" pos="0 0 0.1"><joint name="lift" axis="0 -1 0"/>{LINK.format("0.4 0 0")}
    <body name="fore" pos="0.4 0 0"><joint name="bend" axis="0 -1 0"/>{LINK.format("0.3 0 0")}
      <site name="tip" pos="0.3 0 0"/>
    </body></body></body>
  </worldbody>
</mujoco>
"""
compiled = mujoco.MjModel.from_xml_string(MODEL)
arm = ikjax.load(compiled, site="tip").baked()
model = mjx.put_model(compiled)
STEPS = 40
start = jnp.array([0.2, 0.9, -1.3])


def target(t, amplitude):
    xyz = ikjax.fk(arm, start)[:3, 3] + amplitude * jnp.array([0.0, jnp.sin(6 * t), 1 - jnp.cos(6 * t)])
    return ikjax.position(*xyz)


def rollout(amplitude):
    """Mean squared distance [m^2] of the tool from its moving target."""

    def step(data, i):
        goal = target(0.005 * i, amplitude)
        wanted, _ = ikjax.nearest(arm, ikjax.solve(arm, goal), data.qpos)
        force = 200 * (wanted - data.qpos) - 20 * data.qvel
        data = mjx.step(model, data.replace(qfrc_applied=force))
        error = ikjax.fk(arm, data.qpos)[:3, 3] - goal[:3, 3]
        return data, error @ error

    data = mjx.make_data(model).replace(qpos=start)
    _, errors = jax.lax.scan(step, data, jnp.arange(STEPS, dtype=start.dtype))
    return errors.mean()


loss, slope = jax.jit(jax.value_and_grad(rollout))(0.1)
h = 1e-2
value = jax.jit(rollout)
central = (value(0.1 + h) - value(0.1 - h)) / (2 * h)
print(f"arm: {arm.family}, joints {', '.join(arm.joint_names)}")
print(f"mean squared distance {loss:.2e} m^2, gradient {slope:.3e}, by differences {central:.3e}")
assert jnp.isfinite(slope) and abs(slope - central) < 0.05 * abs(central)
