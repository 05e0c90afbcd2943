"""A study file is understood, or refused with the name of the key."""

import numpy as np
import pytest

import ikjax
from ikjax.cli import study_file
from ikjax.cli.study_file import STATISTICS

SHORT = 'arm = "ur5"\nspacing = 0.5\norientations = 8\n'


@pytest.fixture
def read(tmp_path):
    def written(text):
        (tmp_path / "study.toml").write_text(text)
        return study_file.read(tmp_path / "study.toml")

    return written


def test_a_short_study_takes_the_defaults(read):
    study = read(SHORT)
    assert study.arm.name == "ur5" and study.positions == ikjax.maps.around(study.arm, 0.5)
    assert study[2:] == (8, 1, STATISTICS, None, "float32", False, None, None)


def test_a_study_can_say_everything(read, tmp_path):
    study = read(
        """
        arm = "puma560"
        spacing = 0.5
        orientations = { wxyz = [[1, 0, 0, 0], [0, 1, 0, 0]] }
        bounds = [[0, 0, 0], [1, 1, 0.5]]
        limits = [[-1, 1], [-2, 2], [-3, 3], [-1, 1], [-2, 2], [-inf, inf]]
        statistics = ["reachable", "solutions", "reachable_within", "solutions_within"]
        chunk = [2, 1, 2]
        dtype = "float64"
        free_rolls = 3
        """
    )
    assert study.positions.shape == (3, 3, 2)
    assert np.allclose(study.orientations, [np.eye(3), np.diag([1, -1, -1])], atol=1e-7)
    assert study.arm.limits[1].tolist() == [-2, 2] and np.isinf(study.arm.limits[5]).all()
    assert (
        study.statistics == STATISTICS[:4]
        and study.chunk == (2, 1, 2)
        and study.dtype == "float64"
        and study.free_rolls == 3
    )
    assert np.isinf(read(SHORT + "limits = false").arm.limits).all()
    assert read(SHORT + "certify = true").certify
    seven = 'arm = "fer"\nspacing = 0.5\norientations = 8\nredundancy_samples = 16\n'
    study = read(seven + 'statistics = ["reachable", "widest_interval_within"]')
    assert study.redundancy_samples == 16 and study.statistics[1] == "widest_interval_within"


def test_a_study_names_shells_surfaces_cones_and_grids_of_rotations(read, tmp_path):
    (tmp_path / "part.csv").write_text("1000, 0, 0\n0, 500, 0\n")
    rest = 'arm = "ur5"\n'
    study = read(rest + 'surface = { file = "part.csv", scale = 0.001 }\norientations = { hopf = 1 }')
    assert study.positions == ikjax.maps.surface(
        [[1, 0, 0], [0, 0.5, 0]]
    ) and study.orientations == ikjax.maps.hopf(1)
    study = read(
        rest + "shell = { center = [0, 0, 1], radii = [0.5], directions = 9 }\nchunk = [1, 3]\n"
        "orientations = { cone = { direction = [0, 0, -1], half_angle = 0.5, directions = 4 } }"
    )
    assert study.positions == ikjax.maps.shell((0, 0, 1), 0.5, 9) and study.chunk == (1, 3)
    assert study.orientations == ikjax.maps.cone((0, 0, -1), 0.5, 4)


def test_a_urdf_file_is_looked_for_beside_the_study(read, tmp_path):
    with pytest.raises((ValueError, OSError), match=str(tmp_path / "mine.urdf")):
        read('arm = "mine.urdf"\nspacing = 0.5\norientations = 8')


def test_a_study_names_the_ends_of_a_files_arm(read, tmp_path):
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    joint += '<joint name="{0}" type="fixed"><parent link="b"/><child link="{0}"/></joint>'.format("tool")
    joint += '<joint name="{0}" type="fixed"><parent link="b"/><child link="{0}"/></joint>'.format("camera")
    links = "".join(f'<link name="{name}"/>' for name in ("a", "b", "tool", "camera"))
    (tmp_path / "mine.XML").write_text(f"<robot>{links}{joint}</robot>")
    rest = 'arm = "mine.XML"\nspacing = 0.5\norientations = 8\n'
    assert read(rest + 'base = "a"\ntip = "tool"\naxis_tolerance = 1e-3').arm.n == 1
    for text, says in {
        'tip = "hand"': 'tip="hand" is none of',
        "tip = 3": "tip is of the wrong kind: 3",
        'tip = "tool"\naxis_tolerance = "x"': "axis_tolerance is of the wrong kind",
        'tip = "tool"\naxis_tolerance = 0.5': "axis_tolerance must be between 0 and 0.02",
    }.items():
        with pytest.raises(ValueError, match=r"study\.toml: ") as error:
            read(rest + text)
        assert says in str(error.value)
    with pytest.raises(ValueError, match="tip= goes with a URDF file, ur5 is of the catalogue"):
        read(SHORT + 'tip = "tool0"')


