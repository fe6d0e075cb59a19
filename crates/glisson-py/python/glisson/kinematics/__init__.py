"""Robots and instruments of other programs: their joints lead an instrument of a world.

A URDF or an MJCF file says how a robot is built; a :class:`Chain` is the way from its base to the tip of its instrument::

    from glisson.kinematics import Chain

    chain = Chain.load("arm.urdf", tip="tool_tip", jaw="gripper")
    q = chain.solve(world.poses[0], q0, base=patient_from_base)          # joints that bring it where the instrument is
    q[chain.joints.index("insertion")] += 0.01
    poses = world.poses.copy()
    poses[0] = chain.pose(q, base=patient_from_base, near=poses[0])
    world.step(10, poses)

All is SI: m and rad. Meshes, masses, motors, and tendons of the files are not looked at.

Sources: URDF, https://wiki.ros.org/urdf/XML/joint and https://github.com/ros/urdfdom (``quat_xyzw``); MJCF, the XML reference of MuJoCo
4.0, https://mujoco.readthedocs.io/en/stable/XMLreference.html. Equalities of joints, which MuJoCo makes soft, hold exactly here.
"""

from glisson.kinematics.chain import Chain
from glisson.kinematics.errors import KinematicsError

__all__ = ["Chain", "KinematicsError"]
