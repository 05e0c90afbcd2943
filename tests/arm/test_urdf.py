import builtins
import dataclasses
import io
import pathlib
import re
import socket
import sys
import time
import warnings

import jax
import numpy as np
import pytest

import ikjax
from ikjax.arm.urdf.reader import read_chain, rotation_of
from ikjax.arm.urdf.xml import ArmFileError

LIMIT = '<limit lower="-1" upper="2" effort="1" velocity="1"/>'


def link(*names, inside=""):
    return "".join(f'<link name="{name}">{inside}</link>' for name in names)


def joint(name, parent, child, kind="revolute", inside=LIMIT):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def robot(*parts):
    """Each part on a line of its own, the first on line 2."""
    return "\n".join(['<robot name="test">', *parts, "</robot>"])


def one(inside=LIMIT, kind="revolute"):
    """One joint, on line 3."""
    return robot(link("a", "b"), joint("j", "a", "b", kind, inside))


def row(kinds):
    """Links l0, l1, ... joined in a row."""
    names = [f"l{i}" for i in range(len(kinds) + 1)]
    return robot(link(*names), *(joint(f"j{i}", *names[i : i + 2], kind) for i, kind in enumerate(kinds)))


def refusal(source, **ends):
    with pytest.raises(ArmFileError) as error:
        read_chain(source, **ends)
    return str(error.value)


def pose(x, y, z, rotation=None):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    T[:3, :3] = np.eye(3) if rotation is None else rotation
    return T


QUARTER_X = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
QUARTER_Z = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])

BRANCHING = robot(
    link("base", "arm", "camera", "hand", "left", "right", "free"),
    joint("shoulder", "base", "arm"),
    joint("mount", "arm", "camera", "fixed"),
    joint("elbow", "arm", "hand"),
    joint("grip", "hand", "left", "prismatic"),
    joint("follow", "hand", "right", "prismatic", LIMIT + '<mimic joint="grip"/>'),
    joint("drift", "base", "free", "floating", '<origin xyz="a b c"/>'),
)


