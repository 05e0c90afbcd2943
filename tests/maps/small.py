"""A sweep of a tenth of a second in eight units, for tests that interrupt it."""

import pathlib

import numpy as np

import ikjax
from ikjax.maps.runner import SweepStoppedError as SweepStoppedError
from ikjax.maps.store import manifest

UNITS = 8
STEPS = 61
"""So many writes make its store, the four arrays of axes and rotations not counted."""


def study() -> dict:
    """Arguments of the sweep."""
    angle = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    turned = np.zeros((24, 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angle)
    turned[:, 1, 0] = np.sin(angle)
    turned[:, 0, 1] = -turned[:, 1, 0]
    turned[:, 2, 2] = 1
    grid = ikjax.maps.grid((-0.35, -0.35, -0.1), (0.35, 0.35, 0), 0.1)
    assert grid.shape == (8, 8, 2)
    flipped = turned * (1, -1, -1)  # the tool of a SCARA looks down
    return {"positions": grid, "orientations": np.concatenate([turned, flipped]), "dtype": "float32"}


def swept(out=None, **options) -> ikjax.ReachMap:
    """The sweep."""
    return ikjax.sweep(ikjax.robots.gx4_351s(), **{"chunk": (4, 4, 1), **study(), **options}, out=out)


def files(out) -> dict[str, bytes]:
    """What lies in a map's folder, but for the group's document, which holds the time it took."""
    out = pathlib.Path(out)
    found = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    found.pop(manifest.GROUP_KEY)
    return found


def bits(reach: ikjax.ReachMap) -> dict[str, bytes]:
    """Every statistic, bit by bit."""
    return {name: value.tobytes() for name, value in reach.to_numpy().items()}
