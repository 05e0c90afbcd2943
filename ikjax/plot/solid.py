"""The map of a box grid as solids, one for each level of dexterity, cut open to show the inside and the arm.

The isosurfaces are found by marching tetrahedra, six in a cell, where no case is ambiguous.

Source: Doi and Koide, An efficient method of triangulating equi-valued surfaces by using tetrahedral
cells, IEICE Trans. E74 (1991).
"""

import itertools

import numpy as np
from scipy import ndimage

from ikjax.maps.sets.positions import Grid
from ikjax.plot.disc import head, label
from ikjax.plot.planes import plane_of, posture, ticks_of
from ikjax.plot.stick import box, draw_3d, sticks
from ikjax.plot.style import INK, MAP, STYLE, finish, pyplot

MOST_CELLS = 44
"""Most cells along an axis of a picture; of a finer map every n-th layer is drawn."""

LIGHT = np.array([0.35, -0.6, 0.75]) / np.linalg.norm([0.35, -0.6, 0.75])


def isosurface(field: np.ndarray, level: float) -> np.ndarray:
    """The isosurface of a field on a grid, as triangles (t, 3, 3) [cells] whose normals point outwards.

    Args:
        field: (nx, ny, nz).
        level: Values of at least this are inside.
    """
    cells = np.stack(np.meshgrid(*[np.arange(n - 1) for n in field.shape], indexing="ij"), -1).reshape(-1, 3)
    # Six paths along the edges from a cell's first corner to its last: a tetrahedron each.
    paths = [np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], 0) for order in _ORDERS]
    corners = (cells[:, None, None] + np.array(paths)).reshape(-1, 4, 3)
    values = field[tuple(corners[..., k] for k in range(3))]
    mixed = (values >= level).any(1) & (values < level).any(1)
    corners, values = corners[mixed], values[mixed]
    order = np.argsort(-values, axis=1, kind="stable")
    values = np.take_along_axis(values, order, 1)
    corners = np.take_along_axis(corners, order[..., None], 1).astype(float)
    inside = (values >= level).sum(1)
    found = []
    for count, faces in _FACES.items():
        v, p = values[inside == count], corners[inside == count]
        out = p[:, count:].mean(1) - p[:, :count].mean(1)
        for face in faces:
            part = [(v[:, a] - level) / (v[:, a] - v[:, b]) for a, b in face]
            ends = zip(face, part, strict=True)
            triangle = np.stack([p[:, a] + t[:, None] * (p[:, b] - p[:, a]) for (a, b), t in ends], 1)
            wrong = np.einsum("ij,ij->i", _normals(triangle), out) < 0
            triangle[wrong] = triangle[wrong][:, ::-1]
            found.append(triangle)
    return np.concatenate(found)


_ORDERS = list(itertools.permutations(range(3)))
# By the number of corners inside, which are sorted first: the edges on which a triangle's corners lie.
_FACES = {
    1: [((0, 1), (0, 2), (0, 3))],
    2: [((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2))],
    3: [((0, 3), (1, 3), (2, 3))],
}


