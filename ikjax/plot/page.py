"""A map on one page: self-contained HTML, with its pictures inside.

It loads no script, font or picture from elsewhere, so that a stored or sent page stays readable. All text of
a map is escaped, because a map may come from anyone.
"""

import base64
import io
import json
import shlex

import numpy as np

from ikjax.core.text import html
from ikjax.maps import statistics
from ikjax.maps.reach_map import ReachMap, compare, in_words
from ikjax.maps.sets.orientations import Cone, Even
from ikjax.maps.sets.positions import Grid
from ikjax.maps.store import manifest
from ikjax.plot.bars import histogram, limit_costs
from ikjax.plot.contrast import comparison
from ikjax.plot.disc import globe
from ikjax.plot.slices import reach_map
from ikjax.plot.solid import nested
from ikjax.plot.style import pyplot

DPI = 110

_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; color: #1b1b1b }}
body {{ max-width: 1240px; margin: 2em auto; padding: 0 1em }}
pre {{ background: #f5f5f3; padding: .8em 1em; overflow-x: auto; font-size: 13px; line-height: 1.45 }}
img {{ max-width: 100%; height: auto; display: block; margin: .5em 0 }}
h2 {{ margin-top: 1.8em; font-size: 1.15em }}
p {{ max-width: 75ch }}
</style></head><body>
"""


def page(reach: ReachMap, then: ReachMap | None = None, name: str = "map.zarr") -> str:
    """A map in text and pictures, with the commands that make it again; and compared with an earlier map.

    Args:
        reach: The map.
        then: Another map to compare with; pictures are compared where the positions are the same.
        name: Path of the map, for the title and the commands.

    Returns:
        The whole HTML.

    Raises:
        ImportError: Without matplotlib.
    """
    plt = pyplot()
    arm = reach.arm
    parts = [_HEAD.format(title=html(f"{reach.heading}: {name}"))]
    parts.append(f"<h1>{html(reach.heading)}</h1>\n{_text(reach.summary())}")

    def show(title: str, words: str, figure) -> None:
        parts.append(f"<h2>{title}</h2>\n<p>{words}</p>\n{_picture(figure)}")
        plt.close(figure)

    if then is not None:
        parts.append(f"<h2>Compared</h2>\n{_text(in_words(compare(then, reach), 'the first map'))}")
    if then is not None and then.positions == reach.positions and _has_counts(then) and _has_counts(reach):
        words = "Orange has lost and purple has gained; dots: newly reached, strokes: no longer reached."
        show("Second against first", words, comparison(then, reach))
    if _has_counts(reach):
        words = "Share of orientations reached. Grey: beyond the joint limits alone. White: out of reach."
        show("Dexterity", words, reach_map(reach))
    if _has_counts(reach) and isinstance(reach.positions, Grid) and min(reach.positions.shape) > 1:
        words = "Each solid is where at least so large a share of the orientations is reached."
        show("Nested solids", words, nested(reach))
    if statistics.LIMITED_BY in reach.arrays:
        words = (
            "Goals reached but for the limits of one joint; goals that two joints keep away are in no bar."
        )
        show("Which limit costs what", words, limit_costs(reach))
    if _has_counts(reach):
        show("How it is spread", "By volume, area or length, or by points on a surface.", histogram(reach))
    places = _places(reach) if _has_counts(reach) and arm.task == "pose" and arm.family else np.empty((0, 3))
    if len(places):
        words = (
            "Directions of the tool's z axis as discs of equal area, both seen from above: at the "
            "position of greatest dexterity, at a median one, and at the least dexterous one."
        )
        show("Which ways the tool can point", words, globe(arm, places))
    parts.append(f"<h2>The arm</h2>\n{_text(str(arm))}")
    parts.append(f"<h2>How to repeat it</h2>\n{_text(repeat(reach, name))}")
    spec, _ = manifest.describe(reach)
    parts.append(
        f"<h2>Spec</h2>\n<p>Fingerprint {manifest.fingerprint(spec)}. All that the numbers depend on:</p>\n"
        f"<details><summary>JSON</summary>{_text(json.dumps(spec, indent=1))}</details>\n</body></html>\n"
    )
    return "\n".join(parts)


def repeat(reach: ReachMap, name: str) -> str:
    """Commands that make a map again, to be run in the folder of `name`."""
    is_short = isinstance(reach.orientations, Even | Cone)
    which = repr(reach.orientations) if is_short else f"{reach.orientation_count:,} rotations"
    words = {key: _in_python(key, spec) for key, spec in reach.statistic_specs.items()}
    names = ", ".join(words.values())
    custom = [key for key, word in words.items() if word == key]
    given = "".join(f"{key} = ...  # the ikjax.maps.Measure of that name, as it was\n" for key in custom)
    certify = ", certify=True" if manifest.is_certified(reach.statistic_specs) else ""
    samples = f", redundancy_samples={reach.redundancy_samples}" if reach.arm.locked else ""
    shell = shlex.quote(name)
    return f"""\
# in Python: the same arm, positions and orientations ({which})
import ikjax, jax
jax.config.update("jax_enable_x64", True)
{given}old = ikjax.ReachMap.load({name!r})
new = ikjax.sweep(old.arm, old.positions, old.orientations,
                  free_rolls={reach.free_rolls}{samples}, dtype={reach.dtype!r}{certify},
                  statistics=[{names}], out="again.zarr")
assert all(new.to_numpy()[k].tobytes() == v.tobytes() for k, v in old.to_numpy().items())

# in a shell: this page again, and what changed
ikjax show {shell}
ikjax show {shell} again.zarr"""


def _in_python(key: str, spec: dict) -> str:
    """A statistic as a Python expression; a custom measure is a variable of its name."""
    if "near" in spec:
        position, rotation = spec["near"]
        return f"ikjax.maps.Near({position!r}, {rotation!r}, {key!r})"
    return repr(key) if key in statistics.available(redundant=True) else key


def _has_counts(reach: ReachMap) -> bool:
    """Whether the map has the counts that pictures of dexterity need."""
    return {"reachable", "reachable_within"} <= reach.arrays.keys()


def _places(reach: ReachMap) -> np.ndarray:
    """Of the reached positions those of greatest, median and least dexterity, (k, 3)."""
    share = np.ravel(reach.dexterity)
    order = np.argsort(share, kind="stable")[int((share == 0).sum()) :]
    chosen = [order[-1], order[len(order) // 2], order[0]] if len(order) else []
    return reach.positions.points().reshape(-1, 3)[list(dict.fromkeys(chosen))]


def _text(words: str) -> str:
    return f"<pre>{html(words)}</pre>"


def _picture(figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="" src="data:image/png;base64,{data}">'
