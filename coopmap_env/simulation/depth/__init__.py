"""Depth images of the truth: rays through triangles, by Embree."""

from coopmap_env.simulation.depth.renderer import CameraRays, DepthRenderer, simulate_point_cloud
from coopmap_env.simulation.depth.traced_mesh import TracedMesh

__all__ = ["CameraRays", "DepthRenderer", "TracedMesh", "simulate_point_cloud"]
