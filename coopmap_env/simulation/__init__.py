"""True worlds: the scenes that make them, and the simulators that move robots and scan in them."""

from coopmap_env.simulation.field import FieldSimulator, Physics
from coopmap_env.simulation.planar import PlanarSimulator
from coopmap_env.simulation.simulator import MoveResult, Simulator
from coopmap_env.simulation.true_mounts import draw_true_mount

__all__ = [
    "FieldSimulator",
    "MoveResult",
    "Physics",
    "PlanarSimulator",
    "Simulator",
    "draw_true_mount",
]
