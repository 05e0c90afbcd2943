"""Arms of MuJoCo models, against MuJoCo's own kinematics."""

import numpy as np
import pytest

import ikjax

mujoco = pytest.importorskip("mujoco")

GEOM = '<geom size="0.01"/>'
PANDA = f"""
<mujoco model="panda">
  <compiler angle="radian"/>
  <default><default class="arm"><joint axis="0 0 1" range="-2.8 2.8"/></default></default>
  <worldbody><body name="base" pos="0.1 0 0.2" euler="0 0 0.5"><site name="foot"/>
    <body name="l1" pos="0 0 0.333"><joint name="j1" class="arm" ref="0.3"/>{GEOM}
    <body name="l2" quat="1 -1 0 0"><joint name="j2" class="arm"/>{GEOM}
    <body name="l3" pos="0 -0.316 0" quat="1 1 0 0"><joint name="j3" class="arm"/>{GEOM}
    <body name="l4" pos="0.0825 0 0" quat="1 1 0 0"><joint name="j4" class="arm" range="-3 -0.07"/>{GEOM}
    <body name="l5" pos="-0.0825 0.384 0" quat="1 -1 0 0"><joint name="j5" class="arm"/>{GEOM}
    <body name="l6" quat="1 1 0 0"><joint name="j6" class="arm"/>{GEOM}
    <body name="l7" pos="0.088 0 0" quat="1 1 0 0"><joint name="j7" axis="0 0 1"/>{GEOM}
      <site name="attachment_site" pos="0 0 0.107"/>
      <body name="hand" pos="0 0 0.107">{GEOM}
        <body name="left"><joint name="f1" type="slide" axis="0 1 0" range="0 0.04"/>{GEOM}</body>
        <body name="right"><joint name="f2" type="slide" axis="0 -1 0" range="0 0.04"/>{GEOM}</body>
      </body>
    </body></body></body></body></body></body></body>
  </body></worldbody>
  <tendon><fixed name="split"><joint joint="f1" coef="0.5"/><joint joint="f2" coef="0.5"/></fixed></tendon>
  <equality><joint name="grip" joint1="f1" joint2="f2"/></equality>
</mujoco>
"""


