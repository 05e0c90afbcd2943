"""`ikjax show`, and what a sweep says at its end: a map in words, as a picture, on a page, in a viewer.

Outside the storeys.
"""

import pathlib
import re
import urllib.parse
from typing import Any

import ikjax
from ikjax.cli.say import complain, say
from ikjax.maps import reach_map
from ikjax.maps.store.storage import Storage


def run_show(options) -> int:
    """Without --picture, --json or --viewer, the page and the picture lie beside where one works."""
    check_places(options)
    maps = [ikjax.ReachMap.load(name) for name in (options.map, options.other) if name]
    if options.viewer:
        from ikjax.plot.viewer import Viewer

        if options.other:
            raise ValueError("--viewer shows one map")
        Viewer(maps[0], port=options.port).run()
        return 0
    asked = bool(options.page)
    if not (asked or options.picture or options.json):
        stem = _stem(options.other or options.map)
        options.page = f"{stem}.html"
        # A map of other statistics than counts has a page, but no such picture.
        if all({"reachable", "reachable_within"} <= each.arrays.keys() for each in maps):
            options.picture = f"{stem}.png"
    then = maps[0] if options.other else None
    return report(options, maps[-1], then, options.map, options.page, asked)


def _stem(name: str) -> str:
    """map for here/map.zarr: what files of a map are called, in the folder where one works."""
    last = pathlib.PurePosixPath(urllib.parse.urlsplit(str(name).rstrip("/")).path).name
    return re.sub(r"[^\w.-]", "_", last.removesuffix(".zarr")) or "map"


def check_places(options) -> None:
    """Raise now what a sweep would find out at its end: nothing to draw with, nowhere to write."""
    out = getattr(options, "out", None)
    for file in (options.picture, getattr(options, "page", None)):
        if file:
            pathlib.Path(file).absolute().parent.mkdir(parents=True, exist_ok=True)
    if out:
        Storage(out)
    if options.picture:
        from ikjax import plot

        kinds = plot.file_types()
        if pathlib.Path(options.picture).suffix[1:].lower() not in kinds:
            raise ValueError(f"--picture must end in one of {', '.join(kinds)}, got {options.picture!r}")


def report(
    options,
    reach: ikjax.ReachMap,
    earlier: ikjax.ReachMap | None = None,
    earlier_name: str | None = None,
    page: str | None = None,
    asked: bool = True,
) -> int:
    text = reach.summary()
    data: dict[str, Any] = {"arm": reach.arm.name, **reach.numbers()}
    if reach.units is not None:
        text += f"\n  map               {options.out}: {reach.units}"
        data["units"] = reach.units._asdict()
    if options.picture or page:
        try:
            text += _drawn(options, reach, earlier, page)
        except ImportError as error:
            if asked:
                raise
            complain(error)  # what is shown unasked may be left out
    if earlier is not None:
        data["compared"] = reach_map.compare(earlier, reach)
        text += f"\n{reach_map.in_words(data['compared'], str(earlier_name))}"
    say(options, text, data)
    return 0 if data.get("positions_reachable", data.get("goals_reachable", 1)) > 0 else 1


def _drawn(options, reach: ikjax.ReachMap, earlier: ikjax.ReachMap | None, page: str | None) -> str:
    """Write what was asked for and say where it is."""
    from ikjax import plot

    text = ""
    if options.picture:
        if page and earlier is not None and earlier.positions == reach.positions:
            plot.comparison(earlier, reach, options.picture)
        else:
            plot.reach_map(reach, options.picture)
        text += f"\n  picture           {options.picture}"
    if page:
        from ikjax.plot.page import page as html_of

        html = html_of(reach, earlier, options.other or options.map)
        pathlib.Path(page).write_text(html, encoding="utf-8")
        text += f"\n  page              {page}"
    return text
