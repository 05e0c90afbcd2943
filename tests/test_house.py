"""The order of the rooms: who may import whom."""

import ast
import pathlib
import subprocess
import sys

import ikjax
from ikjax.arm.recognition import recognize
from ikjax.solvers.families import FAMILIES

HOUSE = pathlib.Path(ikjax.__file__).parent
ROOMS = ["core", "arm", "solvers", "ik", "maps", "synthesis", "plot", "cli"]
"""In the order of imports. `cli` comes last: it may import everything, `ikjax` itself too."""


def files():
    return sorted(HOUSE.rglob("*.py"))


def tree(path):
    return ast.parse(path.read_text())


def imports(path):
    """Every module of ikjax that a file imports, anywhere in it, as dotted names."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full"
            names = [node.module] if node.module != "ikjax" else [f"ikjax.{x.name}" for x in node.names]
        else:
            names = [x.name for x in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in names if name.split(".")[0] == "ikjax")


def test_a_file_imports_its_own_room_and_those_below():
    inner = [path for path in files() if path.parent != HOUSE]
    assert len(inner) > 20
    for path in inner:
        room = path.relative_to(HOUSE).parts[0]
        if room == "cli":
            continue
        below = ROOMS[: ROOMS.index(room) + 1]
        for name in imports(path):
            # `cli`, and names that only `ikjax` itself exports, are in no room.
            assert name.partition("ikjax.")[2].split(".")[0] in below, f"{path}: {name}"


def test_only_the_front_door_stands_outside_a_folder():
    assert [path.name for path in files() if path.parent == HOUSE] == ["__init__.py"]


def test_the_front_door_is_sorted_and_has_no_logic():
    _, *lines, checking, version, lazy = tree(HOUSE / "__init__.py").body
    assert isinstance(checking, ast.If) and isinstance(lazy, ast.FunctionDef) and lazy.name == "__getattr__"
    assert isinstance(version, ast.Assign) and version.targets[0].id == "__version__"
    assert all(isinstance(line, ast.ImportFrom) for line in lines)
    assert [line.module for line in lines[2:]] == sorted(line.module for line in lines[2:])


def test_pictures_are_reachable_and_imported_when_they_are_first_used():
    code = (
        "import sys, ikjax; assert not {'ikjax.plot', 'matplotlib', 'tensorstore'} & set(sys.modules); "
        "assert ikjax.maps.grid and ikjax.plot.reach_map; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_folder_says_what_lives_in_it():
    for path in HOUSE.rglob("__init__.py"):
        assert ast.get_docstring(tree(path)), path


def test_recognition_and_kernels_list_the_same_families_in_one_order():
    assert list(recognize.RULES) == list(FAMILIES)


def test_the_library_never_sets_x64():
    for path in files():
        if path.parent.name == "cli":
            continue  # a program, which may choose for itself
        for node in ast.walk(tree(path)):
            words = {getattr(node, key, None) for key in ("attr", "id", "name")}
            if isinstance(node, ast.Call):
                words |= {x.value for x in node.args if isinstance(x, ast.Constant)}
            assert not words & {"enable_x64", "jax_enable_x64"}, f"{path}:{getattr(node, 'lineno', '')}"


def test_an_import_touches_no_device():
    """Else `jax.distributed.initialize`, or a choice of devices after the import, would come too late."""
    code = "import ikjax, ikjax.cli; from jax._src import xla_bridge; assert not xla_bridge._backends"
    subprocess.run([sys.executable, "-c", code], check=True)
