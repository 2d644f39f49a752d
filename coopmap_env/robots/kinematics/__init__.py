"""Kinematic chains: URDF files, forward kinematics, collision spheres."""
