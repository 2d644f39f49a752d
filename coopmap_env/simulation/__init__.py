"""What the world answers: scenes, and simulators that look at them."""

from coopmap_env.simulation.planar import PlanarSimulator
from coopmap_env.simulation.simulator import Simulator

__all__ = ["PlanarSimulator", "Simulator"]