def site_pose(model, joints, q, site):
    """Where MuJoCo puts a site in the world."""
    data = mujoco.MjData(model)
    for name, value in zip(joints, q, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site(site).xmat.reshape(3, 3), data.site(site).xpos
    return T


def panda(**options):
    return ikjax.Arm.from_mujoco(PANDA, site="attachment_site", **options)


def test_the_arm_stands_where_mujoco_puts_it(rng):
    arm, model = panda(), mujoco.MjModel.from_xml_string(PANDA)
    assert (arm.family, arm.name, arm.redundant) == ("pieper_reversed", "panda", ("j7",))
    for q in rng.uniform(-2, 2, (5, 7)):
        expected = site_pose(model, arm.joint_names, q, "attachment_site")
        np.testing.assert_allclose(ikjax.fk(arm, q), expected, atol=1e-12)


def test_ranges_are_those_of_the_defaults_and_of_the_joint():
    limits = np.asarray(panda().limits)
    np.testing.assert_allclose(limits[0], [-2.8, 2.8])
    np.testing.assert_allclose(limits[3], [-3, -0.07])
    assert np.isinf(limits[6]).all()


def test_every_branch_of_a_panda_is_answered_in_mujocos_joint_values(rng):
    arm, model = panda(), mujoco.MjModel.from_xml_string(PANDA)
    q = np.array([0.2, -0.5, 0.1, -1.9, 0.3, 1.6, 0.4])
    goal = site_pose(model, arm.joint_names, q, "attachment_site")
    sol = ikjax.solve(arm, goal, redundancy=q[6:])
    assert sol.valid.sum() >= 2
    for answer in np.asarray(sol.q)[np.asarray(sol.valid)]:
        reached = site_pose(model, arm.joint_names, answer, "attachment_site")
        np.testing.assert_allclose(reached, goal, atol=1e-8)


def test_the_tip_is_guessed_without_the_fingers_and_said():
    with pytest.warns(UserWarning) as seen:
        arm = ikjax.load(PANDA)
    (said,) = [str(w.message) for w in seen]
    assert 'guessed: site "attachment_site", after 7 joints (j1, j2, j3, j4, j5, j6, j7)' in said
    assert "left out as a gripper's or another branch's: f1, f2. site= overrules it" in said
    np.testing.assert_array_equal(ikjax.fk(arm, np.ones(7)), ikjax.fk(panda(), np.ones(7)))


def test_a_file_text_a_spec_and_a_compiled_model_are_the_same_arm(tmp_path):
    file = tmp_path / "panda.xml"
    file.write_text(PANDA)
    binary = tmp_path / "panda.mjb"
    compiled = mujoco.MjModel.from_xml_string(PANDA)
    mujoco.mj_saveModel(compiled, str(binary), None)
    sources = [PANDA, file, str(file), compiled, mujoco.MjSpec.from_string(PANDA), binary]
    arms = [ikjax.load(source, site="attachment_site") for source in sources]
    for arm in arms[1:]:
        for leaf in ("a", "alpha", "d", "theta", "base", "tool", "limits"):
            np.testing.assert_array_equal(getattr(arm, leaf), getattr(arms[0], leaf))


def test_a_body_may_be_the_tip_and_another_the_base(rng):
    arm = ikjax.Arm.from_mujoco(PANDA, body="hand", base="base")
    model = mujoco.MjModel.from_xml_string(PANDA)
    q = rng.uniform(-2, 2, 7)
    foot = site_pose(model, arm.joint_names, q, "foot")
    expected = np.linalg.inv(foot) @ site_pose(model, arm.joint_names, q, "attachment_site")
    np.testing.assert_allclose(ikjax.fk(arm, q), expected, atol=1e-12)


def test_a_frozen_joint_is_held_at_mujocos_value(rng):
    arm, q = panda(fixed_joints={"j1": 0.7, "j3": 0.2}), rng.uniform(-2, 2, 5)
    assert arm.joint_names == ("j2", "j4", "j5", "j6", "j7")
    names, values = ("j1", "j3", *arm.joint_names), (0.7, 0.2, *q)
    expected = site_pose(mujoco.MjModel.from_xml_string(PANDA), names, values, "attachment_site")
    np.testing.assert_allclose(ikjax.fk(arm, q), expected, atol=1e-12)


SCARA = """
<mujoco model="scara"><compiler angle="radian"/><worldbody>
  <body name="one"><joint name="a" axis="0 0 1"/><geom size="0.01"/>
  <body name="two" pos="0.3 0 0"><joint name="b" axis="0 0 1"/><geom size="0.01"/>
  <body name="three" pos="0.2 0 0.1">
    <joint name="slide" type="slide" axis="0 0 -1" range="0 0.2" ref="0.05"/>
    <joint name="turn" axis="0 0 -1" pos="0.01 0 0"/><geom size="0.01"/>
    <site name="tip" pos="0.03 0 0"/>
  </body></body></body>
</worldbody></mujoco>
"""


def test_two_joints_of_one_body_slides_and_references_count(rng):
    arm, model = ikjax.Arm.from_mujoco(SCARA, site="tip"), mujoco.MjModel.from_xml_string(SCARA)
    assert arm.kinds == "RRPR" and arm.joint_names == ("a", "b", "slide", "turn")
    for q in rng.uniform(-1, 1, (4, 4)):
        np.testing.assert_allclose(ikjax.fk(arm, q), site_pose(model, arm.joint_names, q, "tip"), atol=1e-12)


def with_(inside, model=SCARA):
    return model.replace("</mujoco>", f"{inside}</mujoco>")


BALL = SCARA.replace('name="b" axis="0 0 1"', 'name="b" type="ball"')
FREE = SCARA.replace('<joint name="a" axis="0 0 1"/>', "<freejoint/>")
REFUSED = {
    "joints": (
        with_('<equality><joint name="eq" joint1="b" joint2="a"/></equality>'),
        {},
        'equality "eq" couples joint "b" to "a"',
    ),
    "one joint": (with_('<equality><joint name="eq" joint1="b"/></equality>'), {}, 'couples joint "b"'),
    "bodies": (
        with_('<equality><connect name="loop" body1="two" body2="world" anchor="0 0 0"/></equality>'),
        {},
        'equality "loop" couples bodies "two" and "world"',
    ),
    "tendon": (
        with_(
            '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>'
        ),
        {},
        'tendon "t" couples joints "a", "b"',
    ),
    "tendon equality": (
        with_(
            '<tendon><fixed name="t"><joint joint="a" coef="1"/></fixed></tendon>'
            '<equality><tendon name="eq" tendon1="t"/></equality>'
        ),
        {},
        'equality "eq" couples tendon "t"',
    ),
    "a tendon with a range": (
        with_(
            '<tendon><spatial name="rope" range="0 1"><site site="tip"/><site site="anchor"/></spatial>'
            "</tendon>"
        ).replace("<worldbody>", '<worldbody><site name="anchor"/>'),
        {},
        'tendon "rope" has a range',
    ),
    "ball": (BALL, {}, 'joint "b" of body "two" is ball, not hinge or slide: choose base='),
    "free": (FREE, {}, "is free, not hinge or slide"),
    "no site": (SCARA, {"site": "tipp"}, 'site="tipp" is none of "tip"'),
    "no body": (SCARA, {"site": None, "body": "four"}, 'body="four" is none of "world", "one"'),
    "not below": (SCARA, {"site": None, "body": "one", "base": "two"}, 'body "one" is not below base "two"'),
    "frozen": (SCARA, {"fixed_joints": {"c": 0.0}}, 'fixed_joints names "c", no joint of the chain'),
    "too far": (
        SCARA,
        {"fixed_joints": {"slide": 1.0}},
        'holds joint "slide" at 1, outside its limits 0 to 0.2',
    ),
    "all": (SCARA, {"fixed_joints": dict.fromkeys(["a", "b", "slide", "turn"], 0.0)}, "no moving joint"),
    "broken": ("<mujoco><worldbody>", {}, "MuJoCo cannot read the model"),
}


@pytest.mark.parametrize(("text", "options", "gist"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_chain_is_refused_by_name(text, options, gist):
    with pytest.raises(ikjax.ArmFileError) as error:
        ikjax.Arm.from_mujoco(text, **{"site": "tip", **options})
    assert gist in str(error.value)


ALLOWED = {
    "switched off": '<equality><joint joint1="b" joint2="a" active="false"/></equality>',
    "a tendon of one joint": '<tendon><fixed><joint joint="a" coef="1"/></fixed></tendon>',
    "a weld to a mocap body": '<equality><weld body1="three" body2="hand"/></equality>',
    "a rope without a range": '<tendon><spatial><site site="tip"/><site site="anchor"/></spatial></tendon>',
}


@pytest.mark.parametrize("inside", ALLOWED.values(), ids=ALLOWED)
def test_what_couples_nothing_is_no_obstacle(inside):
    text = with_(inside).replace(
        "<worldbody>", '<worldbody><site name="anchor"/><body name="hand" mocap="true"/>'
    )
    assert ikjax.Arm.from_mujoco(text, site="tip").n == 4


def test_a_coupled_joint_that_is_frozen_is_taken():
    text = with_('<equality><joint joint1="turn" joint2="b"/></equality>')
    held = ikjax.Arm.from_mujoco(text, site="tip", fixed_joints={"turn": 0.0, "b": 0.0})
    assert held.joint_names == ("a", "slide")


def test_a_site_and_a_body_are_not_taken_together():
    with pytest.raises(ValueError, match="give one"):
        ikjax.Arm.from_mujoco(SCARA, site="tip", body="three")


def test_a_file_that_is_not_there_is_said():
    with pytest.raises(FileNotFoundError, match=r"no such file: nowhere\.xml"):
        ikjax.Arm.from_mujoco("nowhere.xml")


def test_an_arm_on_a_free_base_is_taken_from_its_own_body(rng):
    text = SCARA.replace(
        '<body name="one">', '<body name="cart"><freejoint/><geom size="0.1"/><body name="one">'
    )
    text = text.replace("</worldbody>", "</body></worldbody>")
    arm, still = (
        ikjax.Arm.from_mujoco(text, site="tip", base="cart"),
        ikjax.Arm.from_mujoco(SCARA, site="tip"),
    )
    q = rng.uniform(-1, 1, 4)
    np.testing.assert_allclose(ikjax.fk(arm, q), ikjax.fk(still, q), atol=1e-12)
