"""The tip of an arm whose model has several ends: where its longest chain of driven joints stops.

A gripper at the end of a chain is left out: joints that move several branches together by mimicking, and
those with a finger's name. What was chosen is a guess that the caller reports, and that `tip=` overrules.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from ikjax.arm.urdf.gripper import Moved, is_finger

_TIPS = (
    re.compile(
        r"tcp|tool_?cent|grasp|pinch|gripper_?(frame|site)|(?<![a-z])(ee|eef)(?![a-z])|end_?eff|attach"
    ),
    re.compile(r"tool"),
    re.compile(r"flange"),
)
"""Names of points that a tool is held by, the likeliest first."""


class Link(NamedTuple):
    """A link of a tree, or a frame fixed to one."""

    name: str
    parent: int
    """Place of its parent in the sequence of links, which comes before it; -1 at the root."""
    joints: tuple[Moved, ...] = ()
    """The joints between the parent and it: none where it is fixed."""
    leader: str = ""
    """Name of the joint that they are driven with: their own, or the one that they mimic."""


class Guess(NamedTuple):
    """A tip, and what was left out beyond it."""

    link: int
    arm: tuple[str, ...]
    """Names of the joints before it."""
    left_out: tuple[str, ...]
    """Names of the gripper's joints beyond it, on all branches."""


def guess_tip(links: Sequence[Link]) -> Guess | list[int]:
    """The tip of the longest chain from the root.

    Args:
        links: Of one tree; the first one is the root.

    Returns:
        The guess; or, where several chains are equally long, the last links of these.
    """
    apart = _driven_apart(links)
    longest: dict[int, list[str]] = {}
    for leaf in set(range(len(links))) - {link.parent for link in links}:
        path = _to_root(links, leaf)
        while len(path) > 1 and not _carries(links[path[0]], apart):
            path.pop(0)
        longest[path[0]] = [joint.joint for i in path[::-1] for joint in links[i].joints]
    most = max(map(len, longest.values()))
    ends = sorted(end for end, names in longest.items() if len(names) == most)
    if len(ends) > 1 or most == 0:
        return ends
    end, arm = ends[0], longest[ends[0]]
    below = {end}
    for i, link in enumerate(links):
        if link.parent in below:
            below.add(i)
    rigid = [end]
    for i, link in enumerate(links):
        if link.parent in rigid and not link.joints:
            rigid.append(i)
    left_out = tuple(joint.joint for i in sorted(below - {end}) for joint in links[i].joints)
    return Guess(_by_name(links, rigid, end), tuple(arm), left_out)


def _to_root(links: Sequence[Link], link: int) -> list[int]:
    """The link, its parent, and so on to the root."""
    path = [link]
    while links[path[-1]].parent >= 0:
        path.append(links[path[-1]].parent)
    return path


def _driven_apart(links: Sequence[Link]) -> set[str]:
    """Leaders of joints on several branches, as fingers are. Those on one chain may be a parallelogram's."""
    members: dict[str, list[int]] = {}
    for i, link in enumerate(links):
        if link.joints:
            members.setdefault(link.leader, []).append(i)
    return {
        leader
        for leader, group in members.items()
        if len(group) > 1 and not set(group) <= set(_to_root(links, group[-1]))
    }


def _carries(link: Link, apart: set[str]) -> bool:
    """Whether a link is moved by a joint of the arm, and not of a gripper."""
    return bool(link.joints) and link.leader not in apart and not any(map(is_finger, link.joints))


def _by_name(links: Sequence[Link], rigid: list[int], end: int) -> int:
    """Of links that do not move relative to each other, the one that is named like a tool's."""
    for names in _TIPS:
        named = [i for i in rigid if names.search(links[i].name.lower())]
        if named:
            return named[-1]
    # An unbranched row of fixed links ends somewhere; several ends tell nothing.
    ends = [i for i in rigid if not any(links[other].parent == i for other in rigid)]
    return ends[0] if len(ends) == 1 else end


def report(label: str, tip: str, guess: Guess, argument: str = "tip=") -> str:
    """The words of the warning that says what was guessed."""
    text = f"{label}: the tip is guessed: {tip}, after {len(guess.arm)} joints ({', '.join(guess.arm)})"
    if guess.left_out:
        text += f"; left out as a gripper's or another branch's: {', '.join(guess.left_out)}"
    return f"{text}. {argument} overrules it"
