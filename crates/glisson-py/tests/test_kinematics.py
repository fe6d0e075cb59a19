"""Robots of other programs: where their tips are, against what follows from how they are built by hand."""

import math
import pickle
import re

import numpy as np
import pytest

from glisson.kinematics import KinematicsError
from glisson.kinematics.inverse import LENGTH_M
from robots import (
    ALL_WAYS,
    ALL_WAYS_OPTIONS,
    PLANAR,
    PLANAR_OPTIONS,
    RCM,
    RCM_MJCF,
    RCM_OPTIONS,
    SAMPLES,
    SIX,
    TROCAR_M,
    joint,
    load,
    mjcf,
    robot,
)


def joints_within(chain, random):
    limits = np.clip(chain.limits, -3.0, 3.0)
    return random.uniform(limits[:, 0], limits[:, 1])


def rotation(axis, angle_rad):
    """As in a book: about a coordinate axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    about = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    return np.array(about[axis])


def tool_axes(pose):
    """Axes of an instrument from its pose, another way than the module does: turned by angles."""
    front, shaft = np.array([0.0, -1.0, 0.0]), pose[3:6]
    axis = np.cross(front, shaft)
    angle_rad = math.acos(np.clip(front @ shaft, -1.0, 1.0))
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 0.0 else np.array([0.0, 0.0, 1.0])

    def turned(v, axis, angle_rad):
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        return v * c + np.cross(axis, v) * s + axis * (axis @ v) * (1.0 - c)

    x = turned(np.array([1.0, 0.0, 0.0]), axis, angle_rad)
    x = turned(x, shaft, pose[6])
    return np.column_stack([x, np.cross(shaft, x), shaft])


def test_a_planar_arm_is_where_its_angles_say(tmp_path):
    chain = load(tmp_path, PLANAR, **PLANAR_OPTIONS)
    assert (chain.joints, chain.units, chain.base, chain.tip) == (("shoulder", "elbow"), ("rad", "rad"), "base", "tip")
    assert chain.limits.tolist() == [[-2.0, 2.0], [0.0, 2.5]]
    for a, b in [(0.0, 0.0), (0.5, 1.2), (-1.9, 2.4), (7.0, -9.0)]:
        frame = chain.frame([a, b])
        assert frame[:3, 3] == pytest.approx([0.3 * math.cos(a) + 0.2 * math.cos(a + b), 0.3 * math.sin(a) + 0.2 * math.sin(a + b), 0.0])
        assert frame[:3, :3] == pytest.approx(rotation("z", a + b))
        assert frame[3].tolist() == [0.0, 0.0, 0.0, 1.0]
        pose = chain.pose([a, b])
        assert pose[3:6] == pytest.approx([-math.cos(a + b), -math.sin(a + b), 0.0])
        assert pose[:3] == pytest.approx(frame[:3, 3]) and pose[7:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("text", [RCM, RCM_MJCF], ids=["URDF", "MJCF"])
def test_a_shaft_goes_through_its_remote_centre(tmp_path, text):
    chain = load(tmp_path, text, **RCM_OPTIONS)
    assert chain.joints == ("yaw", "pitch", "insertion", "roll", "grip")
    assert chain.units == ("rad", "rad", "m", "rad", "rad")
    assert chain.limits[:3] == pytest.approx(np.array([[-1.5, 1.5], [-1.0, 1.0], [0.02, 0.24]]), abs=1e-15)
    assert chain.limits[3].tolist() == [-math.inf, math.inf]
    random = np.random.default_rng(1)
    for _ in range(50):
        a, b, insertion_m, roll, grip = q = joints_within(chain, random)
        pose = chain.pose(q)
        inwards = [math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)]
        assert pose[:3] == pytest.approx(TROCAR_M + insertion_m * np.array(inwards), abs=1e-15)
        assert pose[3:6] == pytest.approx(-np.array(inwards), abs=1e-15)
        assert np.linalg.norm(np.cross(TROCAR_M - pose[:3], pose[3:6])) < 1e-15
        assert chain.frame(q)[:3, :3] == pytest.approx(rotation("x", a) @ rotation("y", b) @ rotation("z", roll), abs=1e-14)
        assert pose[7] == pytest.approx(np.clip((grip + 0.2) / 1.0, 0.0, 1.0))


def test_urdf_and_mjcf_of_one_arm_agree(tmp_path):
    urdf, mjcf = (load(tmp_path, text, **RCM_OPTIONS) for text in (RCM, RCM_MJCF))
    q = np.random.default_rng(2).uniform(-3, 3, (20, 5))
    assert urdf.frame(q) == pytest.approx(mjcf.frame(q), abs=1e-14)
    assert urdf.jacobian(q) == pytest.approx(mjcf.jacobian(q), abs=1e-14)
    assert np.abs(urdf.pose(q) - mjcf.pose(q)).max() < 1e-12


def test_all_ways_of_mjcf_are_those_of_mujoco(tmp_path):
    """Recorded of MuJoCo 4.0.0: MjModel.from_xml_string(ALL_WAYS), qpos = Q[:4] and what the equality makes of q5, mj_kinematics, then
    site_xpos and site_xmat of "tip"."""
    chain = load(tmp_path, ALL_WAYS, **ALL_WAYS_OPTIONS)
    assert chain.joints == ("q1", "q2", "q3", "q4") and chain.units == ("rad", "rad", "m", "rad")
    assert chain.limits.tolist() == [[-1.0, 1.0], [-1.0, 1.0], [-0.1, 0.2], [-math.inf, math.inf]]
    frame = chain.frame([0.4, -0.7, 0.13, 1.1])
    assert frame[:3, 3] == pytest.approx(RECORDED_M, abs=1e-14)
    assert frame[:3, :3].ravel() == pytest.approx(RECORDED_AXES, abs=1e-14)


RECORDED_M = [0.452945689154453, 0.323598385339778, 0.356065295089939]
RECORDED_AXES = [
    *[-0.514407354127103, 0.79104854977628, 0.331100084440938],
    *[-0.00754399205668704, -0.390261338106754, 0.920673218988678],
    *[0.857512776700033, 0.471103258188658, 0.206720966329564],
]


@pytest.mark.parametrize(("text", "options"), SAMPLES.values(), ids=SAMPLES)
def test_jacobians_are_differences_of_frames(tmp_path, text, options):
    chain = load(tmp_path, text, **options)
    n, step = len(chain.joints), 1e-6
    q = np.stack([joints_within(chain, np.random.default_rng(seed)) for seed in range(10)])
    jacobian = chain.jacobian(q)
    assert jacobian.shape == (10, 6, n)
    for k in range(n):
        more, less = chain.frame(q + step * np.eye(n)[k]), chain.frame(q - step * np.eye(n)[k])
        assert jacobian[:, :3, k] == pytest.approx((more - less)[:, :3, 3] / (2 * step), abs=1e-9)
        spin = ((more - less)[:, :3, :3] / (2 * step)) @ np.swapaxes(chain.frame(q)[:, :3, :3], 1, 2)
        assert jacobian[:, 3:, k] == pytest.approx(np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1), abs=1e-9)


@pytest.mark.parametrize(("text", "options"), SAMPLES.values(), ids=SAMPLES)
def test_many_at_once_are_as_one_by_one(tmp_path, text, options):
    chain = load(tmp_path, text, **options)
    q = np.random.default_rng(3).uniform(-1, 1, (2, 3, len(chain.joints)))
    trigger = np.random.default_rng(4).uniform(0, 1, (2, 3))
    assert chain.frame(q).shape == (2, 3, 4, 4) and chain.pose(q).shape == (2, 3, 9)
    for i, j in np.ndindex(2, 3):
        assert chain.frame(q)[i, j] == pytest.approx(chain.frame(q[i, j]), abs=1e-15)
        assert chain.pose(q, trigger=trigger)[i, j] == pytest.approx(chain.pose(q[i, j], trigger=trigger[i, j]), abs=1e-12)
    assert pickle.loads(pickle.dumps(chain)).frame(q).tobytes() == chain.frame(q).tobytes()


# Poses.

#: Shafts, and where jaws open without roll: an instrument from the front (-y) whose jaws open to the left (x), by the shortest turn.
WITHOUT_ROLL = [
    ((0, -1, 0), (1, 0, 0)),
    ((0, 0, 1), (1, 0, 0)),
    ((0, 0, -1), (1, 0, 0)),
    ((1, 0, 0), (0, 1, 0)),
    ((-1, 0, 0), (0, -1, 0)),
    ((0, 1, 0), (-1, 0, 0)),
]


@pytest.mark.parametrize(("shaft", "across"), WITHOUT_ROLL)
@pytest.mark.parametrize("roll_rad", [0.0, 1.0, -3.0])
def test_roll_is_that_of_the_rust_crate(tmp_path, shaft, across, roll_rad):
    """Axes by hand from ToolFrame::of: x is where the jaws open, z the shaft."""
    chain = load(tmp_path, RCM, tip="tip", base="inserted")
    z, x = np.array(shaft, dtype=float), np.array(across, dtype=float)
    x = x * math.cos(roll_rad) + np.cross(z, x) * math.sin(roll_rad)
    # The tip's z axis points out of it: x, -y, -z of the tip are those of the tool.
    base = np.eye(4)
    base[:3, :3] = np.column_stack([x, -np.cross(z, x), -z])
    base[:3, 3] = [1.0, 2.0, 3.0]
    pose = chain.pose([0.0], base=base)
    assert pose == pytest.approx([1.0, 2.0, 3.0, *shaft, roll_rad, 0.0, 0.0], abs=1e-12)


def test_a_pose_says_how_the_tip_lies(tmp_path):
    axes = {"x": (0.3, 0.5, 0.1), "z": (0.2, -0.4, 0.9)}
    chain = load(tmp_path, SIX, shaft_axis=axes["z"], roll_axis=axes["x"])
    z = np.array(axes["z"]) / np.linalg.norm(axes["z"])
    x = np.array(axes["x"]) - z * (z @ axes["x"])
    x /= np.linalg.norm(x)
    random = np.random.default_rng(5)
    for _ in range(30):
        q = joints_within(chain, random)
        base = np.eye(4)
        base[:3, :3] = rotation("x", random.uniform(-3, 3)) @ rotation("y", random.uniform(-3, 3))
        base[:3, 3] = random.uniform(-1, 1, 3)
        tip = base @ chain.frame(q)
        pose = chain.pose(q, base=base, trigger=0.5)
        assert pose[:3] == pytest.approx(tip[:3, 3]) and pose[8] == 0.5
        assert tool_axes(pose) == pytest.approx(tip[:3, :3] @ np.column_stack([x, np.cross(z, x), z]), abs=1e-7)


def test_roll_goes_on_from_where_it_was(tmp_path):
    chain = load(tmp_path, RCM, **RCM_OPTIONS)
    at = chain.pose([0, 0, 0.1, 0, 0])
    seen = []
    for roll in np.linspace(0.0, 20.0, 60):
        at = chain.pose([0.1, 0.2, 0.1, roll, 0], near=at)
        seen.append(at[6])
    assert np.diff(seen) == pytest.approx([-20.0 / 59] * 59)
    assert abs(chain.pose([0.1, 0.2, 0.1, 20.0, 0])[6]) <= math.pi
    q = np.array([[0.1, 0.2, 0.1, roll, 0] for roll in (0.0, 9.0)])
    assert chain.pose(q, near=at)[:, 6] == pytest.approx(at[6], abs=math.pi)


@pytest.mark.parametrize(
    ("options", "of_grip"),
    [
        ({}, {-0.3: 0.0, -0.2: 0.0, 0.3: 0.5, 0.8: 1.0, 0.9: 1.0}),
        ({"jaw_range": (0.0, 0.4)}, {-0.2: 0.0, 0.1: 0.25, 0.4: 1.0, 0.8: 1.0}),
        ({"jaw_range": (0.4, 0.0)}, {-0.2: 1.0, 0.1: 0.75, 0.4: 0.0, 0.8: 0.0}),
    ],
)
def test_jaws_open_as_their_joint_does(tmp_path, options, of_grip):
    chain = load(tmp_path, RCM, **RCM_OPTIONS, **options)
    for grip, opening in of_grip.items():
        assert chain.pose([0, 0, 0.1, 0, grip])[7] == pytest.approx(opening)
    for opening in (0.0, 0.25, 1.0):
        pose = chain.pose([0.1, 0.1, 0.1, 0, 0])
        pose[7] = opening
        q = chain.solve(pose, [0, 0, 0.1, 0, 0])
        assert chain.pose(q)[7] == pytest.approx(opening)


def test_the_joint_of_the_jaws_is_the_last(tmp_path):
    without, chain = (load(tmp_path, RCM, tip="tip", jaw=jaw) for jaw in (None, "pitch"))
    assert chain.joints == ("yaw", "insertion", "roll", "pitch")
    order, q = [0, 2, 3, 1], np.array([0.1, 0.2, 0.1, 0.3])
    assert chain.limits.tolist() == without.limits[order].tolist()
    assert chain.frame(q[order]).tolist() == without.frame(q).tolist()


# Joints that follow others.


def test_urdf_joints_follow(tmp_path):
    links = "".join(f'<link name="l{k}"/>' for k in range(6))
    arm = f"""<robot name="r">{links}
      <joint name="a" type="revolute">
        <parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/><mimic joint="b" multiplier="2" offset="0.5"/>
      </joint>
      <joint name="b" type="revolute">
        <parent link="l1"/><child link="l2"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/>
        <mimic joint="beside" multiplier="-3" offset="0.25"/>
      </joint>
      <joint name="c" type="prismatic">
        <parent link="l2"/><child link="l3"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/>
      </joint>
      <joint name="d" type="revolute">
        <parent link="l3"/><child link="l5"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/><mimic joint="c" multiplier="10"/>
      </joint>
      <joint name="beside" type="continuous"><parent link="l0"/><child link="l4"/><axis xyz="0 0 1"/></joint>
    </robot>"""
    chain = load(tmp_path, arm, tip="l5")
    assert chain.joints == ("beside", "c") and chain.limits.tolist() == [[-math.inf, math.inf], [-1.0, 1.0]]
    beside, c = 0.3, 0.07
    b = -3 * beside + 0.25
    a = 2 * b + 0.5
    d = 10 * c
    frame = chain.frame([beside, c])
    assert frame[:3, 3] == pytest.approx([math.cos(a) + math.cos(a + b), math.sin(a) + math.sin(a + b), c])
    assert frame[:3, :3] == pytest.approx(rotation("z", a + b + d))


@pytest.mark.parametrize(
    ("polycoef", "active", "angles"),
    [
        ("", "true", lambda a: (a, math.radians(10) + (a - math.radians(20)))),
        ('polycoef="0.5 -2"', "true", lambda a: (a, math.radians(10) + 0.5 - 2 * (a - math.radians(20)))),
        ('polycoef="0.5 -2 0 0 0"', "true", lambda a: (a, math.radians(10) + 0.5 - 2 * (a - math.radians(20)))),
        ('polycoef="0.5 -2"', "false", None),
    ],
)
def test_mjcf_joints_follow(tmp_path, polycoef, active, angles):
    """The numbers of a polynomial are rad, also where the compiler's angles are degrees."""
    arm = f"""<mujoco><default><equality active="false"/></default><worldbody>
      <body><joint name="a" ref="20"/><body pos="1 0 0"><joint name="b" ref="10"/><site name="tip" pos="1 0 0"/></body></body></worldbody>
      <equality><joint joint1="b" joint2="a" active="{active}" {polycoef}/></equality></mujoco>"""
    chain = load(tmp_path, arm, tip="tip")
    if angles is None:
        assert chain.joints == ("a", "b")
        return
    assert chain.joints == ("a",)
    a, b = angles(0.7)
    a, b = a - math.radians(20), b - math.radians(10)
    assert chain.frame([0.7])[:3, 3] == pytest.approx([math.cos(a) + math.cos(a + b), math.sin(a) + math.sin(a + b), 0.0])


