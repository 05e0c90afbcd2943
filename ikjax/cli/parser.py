"""The argument parser: which commands there are and which options each takes."""

import argparse
import math
from typing import Any, NoReturn

import ikjax
from ikjax.cli import whole_arm
from ikjax.cli.checks import run_doctor, run_verify
from ikjax.cli.completion import SHELLS, run_completion
from ikjax.cli.info import run_convert, run_info
from ikjax.cli.maps import run_sweep
from ikjax.cli.new_study import run_study
from ikjax.cli.show import run_show, run_view
from ikjax.cli.solving import run_project, run_solve, run_track
from ikjax.cli.stop import OTHERS_ENDED, TIME_IS_UP
from ikjax.cli.synthesis import run_design, run_place
from ikjax.core.text import one_line

ARM_HELP = "an arm of the catalogue, or a URDF or MJCF file"

GOALS_HELP = (
    "CSV with columns x, y, z and roll, pitch, yaw or qw, qx, qy, qz, a unit such as [mm] behind a name; "
    "- for standard input"
)

STUDY_HELP = """\
A study file says all of this in one place: `ikjax study new` writes one with comments, `ikjax study keys`
lists every key, `ikjax study statistics` what can be counted.

"""

SWEEP_EXIT_CODES = f"""\
Beside a map in a folder is its log, MAP.log. Exit codes:
  0    swept, and something is reached
  1    swept, and nothing is reached
  2    bad input, a map of another study, another process writing it
  3    the map cannot be written; the units before that are complete
  {TIME_IS_UP}    --max-hours are over; continue with --resume
  {OTHERS_ENDED}    another process of --distributed ended early; continue with --resume
  130  stopped by SIGINT (Ctrl-C), 143 by SIGTERM; continue with --resume
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose error message is one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {one_line(message)}\n")


def _size(text: str) -> float:
    """A finite length above zero [m]."""
    if not 0 < float(text) < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return float(text)


def _count(text: str) -> int:
    """A whole number above zero, 1e6 too."""
    if not (1 <= float(text) <= 1e12 and float(text).is_integer()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of goals")
    return int(float(text))


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands; the parsed options carry the function to run."""
    top = _Parser(prog="ikjax", description="Closed-form inverse kinematics.")
    top.add_argument("--version", action="version", version=f"ikjax {ikjax.__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    def command(run, name: str, text: str) -> argparse.ArgumentParser:
        parser = commands.add_parser(name, help=text, description=text)
        parser.add_argument("--json", action="store_true", help="print one JSON object")
        parser.add_argument("--no-cache", action="store_true", help="do not keep compiled programs")
        parser.set_defaults(run=run)
        return parser

    info = command(run_info, "info", "List the catalogue or a part of it, or describe one arm.")
    info.add_argument("arm", nargs="?", help=f"{ARM_HELP}; or a word of names, titles and makers: ur, kuka")
    info.add_argument("--find", nargs="+", metavar="WORD", help="list the arms that have each of these words")
    whole_arm.add_options(info)

    view = command(run_view, "view", "Show an arm in a browser: joints, a goal to drag, branches to pick.")
    view.add_argument("arm", help=ARM_HELP)
    view.add_argument("--map", metavar="MAP", help="a stored map of the arm to show beside it")
    view.add_argument("--no-meshes", action="store_true", help="do not show a URDF file's meshes")
    view.add_argument("--port", type=int, default=8080, help="on 127.0.0.1, 8080 by default")
    whole_arm.add_options(view)

    convert = command(run_convert, "convert", "Print an arm as a call of Arm.from_dh.")
    convert.add_argument("arm", help=ARM_HELP)
    whole_arm.add_options(convert)

    solve = command(run_solve, "solve", "Every branch of one goal, or of each goal of a file.")
    solve.add_argument("arm", help=ARM_HELP)
    _add_goals(solve)
    _add_start(solve, "present joints: arbitrary ones stay, and the nearest branch is named")
    solve.add_argument("--redundancy", nargs="+", type=float, help="values of redundant joints [deg, m]")
    solve.add_argument("--limits", action="store_true", help="only what is within the joint limits counts")
    solve.add_argument("--explain", action="store_true", help="say what each branch lacks")
    _add_dtype(solve, "--float32")
    whole_arm.add_options(solve)

    project = command(run_project, "project", "The nearest pose that an arm attains, for one goal or a file.")
    project.add_argument("arm", help=ARM_HELP)
    _add_goals(project)
    _add_length(project)
    project.add_argument(
        "--priority",
        choices=["weighted", "position", "orientation"],
        default="weighted",
        help="what is first",
    )
    _add_dtype(project, "--float32")
    whole_arm.add_options(project)

    track = command(run_track, "track", "Follow a path of goals on one branch.")
    track.add_argument("arm", help=ARM_HELP)
    track.add_argument("goals", metavar="GOALS.csv", help=GOALS_HELP)
    _add_turn(track, "of goals that have a position alone")
    _add_start(track, "joints before the first goal; by default those of the pose nearest to it")
    _add_length(track)
    _add_csv(track)
    _add_dtype(track, "--float32")
    whole_arm.add_options(track)

    sweep = command(run_sweep, "sweep", "Sweep an arm's workspace: a map, a picture, a summary.")
    sweep.formatter_class = argparse.RawDescriptionHelpFormatter
    sweep.epilog = STUDY_HELP + SWEEP_EXIT_CODES
    sweep.add_argument("arm", metavar="ARM|STUDY.toml", help=f"{ARM_HELP}, or a file with the whole study")
    sweep.add_argument("--spacing", type=_size, help="between positions [m], 0.05 by default")
    sweep.add_argument("--orientations", type=int, help="even ones at every position, 512 by default")
    sweep.add_argument(
        "--free-rolls", type=int, metavar="N", help="turns about the tool of which one must do"
    )
    sweep.add_argument(
        "--redundancy-samples", type=int, metavar="N", help="values of redundant joints, 32 by default"
    )
    sweep.add_argument(
        "--statistics", nargs="+", metavar="NAME", help="what to count; `ikjax study statistics` lists them"
    )
    sweep.add_argument("--title", help="what tells this map from others, for pictures and pages")
    sweep.add_argument("--out", help="store the map here: a folder (zarr v3), or a URL such as s3://...")
    sweep.add_argument("--resume", action="store_true", help="continue the map at --out, or start it")
    sweep.add_argument("--force", action="store_true", help="replace a map; with --resume, another study's")
    sweep.add_argument("--max-hours", type=_size, help="stop at the end of a unit after this time")
    sweep.add_argument("--distributed", action="store_true", help="share the units with other processes")
    sweep.add_argument("--coordinator", metavar="HOST:PORT", help="where jax does not find it by itself")
    sweep.add_argument("--processes", type=int, metavar="N", help="likewise; and --process, 0 to N - 1")
    sweep.add_argument("--process", type=int, metavar="I", help=argparse.SUPPRESS)
    sweep.add_argument("--compare", metavar="MAP", help="an earlier map to compare with")
    sweep.add_argument("--picture", help="write a PNG here")
    sweep.add_argument("--goals", metavar="GOALS.csv", help="draw these into a plan of one layer")
    _add_dtype(sweep, "--float64")
    sweep.add_argument("--certify", action="store_true", help="solve uncertain goals again in float64")
    whole_arm.add_options(sweep)

    place = command(run_place, "place", "Where an arm should stand for its goals.")
    _add_study_or_arm(place)
    place.add_argument("--move", nargs="+", metavar="MOVE", help="of x, y, z, turn, tilt and rail; x y turn")
    place.add_argument("--bounds", nargs="+", metavar="MOVE=LOW:HIGH", help="of moves [m, deg]")
    place.add_argument("--spacing", type=_size, help="of the candidates [m]")
    place.add_argument("--turns", type=_count, metavar="N", help="candidates of the turn, 12 by default")
    place.add_argument("--keep", type=_count, metavar="N", help="most places to list, 5 by default")
    box: dict[str, Any] = {"nargs": 6, "type": float, "metavar": ("X", "Y", "Z", "X2", "Y2", "Z2")}
    place.add_argument("--keep-out", action="append", **box, help="a box for no base [m]; may be repeated")
    place.add_argument("--parts", metavar="FILE", help="points (.csv) or triangles (.stl) to keep away from")
    place.add_argument("--clearance", type=_size, help="from boxes and parts [m]")
    place.add_argument("--rail", **box, help="two ends of a level rail, for the move rail [m]")
    place.add_argument("--starts", type=_count, metavar="N", help="candidates that are polished, 16")
    place.add_argument("--steps", type=int, metavar="N", help="of each, 60; 0 for none")
    whole_arm.add_options(place)

    design = command(run_design, "design", "Vary some numbers of an arm so that it serves its goals better.")
    _add_study_or_arm(design)
    design.add_argument("--vary", nargs="+", metavar="NAME=LOW:HIGH", help="a2, tool.z, ... [m, deg]")
    design.add_argument("--objective", help="coverage, dexterous_share, worst_margin, mean_manipulability")
    design.add_argument("--ties", nargs="+", metavar="EQUATION", help='such as "a2 + d4 = 0.8"')
    design.add_argument("--constraints", nargs="+", metavar="INEQUALITY", help='such as "a2 + d4 <= 0.8"')
    design.add_argument("--starts", type=_count, metavar="N", help="8 by default")
    design.add_argument("--steps", type=_count, metavar="N", help="of each start, 200 by default")
    design.add_argument("--local-search", type=int, metavar="N", help="arms tried near the best, 0")
    design.add_argument("--seed", type=int, help="of the random starts, 0 by default")
    whole_arm.add_options(design)

    study = command(run_study, "study", "Write a study file, or list what may stand in one.")
    study.add_argument("action", choices=["new", "keys", "statistics"], help="new writes a commented study")
    study.add_argument("file", nargs="?", default="study.toml", help="of `new`; - for standard output")
    study.add_argument("--arm", default="puma560", help=f"of `new`: {ARM_HELP}")
    study.add_argument("--force", action="store_true", help="replace a file")

    show = command(run_show, "show", "Summary, page (HTML) and picture of a stored map, or of two compared.")
    show.add_argument("map")
    show.add_argument("other", nargs="?", metavar="SECOND", help="a map to compare with the first")
    show.add_argument("--page", help="write the page here, by default MAP.html with MAP.png")
    show.add_argument("--picture", help="write a PNG here; alone, no page")
    show.add_argument("--goals", metavar="GOALS.csv", help="draw these into a plan of one layer")
    show.set_defaults(radians=False)
    show.add_argument("--viewer", action="store_true", help="turn the map in a browser, on 127.0.0.1 only")
    show.add_argument("--port", type=int, default=8080, help="of the viewer, 8080 by default")

    verify = command(run_verify, "verify", "Solve goals made by an arm's own joints and check every answer.")
    verify.add_argument("arm", nargs="*", help=f"{ARM_HELP}; all of the catalogue by default")
    whole_arm.add_options(verify)
    verify.add_argument("-n", type=_count, default=100_000, dest="count", help="random goals an arm")
    verify.add_argument("--out", help="write the table here, as Markdown")
    _add_dtype(verify, "--float32")

    command(run_doctor, "doctor", "Versions, devices, and a numeric self-check on this device.")
    completion = command(run_completion, "completion", "Print a script that completes words in a shell.")
    completion.add_argument("shell", choices=SHELLS, help="for example: source <(ikjax completion bash)")
    return top


def _add_study_or_arm(parser: argparse.ArgumentParser) -> None:
    """Arm, goals and tasks of `place` and `design`."""
    parser.add_argument("arm", metavar="ARM|STUDY.toml", help=f"{ARM_HELP}, or a study file")
    parser.add_argument("--goals", metavar="GOALS.csv", help=GOALS_HELP)
    _add_turn(parser, "that of goals that have a position alone")
    parser.add_argument("--free-rolls", type=_count, metavar="N", help="turns about the tool, one must do")
    parser.add_argument("--cone", type=float, metavar="ANGLE", help="the tool's axis may lean so far [deg]")
    parser.add_argument("--redundancy-samples", type=_count, metavar="N", help="of redundant joints, 16")
    parser.add_argument("--no-limits", action="store_true", help="leave the joint limits out")


def _add_goals(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--xyz", nargs=3, type=float, metavar=("X", "Y", "Z"), help="the goal's position [m]")
    parser.add_argument("--goals", metavar="GOALS.csv", help=GOALS_HELP)
    _add_turn(parser, "its orientation, and that of a file's goals that have a position alone")
    _add_csv(parser)


def _add_turn(parser: argparse.ArgumentParser, what: str) -> None:
    group = parser.add_argument_group("orientation", f"{what[0].upper()}{what[1:]}; none by default.")
    turn = group.add_mutually_exclusive_group()
    turn.add_argument("--rpy", nargs=3, type=float, metavar=("R", "P", "Y"), help="roll, pitch, yaw [deg]")
    turn.add_argument("--wxyz", nargs=4, type=float, metavar=("W", "X", "Y", "Z"))
    turn.add_argument("--xyzw", nargs=4, type=float, metavar=("X", "Y", "Z", "W"))
    turn.add_argument("--rotvec", nargs=3, type=float, metavar=("X", "Y", "Z"), help="[deg]")


def _add_start(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--from", nargs="+", type=float, dest="start", metavar="Q", help=f"{what}; as printed [deg, m]"
    )


def _add_length(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--characteristic-length", type=_size, default=0.1, help="counts as much as 1 rad [m], 0.1 by default"
    )


def _add_csv(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--csv", metavar="FILE", help="write joints here as CSV; - for standard output")


def _add_dtype(parser: argparse.ArgumentParser, flag: str) -> None:
    parser.add_argument(flag, action="store_true", dest="other_dtype", help=f"compute in {flag[2:]}")
