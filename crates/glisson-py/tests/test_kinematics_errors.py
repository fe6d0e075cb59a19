"""Robots of other programs: what is wrong with files and numbers is told, and damaged files are read or refused."""

import math
import random
import re
import warnings

import numpy as np
import pytest

from glisson.kinematics import Chain, KinematicsError
from glisson.kinematics.xml import MAX_DEPTH
from robots import PLANAR, PLANAR_OPTIONS, RCM, RCM_OPTIONS, SAMPLES, joint, load, mjcf, robot

TWO_JOINTS = '<joint name="a"/><joint name="b"/>'


def led(polycoef="", joint2="b", more=""):
    return mjcf(TWO_JOINTS, f'<equality><joint joint1="a" joint2="{joint2}" {polycoef}/>{more}</equality>')


ERRORS = {
    # Files.
    "no XML": ("<robot>\n<link name='a'>\n</robot>", {}, "robot.xml: line 3: it is no XML: mismatched tag"),
    "empty": ("", {}, "line 1: it is no XML: no element found"),
    "another kind": ("<sdf/>", {}, "the file is <sdf>; <robot> (URDF) and <mujoco> (MJCF) are allowed"),
    "document type": ('<!DOCTYPE robot SYSTEM "x.dtd">\n<robot/>', {}, "line 1: it declares a document type"),
    "laughs": ('<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>\n<robot name="&b;"/>', {}, "take <!DOCTYPE ...> out"),
    "too deep": ("<robot>" + "<x>" * MAX_DEPTH + "</x>" * MAX_DEPTH + "</robot>", {}, f"more than {MAX_DEPTH} deep"),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><robot/>', {}, "line 1"),
    "xacro": ('<robot xmlns:xacro="x"><xacro:arm name="n"/></robot>', {}, "xacro:arm 'n': the file is a xacro"),
    # Names.
    "unknown tip": (PLANAR, {"tip": "tipp"}, "there is no link 'tipp', probably 'tip' is meant; there are base, upper, lower, tip"),
    "unknown base": (PLANAR, {"base": "bose"}, "there is no link 'bose', probably 'base' is meant"),
    "unknown jaw": (PLANAR, {"jaw": "elbou"}, "there is no joint 'elbou', probably 'elbow' is meant; there are shoulder, elbow, end"),
    "several ends": (RCM, {}, "the robot has 3 ends: "),
    "base beyond the tip": (PLANAR, {"base": "tip", "tip": "lower"}, "'lower' is not on 'tip'; as base= one of these is"),
    "nothing moves": (PLANAR, {"base": "lower"}, "no joint between lower and tip moves"),
    "jaw that follows": (RCM, {"tip": "tip", "jaw": "grip_right"}, "'grip_right': it is to open the jaws (jaw=), and follows 'grip'"),
    "jaw without a range": (RCM, {"tip": "tip", "jaw": "roll"}, "its limits are -inf and inf; a finite range is needed"),
    "jaw that is fixed": (RCM, {"tip": "tip", "jaw": "end"}, "joint 'end': its type is 'fixed'"),
    "jaw range": (RCM, {**RCM_OPTIONS, "jaw_range": (1, 1)}, "jaw_range is (1, 1); two different numbers"),
    "shaft axis": (PLANAR, {"shaft_axis": (0, 0, 0)}, "shaft_axis is (0, 0, 0); three numbers are expected that are not all 0"),
    "roll axis": (PLANAR, {"roll_axis": (0, 0, 2)}, "roll_axis is (0, 0, 2), along the shaft (0.0, 0.0, -1.0)"),
    # URDF.
    "no links": ("<robot/>", {}, "it has no link"),
    "two links of a name": (robot(joint(), "abb"), {}, "line 2: link 'b': another one in line 2 has the same name"),
    "two joints of a name": (robot(joint() + joint(child="c")), {}, "joint 'j': another one in line 3 has the same name"),
    "no name": (robot('<joint type="fixed"/>'), {}, "line 3: joint: it has no name; give it one"),
    "no parent": (robot('<joint name="j"><child link="b"/></joint>'), {}, "it has no parent; give it: <parent link="),
    "missing link": (robot(joint(child="d")), {}, "joint 'j': its child: there is no link 'd'; there are a, b, c"),
    "two parents": (robot(joint() + joint("k", "c", "b")), {}, "joint 'k': its child 'b' has a parent already, by joint 'j'"),
    "two roots": (robot(joint()), {}, "it has 2 links without a parent: a, c; one is expected"),
    "ring": (robot(joint() + joint("k", "b", "a"), "ab"), {}, "links carry each other in a ring: a, b"),
    "ring beside": (robot(joint() + joint("k", "c", "d") + joint("l", "d", "c"), "abcd"), {}, "links carry each other in a ring: c, d"),
    "floating": (robot(joint(kind="floating"), "ab"), {}, "joint 'j': its type is 'floating'; revolute, continuous, prismatic"),
    "planar": (robot(joint(kind="planar"), "ab"), {}, "joint 'j': its type is 'planar'"),
    "no limit": (robot(joint(kind="revolute"), "ab"), {}, "it is revolute and has no limit; give <limit lower= upper=>"),
    "limits": (robot(joint(kind="prismatic", more='<limit lower="1" upper="0"/>'), "ab"), {}, "its limits are 1 to 0; lower must not"),
    "zero axis": (robot(joint(more='<axis xyz="0 0 0"/>'), "ab"), {}, "axis: xyz is '0 0 0', which has no direction"),
    "two numbers": (robot(joint(more='<origin xyz="0 0"/>'), "ab"), {}, "line 3: origin: xyz is '0 0'; 3 numbers are expected"),
    "no number": (robot(joint(more='<origin xyz="0 0 ${x}"/>'), "ab"), {}, "xyz has '${x}'; 3 numbers are expected"),
    "not finite": (robot(joint(more='<origin rpy="0 nan 0"/>'), "ab"), {}, "rpy has 'nan'; 3 numbers are expected, finite"),
    "too large": (robot(joint(more='<origin xyz="0 1e400 0"/>'), "ab"), {}, "xyz has '1e400'"),
    "far away": (robot(joint(more='<origin xyz="0 1e7 0"/>'), "ab"), {}, "xyz has '1e7'"),
    "limit that is not finite": (robot(joint(kind="prismatic", more='<limit upper="inf"/>'), "ab"), {}, "upper has 'inf'; a number is"),
    "limit that is too large": (robot(joint(kind="prismatic", more='<limit upper="1e400"/>'), "ab"), {}, "upper has '1e400'; a number is"),
    "rpy and quaternion": (robot(joint(more='<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>'), "ab"), {}, "give one of them"),
    "mimic of nothing": (robot(joint(more="<mimic/>"), "ab"), {}, "its mimic names no joint"),
    "mimic of none": (robot(joint(more='<mimic joint="k"/>'), "ab"), {}, "joint 'j': it follows another: there is no joint 'k'"),
    "mimic of itself": (robot(joint(more='<mimic joint="j"/>'), "ab"), {}, "joints follow each other in a ring: j, j"),
    "mimic in a ring": (
        robot(joint(more='<mimic joint="k"/>') + joint("k", "b", "c", more='<mimic joint="j"/>')),
        {},
        "joints follow each other in a ring: j, k, j",
    ),
    "mimic by too much": (
        robot(joint(more='<mimic joint="k" multiplier="1e4"/>') + joint("k", "b", "c", more='<mimic joint="j" multiplier="1e4"/>')),
        {},
        "joint 'k': a joint follows by 1e+08 times, 0 more; at most 1e+06 is allowed",
    ),
    "mimic of a fixed joint": (
        robot(joint(more='<mimic joint="k"/>') + joint("k", "a", "c", "fixed")),
        {"tip": "b"},
        "joint 'k': its type is 'fixed'",
    ),
    # MJCF.
    "ball": (mjcf('<joint name="j" type="ball"/>'), {}, "line 4: joint 'j': its type is 'ball'; hinge and slide are allowed"),
    "type": (mjcf('<joint name="j" type="Hinge"/>'), {}, "type is 'Hinge'; hinge, slide, ball, free are allowed"),
    "joint in the world": ('<mujoco><worldbody><joint name="j"/></worldbody></mujoco>', {}, "joint 'j': it is in the world"),
    "no body": ("<mujoco/>", {}, "no joint between world and world moves"),
    "body named world": ('<mujoco><worldbody><body name="world"/></worldbody></mujoco>', {}, "only the world has this name"),
    "two bodies of a name": (mjcf('<body name="b"/>'), {}, "line 4: body 'b': another one in line 3 has the same name"),
    "two orientations": (mjcf('<body quat="1 0 0 0" euler="0 0 0"><joint/></body>'), {}, "it has quat and euler; one of them is allowed"),
    "zero quaternion": (mjcf('<body quat="0 0 0 0"><joint/></body>'), {}, "quat is '0 0 0 0', which has no direction"),
    "parallel axes": (mjcf('<body xyaxes="1 0 0 2 0 0"><joint/></body>'), {}, "xyaxes is '1 0 0 2 0 0', which has no direction"),
    "angle": (mjcf("<joint/>", '<compiler angle="Radian"/>'), {}, "line 2: compiler: angle is 'Radian'; degree, radian are allowed"),
    "coordinate": (mjcf("<joint/>", '<compiler coordinate="global"/>'), {}, "open the file in MuJoCo 2.3.3 and save it"),
    "eulerseq": (mjcf("<joint/>", '<compiler eulerseq="xyw"/>'), {}, "eulerseq is 'xyw'; three letters"),
    "range": (mjcf('<joint range="2 1"/>', '<compiler angle="radian"/>'), {}, "joint 'b.0': its range is 2 to 1"),
    "limited without a range": (mjcf('<joint limited="true"/>'), {}, "its range is 0 to 0"),
    "range with autolimits off": (mjcf('<joint range="0 1"/>', '<compiler autolimits="false"/>'), {}, "autolimits is off; say whether"),
    "class": (mjcf('<joint class="arn"/>', '<default><default class="arm"/></default>'), {}, "no class 'arn', probably 'arm' is meant"),
    "childclass": (mjcf('<body childclass="x"/>'), {}, "there is no class 'x'; there are main"),
    "class twice": (mjcf("", '<default><default class="x"/><default class="x"/></default>'), {}, "its class is 'x'; each needs a name"),
    "class without a name": (mjcf("", "<default><default/></default>"), {}, "its class is ''; each needs a name"),
    "outermost class": (mjcf("", '<default class="x"/>'), {}, "its class is 'x'; the outermost one is 'main'"),
    "replicate": (mjcf('<replicate count="2"/>'), {}, "open the file in MuJoCo and save it"),
    "site from here to there": (mjcf('<joint/><site name="s" fromto="0 0 0 1 0 0"/>'), {}, "site 's': it has fromto"),
    "unknown site": (mjcf('<joint/><site name="s"/>'), {"tip": "t"}, "there is no body or site 't'; there are world, b, s"),
    "ends without names": (mjcf("<joint/><body/><body/>"), {}, "2 ends: a body without a name in line 4, a body without a name in line 4"),
    "polynomial": (led('polycoef="0 1 2"'), {}, "the equality in line 2 leads it by the polynomial [0.0, 1.0, 2.0, 0.0, 0.0]"),
    "led twice": (led(more='<joint joint1="a" joint2="b"/>'), {}, "the equalities in lines 2, 2 all lead it"),
    "led by nobody": (led(joint2="x"), {}, "the equality in line 2: there is no joint 'x'; there are a, b"),
    "led in a ring": (led(more='<joint joint1="b" joint2="a"/>'), {}, "joints follow each other in a ring: a, b, a"),
    "jaw that is held": (mjcf(TWO_JOINTS, '<equality><joint joint1="a"/></equality>'), {"jaw": "a"}, "and is held in one place"),
    "include of nothing": (mjcf("<include/>"), {}, "line 4: include: it names no file"),
    "include of none": (mjcf('<include file="none.xml"/>'), {}, "there is no such file"),
    "include of itself": (mjcf('<include file="robot.xml"/>'), {}, "'robot.xml' is included already"),
}