def test_a_joint_without_a_leader_is_held(tmp_path):
    arm = """<mujoco><compiler angle="radian"/><worldbody>
      <body><joint name="a" ref="0.2"/><body pos="1 0 0"><joint name="b"/><site name="tip" pos="1 0 0"/></body></body></worldbody>
      <equality><joint joint1="a" polycoef="0.3"/></equality></mujoco>"""
    chain = load(tmp_path, arm, tip="tip")
    assert chain.joints == ("b",)
    assert chain.frame([0.0])[:2, 3] == pytest.approx([2 * math.cos(0.3), 2 * math.sin(0.3)])
    assert chain.jacobian([0.0])[:2, 0] == pytest.approx([-math.sin(0.3), math.cos(0.3)])


# What files say.


@pytest.mark.parametrize(
    ("origin", "expected"),
    [
        ('rpy="0.3 -0.5 0.7"', rotation("z", 0.7) @ rotation("y", -0.5) @ rotation("x", 0.3)),
        (f'quat_xyzw="0 0 {math.sin(0.35)} {math.cos(0.35)}"', rotation("z", 0.7)),
        ('quat_xyzw="3 0 0 3"', rotation("x", math.pi / 2)),
        ("", np.eye(3)),
    ],
)
def test_origins_of_urdf(tmp_path, origin, expected):
    joint = f'<joint name="j" type="prismatic"><parent link="a"/><child link="b"/><origin {origin}/><limit upper="1"/></joint>'
    chain = load(tmp_path, f'<robot><link name="a"/><link name="b"/>{joint}</robot>')
    assert chain.limits.tolist() == [[0.0, 1.0]]
    assert chain.frame([0.5])[:3, :3] == pytest.approx(expected)
    assert chain.frame([0.5])[:3, 3] == pytest.approx(expected @ [0.5, 0.0, 0.0]), "without an axis it is x"