def _normals(triangles: np.ndarray) -> np.ndarray:
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def nested(reach, path=None, levels=(0.0, 0.25, 0.5, 0.75), q=None):
    """Where at least a share of the orientations is reached: a solid for each level, with a quarter cut out.

    The cut shows the dexterity inside, on one color scale, and the arm.

    Args:
        reach: A `ReachMap` of a box grid.
        path: Where to save the picture.
        levels: Shares of orientations, 0 to 1; 0 is all that is reached. Levels without a position are left
            out.
        q: (n,) posture to draw; by default the arm reaches for its most dexterous place.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A map of no box grid, or one of fewer than two layers.
    """
    plt = pyplot()
    if not isinstance(reach.positions, Grid) or min(reach.positions.shape) < 2:
        raise ValueError(f"solids need a box grid of two layers or more, got {reach.positions.in_words()}")
    base = np.asarray(reach.arm.base, float)[:3, 3]
    body = sticks(reach.arm, posture(reach, plane_of(reach, ("y", base[1]))) if q is None else q)
    dexterity = np.asarray(reach.dexterity, float)
    best = float(dexterity.max())
    # A level without positions, or with the same ones as an earlier level, makes no further solid.
    sizes = [int((dexterity >= max(level, 1e-9)).sum()) for level in levels]
    chosen = [level for k, level in enumerate(levels) if sizes[k] and sizes[k] not in sizes[:k]]
    step = max(1, -(-max(reach.positions.shape) // MOST_CELLS))
    field, ticks = _every_nth_layer(dexterity, ticks_of(reach), step)
    # Where the dexterity drops to zero, the surface is half way between the last position and the next.
    least = 0.5 * float(dexterity[dexterity > 0].min(initial=1))
    with plt.rc_context(STYLE):
        columns = max(len(chosen), 1)
        figure = plt.figure(figsize=(4.1 * columns + 1.0, 5.3), layout="constrained")
        figure.get_layout_engine().set(rect=(0.005, 0.0, 0.985, 0.87), w_pad=0.12)
        hit = np.argwhere(dexterity > 0)
        ends = np.array(reach.positions.origin) + reach.positions.spacing * (
            np.stack([hit.min(0), hit.max(0)]) if len(hit) else np.array([[0] * 3, reach.positions.shape])
        )
        for k in range(columns):
            ax = figure.add_subplot(1, columns, k + 1, projection="3d", computed_zorder=False)
            box(ax, np.concatenate([ends, body.line]))
            ax.view_init(elev=24, azim=-52)
            if chosen:
                _solid(ax, field, ticks, max(chosen[k], least), base, best)
                volume = reach.positions.volume(dexterity >= max(chosen[k], 1e-9))
                name = f"at least {chosen[k]:.0%}" if chosen[k] else "reached at all"
                ax.set_title(f"{name}: {volume:.3g} m³", fontweight="bold", color=INK, y=0.98)
            draw_3d(ax, body, INK, 2.2)
        image = plt.cm.ScalarMappable(plt.Normalize(0, best or 1), MAP)
        label(figure, image, "share of orientations reachable")
        thin = f", drawn every {step * reach.positions.spacing * 1000:.3g} mm" if step > 1 else ""
        caption = (
            f"Where the tool reaches so many of {reach.orientation_count:,} orientations within the joint "
            f"limits, a quarter cut out.   {reach.positions.in_words()}{thin}."
        )
        head(figure, reach.heading, caption)
    return finish(figure, path)


def _every_nth_layer(values: np.ndarray, ticks, step: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Every step-th layer, with an empty layer all around so that the solids are closed."""
    fewer = [tick[(len(tick) - 1) % step // 2 :: step] for tick in ticks]
    starts = [(len(tick) - 1) % step // 2 for tick in ticks]
    field = np.pad(values[tuple(slice(start, None, step) for start in starts)], 1)
    gap = [tick[1] - tick[0] if len(tick) > 1 else 1.0 for tick in fewer]
    return field, [np.concatenate([[t[0] - g], t, [t[-1] + g]]) for t, g in zip(fewer, gap, strict=True)]


def _solid(ax, field: np.ndarray, ticks, level: float, base: np.ndarray, best: float) -> None:
    """Draw what is inside a level, without the quarter in front of the base, towards +x and -y."""
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    cut = [int(np.argmin(np.abs(ticks[k] - base[k]))) for k in range(2)]
    triangles = isosurface(field, level)
    middle = triangles.mean(1)
    triangles = triangles[~((middle[:, 0] > cut[0]) & (middle[:, 1] < cut[1]))]
    normals = _normals(triangles)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles, normals = triangles[size[:, 0] > 1e-12], normals[size[:, 0] > 1e-12] / size[size[:, 0] > 1e-12]
    shade = 0.62 + 0.38 * np.clip(normals @ LIGHT, 0, 1)[:, None]
    faces = [*triangles]
    colors = [*(np.array(to_rgb("#b9c4d0")) * shade)]
    for axis in range(2):
        quads, values = _section(field, cut, axis, level)
        faces += [*quads]
        colors += [*pyplot().get_cmap(MAP)(values / best)[:, :3]]
    low, gap = np.array([t[0] for t in ticks]), np.array([t[1] - t[0] for t in ticks])
    world = [low + gap * face for face in faces]
    # Edges in the color of their face hide the seams between neighbors.
    ax.add_collection3d(Poly3DCollection(world, facecolors=colors, edgecolors=colors, linewidths=0.25))


def _section(field: np.ndarray, cut: list[int], axis: int, level: float, fine: int = 2):
    """The cut normal to x (0) or y (1) in small squares [cells], and their values."""
    layer = field.take(cut[axis], axis)
    layer = layer[: cut[1] + 1] if axis == 0 else layer[cut[0] :]
    first = 0 if axis == 0 else cut[0]
    i, j = (np.arange((n - 1) * fine) for n in layer.shape)
    center = np.meshgrid((i + 0.5) / fine, (j + 0.5) / fine, indexing="ij")
    values = ndimage.map_coordinates(layer, center, order=0)
    keep = values >= level
    across, up = first + center[0][keep], center[1][keep]
    half = 0.5 / fine
    around = [(-half, -half), (half, -half), (half, half), (-half, half)]
    square = np.stack([np.stack([across + a, up + b], -1) for a, b in around], 1)
    return np.insert(square, axis, cut[axis], axis=2), values[keep]