@pytest.mark.parametrize(("text", "options", "told"), ERRORS.values(), ids=ERRORS)
def test_what_is_wrong_is_told(tmp_path, text, options, told):
    with pytest.raises(KinematicsError, match=re.escape(told)) as error:
        load(tmp_path, text, **options)
    assert "_axis" in told or "jaw_range" in told or str(tmp_path / "robot.xml") in str(error.value)


def test_a_file_that_is_not_there_is_told(tmp_path):
    for path in (tmp_path / "none.urdf", tmp_path, "nul\0"):
        with pytest.raises(KinematicsError, match="there is no such file"):
            Chain.load(path)
    (tmp_path / "bad.xml").write_text("<x>")
    with pytest.raises(KinematicsError, match=r"bad.xml: line 1: it is no XML"):
        load(tmp_path, mjcf('<include file="bad.xml"/>'))


MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("do", "told"),
    [
        (lambda chain: chain.frame([0.0]), r"q has the shape \(1,\); \(..., 2\) is expected: one number for each of shoulder, elbow"),
        (lambda chain: chain.frame(0.0), r"q has the shape \(\)"),
        (lambda chain: chain.frame([0.0, math.nan]), "q has a number that is not finite"),
        (lambda chain: chain.frame(["a", "b"]), r"q is \['a', 'b'\]; numbers are expected"),
        (lambda chain: chain.jacobian([[0.0]]), "q has the shape"),
        (lambda chain: chain.pose([0, 0], base=np.eye(3)), r"base has the shape \(3, 3\)"),
        (lambda chain: chain.pose([0, 0], base=2.0 * np.eye(4)), "base has the last row"),
        (lambda chain: chain.pose([0, 0], base=np.diag([2.0, 1.0, 1.0, 1.0])), "base stretches or shears"),
        (lambda chain: chain.pose([0, 0], base=MIRROR), "base mirrors"),
        (lambda chain: chain.pose([0, 0], trigger=2.0), "trigger is 2.0; a number from 0 to 1"),
        (lambda chain: chain.pose([0, 0], near=np.zeros(8)), r"near has the shape \(8,\)"),
        (lambda chain: chain.pose([0, 0], near=np.zeros((3, 9))), r"near has the shape \(3, 9\)"),
        (lambda chain: chain.solve(np.zeros(9), [0, 0]), "has no direction"),
        (lambda chain: chain.solve(np.zeros((2, 9)), [0, 0]), "one at a time"),
        (lambda chain: chain.solve(chain.pose([0, 0]), [0, 0], n_starts=0), "n_starts is 0"),
    ],
)
def test_numbers_of_a_wrong_shape_are_told(tmp_path, do, told):
    with pytest.raises(KinematicsError, match=told):
        do(load(tmp_path, PLANAR, **PLANAR_OPTIONS))


