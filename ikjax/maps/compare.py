"""Two maps side by side: the headline figures, and the positions where they differ."""

from typing import Any

from ikjax.maps.reach_map import ReachMap

FIGURES = (
    ("goals", "{:,.0f}"),
    ("reach", "{:.3f} m"),
    ("height", "{:+.3f} m"),
    ("volume", "{:.3f} m^3"),
    ("mean_dexterity", "{:.2%}"),
    ("best_dexterity", "{:.2%}"),
    ("dexterous_volume", "{:.3f} m^3"),
    ("solutions_per_goal", "{:.3f}"),
    ("solutions_per_goal_within", "{:.3f}"),
    ("goals_per_second", "{:,.0f}"),
)


def compare(then: ReachMap, now: ReachMap) -> dict[str, Any]:
    """The figures of both by name, as [then, now]; on one grid also `positions_that_differ`."""
    before, after = then.numbers(), now.numbers()
    shared = [name for name, _ in FIGURES if name in before and name in after]
    figures: dict[str, Any] = {name: [before[name], after[name]] for name in shared}
    if then.grid == now.grid and then.orientations == now.orientations and "reach" in shared:
        differ = then.reachable_within != now.reachable_within
        figures["positions_that_differ"] = int(differ.sum())
    return figures


def in_words(figures: dict[str, Any], then: str) -> str:
    """What `compare` found, a line a figure."""
    lines = [f"compared with {then}"]
    for name, form in FIGURES:
        if name not in figures:
            continue
        before, after = figures[name]
        share = f" ({after / before - 1:+.1%})" if before and before != after else ""
        lines.append(f"  {name.replace('_', ' '):26} {form.format(before)} -> {form.format(after)}{share}")
    if "positions_that_differ" in figures:
        lines.append(f"  {'positions that differ':26} {figures['positions_that_differ']:,}")
    else:
        lines.append("  positions or orientations are others, so they are not compared one by one")
    return "\n".join(lines)