X, Y, Z = (lambda angle_rad, axis=axis: rotation(axis, angle_rad) for axis in "xyz")


@pytest.mark.parametrize(
    ("compiler", "orientation", "expected"),
    [
        ("", 'euler="10 20 30"', X(math.radians(10)) @ Y(math.radians(20)) @ Z(math.radians(30))),
        ('angle="radian"', 'euler="0.1 0.2 0.3"', X(0.1) @ Y(0.2) @ Z(0.3)),
        ('angle="radian" eulerseq="XYZ"', 'euler="0.1 0.2 0.3"', Z(0.3) @ Y(0.2) @ X(0.1)),
        ('angle="radian" eulerseq="zxz"', 'euler="0.1 0.2 0.3"', Z(0.1) @ X(0.2) @ Z(0.3)),
        ('angle="radian" eulerseq="xYz"', 'euler="0.1 0.2 0.3"', Y(0.2) @ X(0.1) @ Z(0.3)),
        ("", 'quat="1 0 1 0"', Y(math.pi / 2)),
        ("", 'quat="0 0 0 5"', Z(math.pi)),
        ("", 'axisangle="0 3 0 90"', Y(math.pi / 2)),
        ('angle="radian"', 'axisangle="0 0 -2 0.4"', Z(-0.4)),
        ("", 'xyaxes="0 2 0 0 1 1"', np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])),
        ("", 'zaxis="1 0 0"', Y(math.pi / 2)),
        ("", 'zaxis="0 0 7"', np.eye(3)),
        ("", 'zaxis="0 0 -1"', X(math.pi)),
        ("", "", np.eye(3)),
    ],
)
def test_orientations_of_mjcf(tmp_path, compiler, orientation, expected):
    text = f'<mujoco><compiler {compiler}/><worldbody><body name="b" {orientation}><joint type="slide"/></body></worldbody></mujoco>'
    chain = load(tmp_path, text)
    assert chain.joints == ("b.0",)
    assert chain.frame([0.5])[:3, :3] == pytest.approx(expected, abs=1e-15)
    assert chain.frame([0.5])[:3, 3] == pytest.approx(expected @ [0.0, 0.0, 0.5]), "without an axis it is z"


