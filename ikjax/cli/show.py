"""`ikjax show`, and the report of a sweep: a map as a summary, a picture, a page, or in a viewer."""

import contextlib
import pathlib
import re
import sys
import urllib.parse
from typing import Any

import ikjax
from ikjax.cli import table, whole_arm
from ikjax.cli.output import print_error, print_result
from ikjax.maps import reach_map
from ikjax.maps.store.storage import Storage


def run_show(options) -> int:
    """Without --picture, --json or --viewer, the page and the picture are written to the working folder."""
    check_places(options)
    maps = [ikjax.ReachMap.load(name) for name in (options.map, options.other) if name]
    if options.viewer:
        from ikjax.plot.viewer import Viewer

        if options.other:
            raise ValueError("--viewer shows one map")
        print("compiling; Ctrl-C ends it", file=sys.stderr, flush=True)
        # At any moment: also while the first solution compiles.
        with contextlib.suppress(KeyboardInterrupt):
            Viewer(maps[0], port=options.port).run()
        return 0
    asked = bool(options.page)
    if not (asked or options.picture or options.json):
        stem = "-".join(_stem(name) for name in (options.map, options.other) if name)
        options.page = f"{stem}.html"
        # A map of other statistics than counts has a page, but no such picture.
        if all({"reachable", "reachable_within"} <= each.arrays.keys() for each in maps):
            options.picture = f"{stem}.png"
    then = maps[0] if options.other else None
    return report(options, maps[-1], then, options.map, options.page, asked)


def run_view(options) -> int:
    """An arm in a browser until Ctrl-C; a URDF file's meshes too, where they are there and yourdfpy is."""
    arm = whole_arm.from_options(options, options.arm)
    reach = ikjax.ReachMap.load(options.map) if options.map else None
    from ikjax.plot.arm_viewer import ArmViewer

    urdf = None if options.no_meshes else _with_meshes(options)
    print("compiling; Ctrl-C ends it", file=sys.stderr, flush=True)
    # At any moment: also while the first solution compiles.
    with contextlib.suppress(KeyboardInterrupt):
        ArmViewer(arm, port=options.port, reach=reach, urdf=urdf).run()
    return 0


def _with_meshes(options) -> Any:
    """The `yourdfpy.URDF` of a file with its meshes; None of another arm, or where they cannot be loaded."""
    if not options.arm.lower().endswith(".urdf") or options.mount is not None:
        return None
    try:
        import yourdfpy

        urdf = yourdfpy.URDF.load(options.arm)
        return urdf if urdf.scene.geometry else None
    except Exception as error:  # of yourdfpy and of whatever reads meshes: the arm is shown without
        print_error(f"without meshes: {error}")
        return None


def _stem(name: str) -> str:
    """The name of a map's files in the working folder: map for here/map.zarr."""
    last = pathlib.PurePosixPath(urllib.parse.urlsplit(str(name).rstrip("/")).path).name
    return re.sub(r"[^\w.-]", "_", last.removesuffix(".zarr")) or "map"


def check_places(options) -> None:
    """Raise now what a sweep would raise only at its end: nothing to draw with, nowhere to write."""
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
    """Print a map, and draw what the options ask for.

    Args:
        options: Of the command.
        reach: The map.
        earlier: Another map to compare with.
        earlier_name: Its name, for the text.
        page: Where to write the page.
        asked: Whether the pictures were asked for: only then is it an error if they cannot be drawn.

    Returns:
        The exit code: 0 if any goal is reached, else 1.
    """
    text = reach.summary()
    data: dict[str, Any] = {"arm": reach.arm.name, **reach.numbers()}
    if reach.units is not None:
        text += f"\n  map               {options.out}: {reach.units}"
        data["units"] = reach.units._asdict()
    if options.picture or page:
        try:
            text += _draw(options, reach, earlier, page)
        except ImportError as error:
            if asked:
                raise
            print_error(error)  # pictures that were not asked for may be left out
    if earlier is not None:
        data["compared"] = reach_map.compare(earlier, reach)
        text += f"\n{reach_map.in_words(data['compared'], str(earlier_name))}"
    print_result(options, text, data)
    return 0 if data.get("positions_reachable", data.get("goals_reachable", 1)) > 0 else 1


def _draw(options, reach: ikjax.ReachMap, earlier: ikjax.ReachMap | None, page: str | None) -> str:
    """Write the picture and the page; lines that say where they are."""
    from ikjax import plot

    text = ""
    goals = None
    if options.goals:
        goals = table.read_goals(options.goals, whole_arm.angle_unit(options))
    if options.picture:
        if page and earlier is not None and earlier.positions == reach.positions:
            plot.comparison(earlier, reach, options.picture, goals=goals)
        else:
            plot.reach_map(reach, options.picture, goals=goals)
        text += f"\n  picture           {options.picture}"
    if page:
        from ikjax.plot.page import page as html_of

        html = html_of(reach, earlier, options.other or options.map)
        pathlib.Path(page).write_text(html, encoding="utf-8")
        text += f"\n  page              {page}"
    return text
