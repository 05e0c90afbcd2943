"""The picture of margin fields in the documentation: `python benchmarks/margins.py [docs/margins.png]`.

The best margin of a goal over all branches, inside and outside the workspace, with its gradient.
"""

import dataclasses
import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ikjax

FINE, COARSE = 241, 19


def panels():
    """Title, arm, pose of a point of the plane, half the plane's width [m], and whether limits count."""
    two = ikjax.robots.planar_2r()
    stiff = dataclasses.replace(two, limits=jnp.radians(jnp.array([[-60.0, 150.0], [15.0, 140.0]])))
    puma = ikjax.robots.puma560()

    def flat(u, v):
        return ikjax.position(u, v, 0 * u)

    def upright(u, v):
        return ikjax.pose(xyz=jnp.stack([u, 0 * u, v], -1), rpy=(jnp.pi, 0, 0))

    yield "2R: lengths 0.5 m and 0.4 m", two, flat, ("x", "y"), 1.3, False
    yield "2R with joint limits", stiff, flat, ("x", "y"), 1.3, True
    yield "PUMA 560, tool down, y = 0", puma, upright, ("x", "z"), 1.3, False
    yield "PUMA 560 within its joint limits", puma, upright, ("x", "z"), 1.3, True


def field(arm, pose, half, limits, count):
    """Coordinates, best margins (count, count), what is reached, and the margins' gradient in the plane."""
    line = jnp.linspace(-half, half, count)
    u, v = jnp.meshgrid(line, line)

    @jax.jit
    def both(u, v):
        def total(u, v):
            sol = ikjax.solve(arm, pose(u, v))
            best = ikjax.best_margin(arm, sol, blur=0.01, limits=limits)
            sol = ikjax.within_limits(arm, sol) if limits else sol
            return best.sum(), (best, sol.valid.any(-1))

        (_, found), gradient = jax.value_and_grad(total, (0, 1), has_aux=True)(u, v)
        return *found, *gradient

    shape = u.shape
    found = both(u.ravel(), v.ravel())
    return np.asarray(line), *(np.asarray(x).reshape(shape) for x in found)


def main(path: str = "docs/margins.png") -> None:
    """Write the picture."""
    figure, axes = plt.subplots(2, 2, figsize=(11, 10), layout="constrained")
    top = 0.4
    levels = np.linspace(-top, top, 17)
    for ax, (title, arm, pose, names, half, limits) in zip(axes.ravel(), panels(), strict=True):
        line, best, reached, _, _ = field(arm, pose, half, limits, FINE)
        image = ax.contourf(line, line, best, levels, cmap="RdBu", extend="both")
        ax.contour(line, line, reached, [0.5], colors="black", linewidths=1.6)
        few, _, _, du, dv = field(arm, pose, half, limits, COARSE)
        ax.quiver(few, few, du, dv, color="#333333", width=0.003, scale=28, pivot="mid")
        ax.set(title=title, xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]", aspect="equal")
    bar = figure.colorbar(image, ax=axes, shrink=0.7, aspect=34)
    bar.set_label("best margin [m]: black line around what is reached; arrows: its gradient")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