@pytest.mark.parametrize(
    ("compiler", "joint", "limits"),
    [
        ("", 'range="-90 45"', (-math.pi / 2, math.pi / 4)),
        ('angle="degree"', 'range="-90 45"', (-math.pi / 2, math.pi / 4)),
        ('angle="radian"', 'range="-1 2"', (-1, 2)),
        ("", 'type="slide" range="-1 2"', (-1, 2)),
        ("", "", (-math.inf, math.inf)),
        ("", 'range="0 0"', (-math.inf, math.inf)),
        ("", 'range="-90 45" limited="false"', (-math.inf, math.inf)),
        ('angle="radian"', 'range="-1 1e16"', (-1, math.inf)),
        ('autolimits="false" angle="radian"', 'range="-1 2" limited="true"', (-1, 2)),
    ],
)
def test_ranges_of_mjcf(tmp_path, compiler, joint, limits):
    text = f'<mujoco><compiler {compiler}/><worldbody><body><joint name="j" {joint}/></body></worldbody></mujoco>'
    assert load(tmp_path, text).limits[0] == pytest.approx(limits)


def test_references_and_anchors_of_mjcf(tmp_path):
    text = """<mujoco><worldbody><body name="b" pos="1 0 0">
      <joint name="turn" pos="0.5 0 0" ref="90"/><joint name="slide" type="slide" axis="1 0 0" ref="0.2"/></body></worldbody></mujoco>"""
    chain = load(tmp_path, text)
    assert chain.frame([math.pi / 2, 0.2]) == pytest.approx(np.array([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    # A quarter turn about (1.5, 0), then the slide along what x has become.
    assert chain.frame([math.pi, 0.3])[:3, 3] == pytest.approx([1.5, -0.5 + 0.1, 0.0])


def test_classes_of_mjcf(tmp_path):
    """The nearest class counts: the joint's own, else that of the body around it; classes go on from those around them."""
    text = """<mujoco><compiler angle="radian"/>
      <worldbody>
        <body childclass="outer">
          <joint name="a"/>
          <body childclass="inner"><joint name="b"/><joint name="c" class="outer" range="0 9"/>
            <body><joint name="d"/><joint name="e" class="main"/></body></body>
        </body>
      </worldbody>
      <default>
        <default class="outer"><default class="inner"><joint range="0 3"/></default><joint range="0 2" type="slide"/></default>
      </default>
      <default class="main"><joint range="0 1"/></default>
    </mujoco>"""
    chain = load(tmp_path, text)
    assert chain.joints == tuple("abcde")
    assert chain.limits[:, 1].tolist() == [2.0, 3.0, 9.0, 3.0, 1.0]
    assert chain.units == ("m", "m", "m", "m", "rad")


def test_an_orientation_is_in_the_place_of_that_of_a_class(tmp_path):
    text = """<mujoco><default><site euler="90 0 0" pos="1 0 0"/></default><worldbody>
      <body><joint/><site name="a"/><site name="b" quat="1 0 0 1"/></body></worldbody></mujoco>"""
    assert load(tmp_path, text, tip="a").frame([0.0])[:3, :3] == pytest.approx(rotation("x", math.pi / 2))
    frame = load(tmp_path, text, tip="b").frame([0.0])
    assert frame[:3, :3] == pytest.approx(rotation("z", math.pi / 2)) and frame[:3, 3].tolist() == [1.0, 0.0, 0.0]


def test_other_files_are_included(tmp_path):
    (tmp_path / "parts").mkdir()
    arm = '<x><body name="b" pos="1 0 0"><include file="joint.xml"/><include file="end.xml"/></body></x>'
    (tmp_path / "parts" / "arm.xml").write_text(arm)
    (tmp_path / "parts" / "joint.xml").write_text('<x><joint name="j" axis="1 0 0"/><joint name="k" type="slide" axis="0 1 0"/></x>')
    (tmp_path / "end.xml").write_text('<x><site name="tip" pos="0 0 1"/></x>')
    main = '<mujoco><include file="settings.xml"/><worldbody><include file="parts/arm.xml"/></worldbody></mujoco>'
    (tmp_path / "settings.xml").write_text('<mujocoinclude><compiler angle="radian"/></mujocoinclude>')
    chain = load(tmp_path, main)
    assert (chain.tip, chain.joints) == ("tip", ("j", "k"))
    assert chain.frame([math.pi / 2, 0.5])[:3, 3] == pytest.approx([1.0, -1.0, 0.5])


def test_of_a_site_and_a_body_of_one_name_the_site_is_the_tip(tmp_path):
    text = '<mujoco><worldbody><body name="x"><joint name="j"/><site name="x" pos="1 0 0"/></body></worldbody></mujoco>'
    assert load(tmp_path, text, tip="x").frame([0.0])[0, 3] == 1.0


def test_a_base_leaves_out_what_is_before_it(tmp_path):
    text = mjcf('<freejoint/><body name="c" pos="1 0 0"><joint name="j"/></body>')
    chain = load(tmp_path, text, base="b")
    assert chain.joints == ("j",) and chain.frame([0.0])[:3, 3].tolist() == [1.0, 0.0, 0.0]
    with pytest.raises(KinematicsError, match=r"line 4: freejoint 'b.0': its type is 'free'; .*base="):
        load(tmp_path, text)


# Inverse kinematics.


@pytest.mark.parametrize(
    ("name", "roll"),
    [("planar", False), ("rcm", False), ("rcm", True), ("rcm in MJCF", True), ("six", False), ("six", True), ("jaw on the chain", False)],
)
def test_poses_in_reach_are_reached(tmp_path, name, roll):
    text, options = SAMPLES[name]
    chain = load(tmp_path, text, **options)
    base = np.eye(4)
    base[:3, :3] = rotation("y", 0.5) @ rotation("x", -2.0)
    base[:3, 3] = [0.3, -0.1, 0.2]
    middle = np.nan_to_num(chain.limits, posinf=0.0, neginf=0.0).mean(axis=1)
    for seed in range(20):
        wanted = chain.pose(joints_within(chain, np.random.default_rng(seed)), base=base)
        q = chain.solve(wanted, middle, base=base, roll=roll)
        assert ((q >= chain.limits[:, 0]) & (q <= chain.limits[:, 1])).all(), seed
        got = chain.pose(q, base=base, near=wanted)
        assert np.linalg.norm(got[:3] - wanted[:3]) < 1e-6, seed
        assert np.linalg.norm(np.cross(got[3:6], wanted[3:6])) < 1e-6 and got[3:6] @ wanted[3:6] > 0.0, seed
        if roll:
            assert got[6] == pytest.approx(wanted[6], abs=1e-6), seed
        assert got[7] == pytest.approx(wanted[7]), seed
    assert chain.solve(wanted, middle, base=base, roll=roll).tobytes() == q.tobytes()


def test_a_solution_stays_near_where_it_started(tmp_path):
    """Led along a way in small steps, joints do not jump: not to the other elbow, and no whole turns."""
    chain = load(tmp_path, SIX)
    q = start = np.array([0.2, 0.5, 0.1, 0.3, 0.6, 4.0])
    for share in np.linspace(0.0, 1.0, 40):
        target = chain.pose(start + share * np.array([0.4, -0.3, 0.1, 0.5, 0.3, 1.0]))
        after = chain.solve(target, q, roll=True, n_starts=1)
        assert np.abs(after - q).max() < 0.1
        q = after
    assert q == pytest.approx(start + [0.4, -0.3, 0.1, 0.5, 0.3, 1.0], abs=1e-4)


@pytest.mark.parametrize("roll", [False, True])
def test_half_a_turn_is_no_dead_end(tmp_path, roll):
    chain = load(tmp_path, robot(joint(more='<axis xyz="0 0 1"/>'), "ab"), shaft_axis=(-1, 0, 0))
    q = chain.solve(chain.pose([math.pi]), [0.0], roll=roll, n_starts=1)
    assert abs(q[0]) == pytest.approx(math.pi, abs=1e-6)


def test_limits_hold_and_what_is_out_of_reach_is_told(tmp_path):
    chain = load(tmp_path, RCM, **RCM_OPTIONS)
    q0 = np.array([0.0, 0.0, 0.1, 0.0, 0.0])
    # 50 mm deeper than its insertion goes.
    with pytest.raises(KinematicsError) as told:
        chain.solve(chain.pose([0.3, -0.4, 0.29, 0.0, 0.0]), q0, n_starts=4)
    assert re.search(r"the closest that it comes is 5\d\.?\d* mm and [\d.e-]+ degrees away, with insertion at a limit", str(told.value))
    # A shaft that does not go through the trocar: the tip would be there.
    beside = chain.pose([0.3, -0.4, 0.2, 0.0, 0.0])
    beside[3:6] = [0.0, 0.0, -1.0]
    with pytest.raises(KinematicsError, match=r"is \d[\d.]* mm and \d[\d.]* degrees away; move"):
        chain.solve(beside, q0, n_starts=4)
    # The planar arm's elbow turns one way only.
    arm = load(tmp_path, PLANAR, **PLANAR_OPTIONS)
    with pytest.raises(KinematicsError, match="elbow at a limit"):
        arm.solve(arm.pose([0.5, -0.5]), [0.0, 0.1])
    q = arm.solve(arm.pose([0.5, 0.0]), [-1.0, 2.0])
    assert q == pytest.approx([0.5, 0.0], abs=1e-6) and q[1] >= 0.0
    # From q0 the shoulder goes to the wrong limit: the best of all ends is told.
    with pytest.raises(KinematicsError, match=r"is 106\.?\d* mm and 29\.\d* degrees away, with shoulder at a limit"):
        arm.solve(arm.pose([2.6, 0.0]), [-1.0, 1.0], n_starts=4)
    # A joint that turns about the shaft only, where roll is free, moves nothing.
    roll = load(tmp_path, RCM, tip="tip", base="inserted")
    with pytest.raises(KinematicsError, match="is 1000 mm and 0 degrees away"):
        roll.solve(roll.pose([0.0]) + np.eye(9)[0], [0.5])


@pytest.mark.parametrize("beyond", [(0.5, -0.5), (0.9, -1.2), (-0.3, -0.2)])
def test_what_is_told_is_the_closest_that_there_is(tmp_path, beyond):
    """The elbow stays at its limit, 0: the shoulder's best angle is looked for by trying all, then all around the best of them."""
    chain = load(tmp_path, PLANAR, **PLANAR_OPTIONS)
    target = chain.pose(beyond)
    shoulders = np.linspace(-2.0, 2.0, 2001)
    for _ in range(2):
        poses = chain.pose(np.column_stack([shoulders, np.zeros_like(shoulders)]))
        missing_m = np.linalg.norm(poses[:, :3] - target[:3], axis=1)
        missing_rad = np.arccos(np.clip(poses[:, 3:6] @ target[3:6], -1.0, 1.0))
        best = np.argmin((missing_m / LENGTH_M) ** 2 + missing_rad**2)
        shoulders = shoulders[best] + np.linspace(-2e-3, 2e-3, 2001)
    with pytest.raises(KinematicsError) as told:
        chain.solve(target, [-1.0, 1.0])
    mm, degrees = (float(number) for number in re.findall(r"([\d.]+) (?:mm|degrees)", str(told.value)))
    assert mm == pytest.approx(1e3 * missing_m[best], rel=1e-3)
    assert degrees == pytest.approx(math.degrees(missing_rad[best]), rel=1e-3)


def test_a_pose_close_by_takes_few_steps(tmp_path):
    """Close to the solution each step squares what is missing, nearly."""
    chain = load(tmp_path, SIX)
    q = np.array([0.2, 0.5, 0.1, 0.3, 0.6, 1.0])
    closely = {"roll": True, "n_starts": 1, "tolerance_m": 1e-12, "tolerance_rad": 1e-12}
    assert chain.solve(chain.pose(q + 0.1), q, max_iterations=5, **closely) == pytest.approx(q + 0.1, abs=1e-11)
    with pytest.raises(KinematicsError):
        chain.solve(chain.pose(q + 0.1), q, max_iterations=2, **closely)


def test_roll_counts_only_when_it_is_asked_for(tmp_path):
    chain = load(tmp_path, RCM, **RCM_OPTIONS)
    wanted = chain.pose([0.2, 0.3, 0.1, 2.0, -0.2])
    assert chain.solve(wanted, [0, 0, 0.1, 0.5, 0])[3] == pytest.approx(0.5, abs=0.1)
    assert chain.solve(wanted, [0, 0, 0.1, 0.5, 0], roll=True) == pytest.approx([0.2, 0.3, 0.1, 2.0, -0.2], abs=1e-5)