def test_a_planar_arm_is_read():
    up = '<axis xyz="0 0 1"/>' + LIMIT
    chain = read_chain(
        robot(
            link("base", "upper", "fore", "tool"),
            joint("j1", "base", "upper", inside=up),
            joint("j2", "upper", "fore", inside=f'<origin xyz="0.5 0 0"/>{up}'),
            joint("end", "fore", "tool", "fixed", '<origin xyz=" .25  0\t0 "/>'),
        )
    )
    assert chain[:3] == ("test", "base", "tool")
    assert [(j.name, j.kind, j.lower, j.upper) for j in chain.joints] == [
        ("j1", "R", -1, 2),
        ("j2", "R", -1, 2),
    ]
    np.testing.assert_array_equal([j.axis for j in chain.joints], [[0, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal([j.origin for j in chain.joints], [np.eye(4), pose(0.5, 0, 0)])
    np.testing.assert_array_equal(chain.tool, pose(0.25, 0, 0))
    assert chain.tool.dtype == chain.joints[0].origin.dtype == chain.joints[0].axis.dtype == np.float64


def test_fixed_joints_are_folded_in_before_between_and_after():
    turn_x = f'<origin xyz="1 2 3" rpy="{np.pi / 2} 0 0"/>'
    turn_z = f'<origin xyz="4 5 6" rpy="0 0 {np.pi / 2}"/>'
    chain = read_chain(
        robot(
            link(*"abcdefg"),
            joint("f1", "a", "b", "fixed", turn_x),
            joint("j1", "b", "c", inside=turn_z + LIMIT),
            joint("f2", "c", "d", "fixed", turn_z),
            joint("j2", "d", "e", inside=turn_x + LIMIT),
            joint("f3", "e", "f", "fixed", turn_x + '<axis xyz="0 0 0"/>'),
            joint("f4", "f", "g", "fixed", turn_x),
        )
    )
    # (1, 2, 3) and a quarter about x, then (4, 5, 6) and a quarter about z; and so on, by hand.
    wanted = [
        pose(5, -4, 8, QUARTER_X @ QUARTER_Z),
        pose(2, 6, 9, QUARTER_Z @ QUARTER_X),
        pose(2, -1, 5, QUARTER_X @ QUARTER_X),
    ]
    got = [*(j.origin for j in chain.joints), chain.tool]
    np.testing.assert_allclose(got, wanted, atol=1e-14)


def test_rpy_turns_about_x_then_y_then_z():
    r, p, y = 0.3, -0.7, 1.9
    about_y = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    wanted = rotation_of(0, 0, y) @ about_y @ rotation_of(r, 0, 0)
    np.testing.assert_allclose(rotation_of(r, p, y), wanted, atol=1e-15)
    np.testing.assert_allclose(rotation_of(np.pi / 2, 0, 0), QUARTER_X, atol=1e-15)
    np.testing.assert_allclose(rotation_of(0, 0, np.pi / 2), QUARTER_Z, atol=1e-15)


@pytest.mark.parametrize(
    ("ends", "names"),
    [
        ({"tip": "hand"}, ["shoulder", "elbow"]),
        ({"tip": "camera"}, ["shoulder"]),
        ({"base": "arm", "tip": "left"}, ["elbow", "grip"]),
        ({"base": "hand", "tip": "left"}, ["grip"]),
    ],
)
def test_a_branching_file_is_cut_to_the_chain_asked_for(ends, names):
    chain = read_chain(BRANCHING, **ends)
    assert [j.name for j in chain.joints] == names
    assert (chain.base, chain.tip) == (ends.get("base", "base"), ends["tip"])


def test_the_tip_of_a_branching_tree_is_the_end_of_its_longest_chain():
    with pytest.warns(UserWarning, match='guessed: "hand", after 2 joints .* left out .* grip, follow'):
        assert read_chain(BRANCHING).tip == "hand"


@pytest.mark.parametrize(
    ("ends", "gist"),
    [
        (
            {"base": "hand"},
            '2 leaf links below "hand", give one as tip=: "left" (1 moving joints), "right" (1',
        ),
        ({"tip": "hadn"}, 'tip="hadn" is none of "base", "arm"'),
        ({"base": "x", "tip": "hand"}, 'base="x" is none of'),
        ({"base": "camera", "tip": "hand"}, 'tip link "hand" is not below base link "camera"'),
        ({"base": "hand", "tip": "arm"}, 'tip link "arm" is not below base link "hand"'),
        ({"base": "arm", "tip": "camera"}, 'no moving joint between links "arm" and "camera"'),
        ({"base": "hand", "tip": "hand"}, "no moving joint"),
        (
            {"tip": "right"},
            '<joint name="follow">: mimics "grip", no moving joint of the chain: choose base=',
        ),
        ({"tip": "free"}, '<joint name="drift">: type "floating" must be one of fixed, revolute,'),
    ],
)
def test_ends_that_give_no_chain_are_refused_with_the_choices(ends, gist):
    message = refusal(BRANCHING, **ends)
    assert message.startswith("<string>:") and gist in message


@pytest.mark.parametrize("kind", ["planar", "floating", "spherical", "Revolute"])
def test_other_types_on_the_chain_are_refused_by_name(kind):
    assert f'<string>:3: <joint name="j">: type "{kind}" must be one of fixed,' in refusal(one(kind=kind))


@pytest.mark.parametrize(
    ("kind", "inside", "letter", "limits"),
    [
        ("continuous", "", "R", (-np.inf, np.inf)),
        ("continuous", LIMIT, "R", (-np.inf, np.inf)),
        ("prismatic", LIMIT, "P", (-1, 2)),
        ("revolute", '<limit lower="-1e0" effort="nan"/>', "R", (-1, 0)),
        ("revolute", '<limit upper="+1."/>', "R", (0, 1)),
        ("revolute", '<limit lower="0.5" upper="0.5"/>', "R", (0.5, 0.5)),
        ("prismatic", '<limit lower="-1.79769e308" upper="1.79769e308"/>', "P", (-1.79769e308, 1.79769e308)),
    ],
)
def test_limits_are_read_as_specified(kind, inside, letter, limits):
    (only,) = read_chain(one(inside, kind)).joints
    assert (only.kind, only.lower, only.upper) == (letter, *limits)


def test_the_axis_is_x_where_none_is_given():
    np.testing.assert_array_equal(read_chain(one()).joints[0].axis, [1, 0, 0])


@pytest.mark.parametrize("scale", [5e-324, 1e-200, 0.5, 1 + 2e-6, 3, 1.7e308])
def test_an_axis_of_another_length_is_normalized_and_said(scale):
    with pytest.warns(UserWarning, match=r'<string>:3: <joint name="j">: axis has length .*, normalized'):
        chain = read_chain(one(f'<axis xyz="0 {scale} -{scale}"/>{LIMIT}'))
    np.testing.assert_allclose(chain.joints[0].axis, [0, 0.5**0.5, -(0.5**0.5)], rtol=1e-15)


@pytest.mark.filterwarnings("error")
def test_an_axis_rounded_to_seven_digits_is_normalized_in_silence():
    axis = read_chain(one(f'<axis xyz="0.7071068 0 0.7071068"/>{LIMIT}')).joints[0].axis
    assert abs(np.linalg.norm(axis) - 1) < 1e-15


def test_up_to_32_moving_joints_are_read():
    assert len(read_chain(row(["continuous", "fixed"] * 32)).joints) == 32
    assert "33 moving joints, more than 32" in refusal(row(["continuous"] * 33))


SO101 = [
    ("shoulder_pan", "0.0207909 -0.0230745 0.0948817", "-3.14159 0 1.5708", (-1.91986, 1.91986)),
    ("shoulder_lift", "-0.0303992 -0.0182778 -0.0542", "-1.5708 -1.5708 0", (-1.74533, 1.74533)),
    ("elbow_flex", "-0.11257 -0.028 0", "0 0 1.5708", (-1.69, 1.69)),
    ("wrist_flex", "-0.1349 0.0052 0", "0 0 -1.5708", (-1.65806, 1.65806)),
    ("wrist_roll", "0 -0.0611 0.0181", "1.5708 -9.38083e-08 3.14159", (-2.79253, 2.79253)),
]
"""The joints of Simulation/SO101/so101_new_calib.urdf of TheRobotStudio/SO-ARM100, commit 0aee1d0."""


def test_the_so101_is_read_with_its_rounded_angles():
    links = ["base", "shoulder", "upper", "lower", "wrist", "gripper", "gripper_frame", "jaw"]
    parts = [
        joint(
            name,
            *links[i : i + 2],
            inside=f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{low}" upper="{high}"/>',
        )
        for i, (name, xyz, rpy, (low, high)) in enumerate(SO101)
    ]
    tool = '<origin xyz="-0.0079 -0.000218121 -0.0981274" rpy="0 3.14159 0"/>'
    parts += [joint("frame", "gripper", "gripper_frame", "fixed", tool), joint("jaw", "gripper", "jaw")]
    chain = read_chain(robot(link(*links), *parts), tip="gripper_frame")
    assert [(j.name, j.kind, (j.lower, j.upper)) for j in chain.joints] == [
        (name, "R", limits) for name, _, _, limits in SO101
    ]
    frames = [np.eye(4)]
    for j in chain.joints:
        frames.append(frames[-1] @ j.origin)
    z = [frame[:3, 2] for frame in frames[1:]]
    # The three pitch axes are parallel; the roll axis is 3.7e-6 off square to them, as the file has it.
    np.testing.assert_allclose(z[1], z[2], atol=1e-15)
    np.testing.assert_allclose(z[1], z[3], atol=1e-15)
    assert 3.6e-6 < abs(z[4] @ z[3]) < 3.8e-6
    np.testing.assert_allclose(z[0], [0, 0, -1], atol=3e-6)
    np.testing.assert_allclose(chain.tool[:3, 3], [-0.0079, -0.000218121, -0.0981274])


def test_a_jaw_at_the_end_is_said_with_the_link_before_it():
    text = robot(
        link(*"abcd", "hand", "jaw", "tip"),
        *(joint(p + c, p, c, "continuous") for p, c in ("ab", "bc", "cd")),
        joint("roll", "d", "hand"),
        joint("moving_jaw", "hand", "jaw"),
        joint("end", "jaw", "tip", "fixed"),
    )
    with pytest.warns(UserWarning) as seen:
        chain = read_chain(text, tip="tip")
    assert [str(w.message) for w in seen] == [
        '<string>:7: <joint name="moving_jaw">: looks like a gripper\'s: leave it out with tip="hand"'
    ]
    assert len(chain.joints) == 5 and seen[0].filename == __file__
    with pytest.warns(UserWarning, match='the tip is guessed: "hand", after 4 joints .* moving_jaw'):
        assert len(read_chain(text).joints) == 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read_chain(text, tip="hand").joints) == 4


def test_a_path_text_and_bytes_read_the_same(tmp_path):
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{one()}'
    file = tmp_path / "arm.urdf"
    file.write_bytes(b"\xef\xbb\xbf" + text.encode())
    wanted = repr(read_chain(text))
    for source in (file, str(file), text.encode(), "\ufeff" + text, text.replace("\n", "\r\n")):
        assert repr(read_chain(source)) == wanted


def test_the_message_names_file_line_element_and_reason(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inside = f'\n<axis xyz="0 0 0"/>{LIMIT}'
    pathlib.Path("arm.urdf").write_text(one(inside))
    assert refusal("arm.urdf") == 'arm.urdf:4: <joint name="j">: axis must not be zero'
    assert isinstance(ArmFileError("x"), ValueError)


def test_a_file_that_cannot_be_opened_says_so(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_chain(tmp_path / "none.urdf")
    with pytest.raises(TypeError, match="PathLike"):
        read_chain(3)


def test_an_extension_of_another_namespace_is_not_mistaken_for_a_joint():
    space = 'xmlns="http://drake.mit.edu" xmlns:x="http://x"'
    text = one().replace('name="test"', f'name="test" {space}')
    text = text.replace("</robot>", '<x:joint name="j"/><x:link/></robot>')
    assert [j.name for j in read_chain(text).joints] == ["j"]


SKIPPED = [
    '<visual><geometry><mesh filename="package://../../etc/passwd"/></geometry></visual>',
    '<collision><geometry><mesh filename="file:///etc/passwd" scale="x"/></geometry></collision>',
    '<inertial><mass value="nan"/></inertial><visual/><visual/>',
]


@pytest.mark.parametrize("inside", SKIPPED)
def test_nothing_but_the_given_file_is_opened(inside, tmp_path, monkeypatch):
    file = tmp_path / "arm.urdf"
    other = (
        '<material name="m"/><gazebo><link/><joint/></gazebo><transmission><joint name="j"/></transmission>'
    )
    file.write_text(
        one().replace('"a"></link>', f'"a">{inside}</link>').replace("</robot>", other + "</robot>")
    )
    read_chain(file)  # whatever is imported on the first call
    opened, plain = [], io.open

    def spy(name, *args, **kwargs):
        opened.append(name)
        return plain(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "open", spy)
    monkeypatch.setattr(io, "open", spy)
    monkeypatch.setattr(socket, "socket", None)
    assert len(read_chain(file).joints) == 1
    assert opened == [str(file)]


LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
PREFIXED = " ".join(f"x:a{i}=''" for i in range(200_000))
SPACES = " ".join(f"xmlns:a{i}=''" for i in range(50_000))
ATTACKS = {
    "dtd": (f"<!DOCTYPE robot>{one()}", "a DTD, and entities with it, is refused"),
    "dtd on line 2": (f"<!-- -->\n<!DOCTYPE robot>\n{one()}", "<string>:2: a DTD, and"),
    "remote dtd": (f'<!DOCTYPE robot SYSTEM "http://x.invalid/a.dtd">{one()}', "a DTD, and"),
    "billion laughs": (
        f'<!DOCTYPE robot [<!ENTITY l0 "ha">{LAUGHS}]><robot name="&l9;"/>',
        "a DTD, and entities with it, is refused",
    ),
    "external entity": (
        f'<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>{one("&x;")}',
        "a DTD, and entities with it, is refused",
    ),
    "parameter entity": (f'<!DOCTYPE robot [<!ENTITY % x SYSTEM "file:///x">%x;]>{one()}', "a DTD, and"),
    "unknown entity": (one("&x;"), "undefined entity"),
    "xinclude": (
        one(f'<xi:include {XI} href="file:///etc/passwd"/>'),
        '<joint name="j">: XInclude is refused',
    ),
    "xinclude for the whole file": (
        '<robot name="r" xmlns="http://www.w3.org/2001/XInclude"><include href="x"/></robot>',
        '<robot name="r">: XInclude is refused',
    ),
    "xinclude undeclared": (robot("<xi:include href='x'/>"), "<xi:include>: XInclude is refused"),
    "xinclude in a mesh": (
        robot(link("a", inside='<visual><include xmlns="http://www.w3.org/2001/XInclude"/></visual>')),
        '<link name="a">: XInclude is refused',
    ),
    "nested 200,000 deep": ("<robot name='r'>" + "<x>" * 200_000, "nested deeper than 64"),
    "nested and closed": (f"<robot>{'<a>' * 200_000}{'</a>' * 200_000}</robot>", "nested deeper than 64"),
    "too many elements": (robot(*["<x/>"] * 100_000), "more than 100000 elements"),
    "too large": (robot("<!--" + " " * 2**24 + "-->"), "larger than 16 MB"),
    "long namespace, many attributes": (
        f'<robot xmlns:x="{"a" * 2**22}" {PREFIXED}/>',
        "<robot>: no links",
    ),
    "long namespace, many elements": (
        f'<robot xmlns="{"a" * 2**22}">{"".join(f"<a{i}/>" for i in range(90_000))}</robot>',
        "<robot>: no links",
    ),
    "many namespaces": (
        f"<robot {SPACES}>" + "<a>" * 62 + '<b xmlns:x=""/>' * 50_000,
        "broken XML: no element found",
    ),
    "laughs after the refusal": (
        f'<!DOCTYPE robot [<!ENTITY l0 "ha">{LAUGHS}]><robot name="r">{"&l4;" * 4_000_000}</robot>',
        "a DTD, and entities with it, is refused",
    ),
    "one long number": (one(f'<axis xyz="0 0 {"9" * 10**7}"/>' + LIMIT), "finite decimal numbers, got"),
    "NUL": (one("\0"), "<string>:3: the file must be UTF-8 text, it holds a NUL byte"),
    "NUL in bytes": (one("\0").encode(), "it holds a NUL byte"),
    "latin-1": (
        one().replace("test", "t\n\xe9").encode("latin-1"),
        "<string>:2: the file must be UTF-8, byte",
    ),
    "utf-16": (one().encode("utf-16"), "the file must be UTF-8"),
    "utf-16 without a mark": (one().encode("utf-16-le"), "it holds a NUL byte"),
    "half a surrogate pair": (one().replace("test", "\ud800"), "the file must be UTF-8, byte"),
    "other encoding": (f"<?xml version='1.0' encoding='latin-1'?>{one()}", 'it says "latin-1"'),
    "utf-7": (f'<?xml version="1.0" encoding="UTF-7"?>{one()}', 'it says "UTF-7"'),
}


@pytest.mark.parametrize(("source", "gist"), ATTACKS.values(), ids=ATTACKS)
def test_attacks_are_refused_at_once(source, gist, monkeypatch):
    monkeypatch.setattr(builtins, "open", None)
    monkeypatch.setattr(socket, "socket", None)
    start = time.perf_counter()
    message = refusal(source)
    assert time.perf_counter() - start < 2
    assert message.startswith("<string>") and gist in message
    assert len(message) < 500


def test_a_file_larger_than_the_limit_is_not_read_whole(tmp_path):
    file = tmp_path / "arm.urdf"
    with open(file, "wb") as sparse:
        sparse.truncate(2**40)
    assert refusal(file) == f"{file}: the file is larger than 16 MB"


def test_just_within_the_limits_is_fine():
    deep = "<x>" * 62 + "</x>" * 62
    assert read_chain(one().replace('"a"></link>', f'"a">{deep}</link>')).tip == "b"
    assert read_chain(one(LIMIT + "<!--" + " " * (2**24 - 500) + "-->")).tip == "b"
    assert read_chain(row(["fixed"] * 10_000 + ["continuous"])).tip == "l10001"


BAD_NUMBERS = [
    "0x10",
    "1,5",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "Infinity",
    "1_0",
    "１",
    "٣",
    "1e",
    ".",
    "+-1",
    "1f",
]


@pytest.mark.parametrize("text", BAD_NUMBERS)
@pytest.mark.parametrize(
    ("inside", "what"),
    [
        (f'<origin xyz="0 0 {{}}"/>{LIMIT}', "xyz of <origin> must hold 3 plain, finite decimal numbers"),
        (f'<origin rpy="{{}} 0 0"/>{LIMIT}', "rpy of <origin> must hold 3"),
        (f'<axis xyz="0 {{}} 0"/>{LIMIT}', "xyz of <axis> must hold 3"),
        ('<limit lower="{}" upper="9"/>', "lower of <limit> must hold 1 plain, finite decimal number,"),
        ('<limit lower="-9" upper="{}"/>', "upper of <limit> must hold 1"),
    ],
)
def test_only_plain_decimal_numbers_are_read(text, inside, what):
    message = refusal(one(inside.format(text)))
    assert message.startswith('<string>:3: <joint name="j">: ') and what in message and text in message


@pytest.mark.parametrize("key", ["xyz", "rpy"])
@pytest.mark.parametrize("text", ["", " ", "1", "1 2", "1 2 3 4", "1,2,3", "1;2;3", "1\u00a02 3", "1 2 3;"])
def test_vectors_have_three_numbers(key, text):
    assert f"{key} of <origin> must hold 3 plain" in refusal(one(f'<origin {key}="{text}"/>{LIMIT}'))


@pytest.mark.parametrize("text", ["${x} 0 0", "0 0 ${pi/2}", "$(arg x) 0 0"])
def test_xacro_is_to_be_expanded_first(text):
    assert "expand xacro first" in refusal(one(f'<origin rpy="{text}"/>{LIMIT}'))


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
UNUSED = {
    "a property": '<xacro:property name="width" value=".2"/>',
    "a property block": '<xacro:property name="o"><origin xyz="1 0 0"/></xacro:property>',
    "an argument": '<xacro:arg name="x" default="1"/>',
    "a property by another prefix": '<x:property xmlns:x="http://ros.org/wiki/xacro" name="w" value="1"/>',
    "a macro that nothing calls": '<xacro:macro name="m"><link name="${p}"/><joint name="j" type="x">'
    '<xacro:insert_block name="o"/></joint><xacro:m/></xacro:macro>',
    "a call in an extension": '<gazebo><xacro:plugin name="${x}"/></gazebo>',
    "a link of another namespace": '<link xmlns="http://x" name="a"/><y:link xmlns:y="http://y" name="z"/>',
    "a material of a property": '<material name="${m}"><color rgba="${c}"/></material>',
}


@pytest.mark.parametrize("extra", UNUSED.values(), ids=UNUSED)
def test_what_the_kinematics_do_not_use_is_passed_over(extra):
    wanted = repr(read_chain(one()))
    text = one().replace('name="test"', f'name="test" {XACRO}')
    assert repr(read_chain(text.replace("</robot>", extra + "</robot>"))) == wanted
    assert repr(read_chain(text.replace('"><link', f'">{extra}<link', 1))) == wanted


def test_a_call_inside_a_link_is_passed_over():
    inside = "<xacro:inertia mass='1'/><visual><xacro:if value='1'><x/></xacro:if></visual>"
    assert len(read_chain(robot(link("a", "b", inside=inside), joint("j", "a", "b"))).joints) == 1


USED = {
    "an include": '<xacro:include filename="x"/>',
    "a call": '<xacro:arm prefix="x"/>',
    "a call by another prefix": '<x:arm xmlns:x="http://www.ros.org/wiki/xacro"/>',
    "a condition": '<xacro:if value="1"><link name="c"/></xacro:if>',
    "an element": '<xacro:element xacro:name="joint"/>',
    "an old include": '<include filename="x"/>',
    "a link of a property": '<link name="${x}"/>',
    "a joint of a property": link("c") + joint("k", "a", "$(arg c)"),
}


@pytest.mark.parametrize("extra", USED.values(), ids=USED)
def test_what_may_change_the_kinematics_is_to_be_expanded_first(extra):
    assert "expand xacro first" in refusal(one().replace("</robot>", extra + "</robot>"))


@pytest.mark.parametrize(
    "inside", ['<xacro:insert_block name="origin"/>', '<xacro:if value="1"><origin xyz="1 0 0"/></xacro:if>']
)
def test_xacro_inside_a_joint_is_to_be_expanded_first(inside):
    assert '<joint name="j">: <xacro:' in refusal(one(inside + LIMIT))
    assert "expand xacro first" in refusal(one(inside + LIMIT))


def test_names_on_the_chain_are_to_be_expanded_first():
    assert "expand xacro first" in refusal(one().replace('name="j"', 'name="${j}"'))
    assert "expand xacro first" in refusal(one().replace('"revolute"', '"${kind}"'))


@pytest.mark.parametrize("inside", ["", '<limit effort="1" velocity="1"/>'])
def test_a_revolute_joint_without_limits_is_unlimited_and_said(inside):
    with pytest.warns(UserWarning, match=r'^<string>:3: <joint name="j">: no <limit> .* unlimited$') as seen:
        (only,) = read_chain(one(inside)).joints
    assert (only.lower, only.upper) == (-np.inf, np.inf)
    assert len(seen) == 1 and seen[0].filename == __file__


def test_only_a_joint_on_the_chain_needs_a_name_and_limits():
    off = joint("", "b", "c", inside="").replace(' name=""', "") + joint("", "b", "d", inside="")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chain = read_chain(robot(link(*"abcd"), joint("j", "a", "b"), off), tip="b")
    assert [j.name for j in chain.joints] == ["j"]
    assert "<joint>: <joint> needs a name" in refusal(
        robot(link(*"abcd"), joint("j", "a", "b"), off), tip="c"
    )


@pytest.mark.parametrize("name", ["", ' name=""'])
def test_a_robot_without_a_name_is_called_robot(name):
    assert read_chain(one().replace(' name="test"', name)).name == "robot"


def test_xacro_elements_are_to_be_expanded_first():
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    assert "expand xacro first" in refusal(robot(f'<xacro:include {space} filename="x"/>'))
    assert "expand xacro first" in refusal(robot('<include filename="x"/>'))


@pytest.mark.parametrize(
    ("inside", "kind", "gist"),
    [
        (f'<axis xyz="0 0 -0.0"/>{LIMIT}', "revolute", "axis must not be zero"),
        (f"<axis/>{LIMIT}", "revolute", "<axis> needs a xyz"),
        ("", "prismatic", "a prismatic joint needs a <limit>"),
        ('<limit lower="2" upper="1"/>', "revolute", "limit must have lower <= upper, got 2 and 1"),
        ('<limit lower="1"/>', "prismatic", "limit must have lower <= upper, got 1 and 0"),
        (f'<origin xyz="1e101 0 0"/>{LIMIT}', "revolute", "xyz of <origin> must be at most 1e+100 m"),
        (f"{LIMIT}<mimic/>", "revolute", "<mimic> needs a joint"),
        (f'{LIMIT}<mimic joint="j"/>', "revolute", 'mimics "j", which mimics it'),
        (f"<origin/><origin/>{LIMIT}", "revolute", "duplicate <origin>, the first is on line 3"),
    ],
)
def test_a_joint_that_is_not_plainly_right_is_refused(inside, kind, gist):
    assert refusal(one(inside, kind)) == f'<string>:3: <joint name="j">: {gist}'


STRUCTURE = {
    "another root": ("<sdf/>", "<string>:1: <sdf>: the root element must be <robot>"),
    "nothing": (b"", "<string>:1: broken XML: no element found"),
    "no element": ("<!-- -->", "<string>:1: broken XML: no element found"),
    "truncated": (one()[:-30], '<string>:3: <joint name="j">: broken XML: unclosed token'),
    "truncated between links": (
        robot(link("a"))[: -len("</robot>")],
        '<string>:3: <robot name="test">: broken XML: no element found',
    ),
    "mismatched": (
        robot("<link name='a'></joint>"),
        '<string>:2: <link name="a">: broken XML: mismatched tag',
    ),
    "two documents": (one() + one(), "<string>:4: broken XML: junk after document element"),
    "no links": (robot(), '<string>:1: <robot name="test">: no links'),
    "one link": (robot(link("a")), 'no moving joint between links "a" and "a"'),
    "two roots": (
        robot(link("a", "b", "c", "d"), joint("j", "a", "b"), joint("k", "c", "d")),
        '<string>:1: <robot name="test">: 2 root links, expected one: "a", "c"',
    ),
    "many roots": (robot(link(*(f"l{i}" for i in range(13)))), '"l11", ...'),
    "unknown parent": (
        robot(link("b"), joint("j", "a", "b")),
        '<string>:3: <joint name="j">: parent link "a" does not exist',
    ),
    "unknown child": (robot(link("a"), joint("j", "a", "b")), 'child link "b" does not exist'),
    "duplicate link": (
        robot(link("a"), link("b"), link("a")),
        '<string>:4: <link name="a">: duplicate <link>, the first is on line 2',
    ),
    "duplicate joint": (
        robot(link("a", "b", "c"), joint("j", "a", "b"), joint("j", "b", "c")),
        '<string>:4: <joint name="j">: duplicate <joint>, the first is on line 3',
    ),
    "two parents": (
        robot(link("a", "b", "c"), joint("j", "a", "c"), joint("k", "b", "c")),
        '<string>:4: <joint name="k">: link "c" has a parent already, by <joint name="j">',
    ),
    "a cycle": (
        robot(link("a", "b"), joint("j", "a", "b"), joint("k", "b", "a")),
        '<joint name="k">: link "a" is in a cycle',
    ),
    "a link on itself": (robot(link("a"), joint("j", "a", "a")), 'link "a" is in a cycle'),
    "a cycle beside the arm": (
        robot(
            link(*"abcde"),
            joint("j", "a", "b"),
            joint("k", "d", "e"),
            joint("l", "c", "d"),
            joint("m", "d", "c") + joint("n", "d", "c"),
        ),
        "has a parent already",
    ),
    "a cycle with a tail": (
        robot(link(*"abcde"), *(joint(p + c, p, c) for p, c in ("ab", "ec", "de", "ed"))),
        'link "e" is in a cycle',
    ),
    "a link without a name": (robot("<link/>"), "<string>:2: <link>: <link> needs a name"),
    "an empty name": (robot('<link name=""/>'), '<string>:2: <link name="">: <link> needs a name'),
    "a joint without a name": (
        one().replace('name="j" ', ""),
        "<string>:3: <joint>: <joint> needs a name",
    ),
    "no type": (
        one().replace(' type="revolute"', ""),
        '<string>:3: <joint name="j">: <joint> needs a type',
    ),
    "no parent": (one().replace('<parent link="a"/>', ""), '<joint name="j">: <parent> is missing'),
    "no child": (one().replace('<child link="b"/>', ""), '<joint name="j">: <child> is missing'),
    "a parent without a link": (one().replace('<parent link="a"/>', "<parent/>"), "<parent> needs a link"),
}


@pytest.mark.parametrize(("source", "gist"), STRUCTURE.values(), ids=STRUCTURE)
def test_a_broken_structure_is_refused_with_line_and_element(source, gist):
    message = refusal(source)
    assert message.startswith("<string>:") and gist in message


def test_names_may_be_anything_and_are_escaped_in_messages(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the folder's own name may be too long to be shown whole
    name = 'a "b" \u009b31m&#13;&#10;\u202e<é>'
    written = name.replace('"', "&quot;").replace("<", "&lt;")
    chain = read_chain(one().replace('"b"', f'"{written}"'))
    assert chain.tip == name.replace("&#13;&#10;", "\r\n")
    message = refusal(one().replace('"b"', f'"{written}"'), base=chain.tip)
    assert message.isprintable() and r"a \"b\" \x9b31m\r\n\u202e<é>" in message
    file = pathlib.Path("\x1b[31m\n.urdf")
    file.write_text(robot())
    assert refusal(file).isprintable() and r"\x1b[31m\n.urdf:1: " in refusal(file)
    assert len(refusal(robot(link("a" * 10**6, "b")))) < 500


def test_without_defusedxml_the_extra_is_named(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "defusedxml"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=re.escape('pip install "ikjax[urdf]"')):
        read_chain(one())


SWINGING = '<axis xyz="0 1 0"/><origin xyz="0.3 0 0"/>' + LIMIT


def swinging(*names):
    """An arm of parallel revolute joints by these names."""
    links = [f"l{i}" for i in range(len(names) + 1)]
    joints = [joint(name, *links[i : i + 2], inside=SWINGING) for i, name in enumerate(names)]
    return robot(link(*links), *joints)


def test_an_arm_keeps_the_joint_names_of_its_file():
    arm = ikjax.Arm.from_urdf(swinging("shoulder_pan", "elbow", "wrist\u202e"))
    assert arm.joint_names == ("shoulder_pan", "elbow", "wrist\\u202e")
    assert "\n# Joints: shoulder_pan, elbow, wrist\\u202e\narm = " in str(arm)
    exec(str(arm), {})
    changed = dataclasses.replace(arm.astype("float32").baked(), a=arm.a)
    again = jax.tree.unflatten(*jax.tree.flatten(changed)[::-1])
    assert again.joint_names == arm.joint_names
    assert ikjax.robots.planar_2r().joint_names is None


def test_joint_names_part_no_programs():
    first, second = (ikjax.Arm.from_urdf(swinging(*names)) for names in (("a", "b", "c"), ("d", "e", "f")))
    assert first.split()[0] == second.split()[0]
    assert ikjax.Arm.join(*first.split()).joint_names is None


def test_of_joints_that_are_driven_together_the_leader_is_named():
    follow = SWINGING + '<mimic joint="a" multiplier="-1"/>'
    arm = ikjax.Arm.from_urdf(
        robot(
            link("l0", "l1", "l2", "l3", "l4"),
            joint("a", "l0", "l1", inside=SWINGING),
            joint("b", "l1", "l2", inside=follow),
            joint("c", "l2", "l3", inside=SWINGING),
            joint("end", "l3", "l4", "fixed", '<origin xyz="0.2 0 0"/>'),
        )
    )
    assert arm.joint_names == ("a", "c") and arm.n == 2