def survives(tmp_path, text, options):
    """Whether it is read; nothing but a KinematicsError may come of it, no warning either, and what is read is finite."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            chain = load(tmp_path, text, **options)
        except KinematicsError:
            return False
        q = np.clip(np.zeros(len(chain.joints)), chain.limits[:, 0], chain.limits[:, 1])
        assert np.isfinite(chain.pose(q)).all() and np.isfinite(chain.jacobian(q)).all()
        return True


FUZZED = {name: SAMPLES[name] for name in ("rcm", "rcm in MJCF", "six", "all ways")}


@pytest.mark.parametrize(("text", "options"), FUZZED.values(), ids=FUZZED)
def test_damaged_files_are_read_or_refused(tmp_path, text, options):
    chance = random.Random(7)
    read = 0
    for _ in range(100):
        damaged = bytearray(text.encode())
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(damaged))
            if chance.random() < 0.5:
                damaged[at] ^= 1 << chance.randrange(8)
            else:
                del damaged[at : at + chance.choice([1, 1, 2, 20])]
        read += survives(tmp_path, bytes(damaged), options)
    assert 0 < read < 100


JUNK = [
    *["", " ", "nan", "-inf", "1e999", "1e308 1e308 1e308", "1e6 -1e6 1e6", "1e-300 0 0", "1e16", "0", "0 0 0", "0 0 0 0", "1 2"],
    *["\u0663 1 1", "1_0 0 0", "0x1p3", "\U0001f916", "&lt;", "x" * 1000, "tip", "j1", "grip", "yaw", "l3"],
    *["fixed", "hinge", "slide", "main", "arm", "world", "true", "radian"],
]


@pytest.mark.parametrize(("text", "options"), FUZZED.values(), ids=FUZZED)
def test_files_with_other_values_are_read_or_refused(tmp_path, text, options):
    chance = random.Random(8)
    places = [match.span(1) for match in re.finditer(r'\w="([^"]*)"', text)]
    read = 0
    for _ in range(100):
        start, end = chance.choice(places)
        read += survives(tmp_path, text[:start] + chance.choice(JUNK) + text[end:], options)
    assert 0 < read < 100
