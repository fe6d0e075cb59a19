"""Robots that the tests of kinematics share, and what makes and loads them."""

import math

import numpy as np

from glisson.kinematics import Chain

#: Two links of 0.3 and 0.2 m that turn about z.
PLANAR = """<?xml version="1.0"?>
<robot name="planar">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="tip"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 2"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="2.5"/>
  </joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0.2 0 0"/></joint>
</robot>
"""
PLANAR_OPTIONS = {"shaft_axis": (-1, 0, 0)}

#: An instrument that turns about a place 0.1 0.2 0.3, goes in through it along z, and turns about its shaft. Its jaws are beside the tip.
TROCAR_M = np.array([0.1, 0.2, 0.3])
RCM = """<robot name="rcm">
  <link name="base"/><link name="yawed"/><link name="pitched"/><link name="inserted"/><link name="rolled"/><link name="tip"/>
  <link name="left"/><link name="right"/>
  <joint name="yaw" type="revolute">
    <origin xyz="0.1 0.2 0.3"/><parent link="base"/><child link="yawed"/><axis xyz="1 0 0"/><limit lower="-1.5" upper="1.5"/>
  </joint>
  <joint name="pitch" type="revolute"><parent link="yawed"/><child link="pitched"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="insertion" type="prismatic">
    <parent link="pitched"/><child link="inserted"/><axis xyz="0 0 1"/><limit lower="0.02" upper="0.24"/>
  </joint>
  <joint name="roll" type="continuous"><parent link="inserted"/><child link="rolled"/><axis xyz="0 0 1"/></joint>
  <joint name="end" type="fixed"><parent link="rolled"/><child link="tip"/></joint>
  <joint name="grip" type="revolute">
    <parent link="rolled"/><child link="left"/><axis xyz="0 1 0"/><limit lower="-0.2" upper="0.8"/>
  </joint>
  <joint name="grip_right" type="revolute">
    <parent link="rolled"/><child link="right"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/><mimic joint="grip" multiplier="-1"/>
  </joint>
</robot>
"""
RCM_OPTIONS = {"tip": "tip", "jaw": "grip"}
#: The same; angles in degrees, limits from classes, all four joints in one body, turned half a turn about x and back.
RCM_MJCF = f"""<mujoco model="rcm">
  <default>
    <joint limited="true" range="{math.degrees(-1.5)!r} {math.degrees(1.5)!r}"/>
    <default class="pitch"><joint axis="0 1 0" range="{math.degrees(-1.0)!r} {math.degrees(1.0)!r}"/></default>
  </default>
  <worldbody>
    <body name="mount" pos="0.1 0.1 0.3" euler="180 0 0">
      <geom size="0.01"/>
      <body name="rolled" pos="0 -0.1 0" quat="0 2 0 0">
        <joint name="yaw" axis="1 0 0"/>
        <joint name="pitch" class="pitch"/>
        <joint name="insertion" type="slide" axis="0 0 3" range="0.02 0.24"/>
        <joint name="roll" axis="0 0 1" limited="false"/>
        <geom size="0.01"/>
        <site name="tip" pos="0 0 0"/>
        <body name="left">
          <joint name="grip" axis="0 1 0" range="{math.degrees(-0.2)!r} {math.degrees(0.8)!r}"/><geom size="0.01"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

#: Six joints, none along another: every pose in reach can be had.
SIX = """<robot name="six">
  <link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="l4"/><link name="l5"/><link name="l6"/>
  <joint name="j1" type="revolute">
    <parent link="l0"/><child link="l1"/><origin xyz="0 0 0.2" rpy="0.1 -0.2 0.3"/><axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8"/>
  </joint>
  <joint name="j2" type="revolute">
    <parent link="l1"/><child link="l2"/><origin xyz="0.05 0 0.1"/><axis xyz="0 1 0"/><limit lower="-1.8" upper="1.8"/>
  </joint>
  <joint name="j3" type="prismatic">
    <parent link="l2"/><child link="l3"/><origin xyz="0 0 0.2" rpy="0 0.4 0"/><axis xyz="0 0 1"/><limit lower="0" upper="0.3"/>
  </joint>
  <joint name="j4" type="continuous"><parent link="l3"/><child link="l4"/><axis xyz="0 0 1"/></joint>
  <joint name="j5" type="revolute">
    <parent link="l4"/><child link="l5"/><axis xyz="1 1 0"/><limit lower="-1.6" upper="1.6"/>
  </joint>
  <joint name="j6" type="continuous"><parent link="l5"/><child link="l6"/><origin xyz="0 0 0.03" rpy="0 0 1"/><axis xyz="0 0 1"/></joint>
</robot>
"""

#: All ways of MJCF to say how things lie, frames, joints beside their body's origin, references, classes, one joint that follows another.
ALL_WAYS = """<mujoco>
  <compiler angle="radian"/>
  <compiler eulerseq="zYx"/>
  <default>
    <joint axis="0 1 0"/>
    <default class="arm">
      <joint range="-1 1" ref="0.25"/>
      <site euler="0.1 0.2 0.3" pos="0 0 0.01"/>
      <default class="slides"><joint type="slide" range="-0.1 0.2" ref="0"/></default>
    </default>
  </default>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.3" axisangle="1 2 -2 0.7" childclass="arm">
      <geom size="0.01" mass="1"/>
      <joint name="q1" pos="0.02 0 -0.03"/>
      <joint name="q2" pos="0 0.05 0" axis="1 0 1"/>
      <frame pos="0.01 0.02 0.03" euler="0.3 -0.4 0.5">
        <joint name="q3" class="slides" axis="1 1 0"/>
        <frame zaxis="1 1 1">
          <body name="b" pos="0 0 0.2" xyaxes="1 1 0 0 1 1">
            <geom size="0.01" mass="1"/>
            <joint name="q4" class="main" pos="0 0 0.01" ref="-0.1"/>
            <body name="c" pos="0.03 0 0" zaxis="0 0 -1">
              <geom size="0.01" mass="1"/>
              <joint name="q5"/>
              <frame quat="0.5 0.5 -0.5 0.5" pos="0 0 0.02"><site name="tip" pos="0.01 0.02 0.03"/></frame>
            </body>
          </body>
        </frame>
      </frame>
    </body>
  </worldbody>
  <equality><joint joint1="q5" joint2="q1" polycoef="0.15 -0.5"/></equality>
</mujoco>
"""
ALL_WAYS_OPTIONS = {"tip": "tip"}

SAMPLES = {
    "planar": (PLANAR, PLANAR_OPTIONS),
    "rcm": (RCM, RCM_OPTIONS),
    "rcm in MJCF": (RCM_MJCF, RCM_OPTIONS),
    "six": (SIX, {}),
    "all ways": (ALL_WAYS, ALL_WAYS_OPTIONS),
    "jaw on the chain": (RCM, {"tip": "right", "jaw": "grip", "base": "pitched"}),
}


def load(tmp_path, text, **options):
    path = tmp_path / "robot.xml"
    # A new file is made sooner than one that is there is emptied.
    path.unlink(missing_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Chain.load(path, **options)


def robot(joints, links="abc"):
    return "<robot>\n" + "".join(f'<link name="{link}"/>' for link in links) + "\n" + joints + "\n</robot>"


def joint(name="j", parent="a", child="b", kind="continuous", more=""):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def mjcf(body, more=""):
    return f'<mujoco>\n{more}\n<worldbody><body name="b">\n{body}\n</body></worldbody></mujoco>'