@pytest.mark.parametrize(
    "text, says",
    [
        (
            SHORT + "spacin = 1",
            "no key 'spacin'; the keys are angles, arm, base, tip, axis_tolerance, fixed_joints",
        ),
        (SHORT + "rolls = 2", "'rolls' is called 'free_rolls' now"),
        (SHORT + "tolerance = 1e-3", "'tolerance' is called 'axis_tolerance' now"),
        ('arm = "ur5"\nspacing = 0.5', "orientations is missing"),
        ("arm = 5\nspacing = 0.5\norientations = 8", "arm must be a name or a file"),
        ('arm = "nobody"\nspacing = 0.5\norientations = 8', "no robot 'nobody'"),
        ('arm = "ur5"\nspacing = true\norientations = 8', "spacing must be a number of metres, got True"),
        ('arm = "ur5"\nspacing = -1\norientations = 8', "spacing must be a positive number"),
        ('arm = "ur5"\nspacing = nan\norientations = 8', "spacing must be a positive number"),
        ('arm = "ur5"\nspacing = 0.5\norientations = 0', "orientations must be a whole number above zero"),
        ('arm = "ur5"\nspacing = 1\norientations = { even = 8 }', "orientations must be a whole number"),
        ('arm = "ur5"\nspacing = 1\norientations = { wxyz = 8 }', "orientations.wxyz must be 1 x 4 numbers"),
        ('arm = "ur5"\nspacing = 1\norientations = { wxyz = [[0, 0, 0, 0]] }', "length 1"),
        ('arm = "ur5"\norientations = 8', "one of spacing, shell and surface is wanted, got none"),
        (SHORT + "surface = {}", "one of spacing, shell and surface is wanted, got spacing, surface"),
        (SHORT + "free_rolls = 1.5", "free_rolls must be a whole number"),
        (SHORT + "redundancy_samples = 0", "redundancy_samples must be a whole number above zero, got 0"),
        (SHORT + 'statistics = ["widest_interval"]', "statistics must be a list of reachable, "),
        ('arm = "ur5"\norientations = 8\nsurface = { file = 3 }', "surface.file is of the wrong kind"),
        ('arm = "ur5"\norientations = 8\nshell = { radii = [1] }', "shell must have the keys center, radii"),
        ('arm = "ur5"\nspacing = 1\norientations = { hopf = 10 }', "level must be a whole number"),
        ('arm = "ur5"\nspacing = 1\norientations = { cone = 5 }', "cone must have the keys direction"),
        (SHORT + "bounds = [[0, 0], [1, 1]]", "bounds must be 2 x 3 numbers"),
        (SHORT + "bounds = [[0, 0, 0], [1, -1, 1]]", "lower must not exceed upper"),
        (SHORT + "limits = [[0, 1]]", "limits must be 6 x 2 numbers"),
        (SHORT + "limits = [[0, 1], [1]]", "limits must be 6 x 2 numbers"),
        (SHORT + 'statistics = ["reach"]', "statistics must be a list of reachable, "),
        (SHORT + "chunk = [0, 1, 1]", "chunk must be 3 whole numbers above zero"),
        (SHORT + "chunk = [1.5, 1, 1]", "chunk must be 3 whole numbers above zero"),
        (SHORT + "certify = 1", "certify must be true or false"),
        (SHORT + 'certify = true\ndtype = "float64"', "and with float32 only, got True with float64"),
        (SHORT + 'dtype = "float16"', 'dtype must be "float32" or "float64"'),
        ("arm = ", "no TOML"),
        ("x = " + "[" * 20_000, "no TOML"),
    ],
)
def test_what_is_not_understood_is_refused_by_key(read, text, says):
    with pytest.raises(ValueError, match=r"study\.toml: ") as caught:
        read(text)
    assert says in str(caught.value)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "study.toml").write_bytes(b"\xff\x00")
    with pytest.raises(ValueError, match="no TOML"):
        study_file.read(tmp_path / "study.toml")
