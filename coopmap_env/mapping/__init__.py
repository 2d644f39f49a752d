"""The probabilistic map: grid, beam model, Gaussian fusion, map quality."""

from coopmap_env.mapping.beam import BeamModel, beam_occupancy
from coopmap_env.mapping.gaussian import gaussian_density, merge_gaussians
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import LogOddsRange
from coopmap_env.mapping.occupancy_map import OccupancyMap, ScanGain

__all__ = [
    "BeamModel",
    "LogOddsRange",
    "OccupancyMap",
    "ScanGain",
    "VoxelGrid",
    "beam_occupancy",
    "gaussian_density",
    "merge_gaussians",
]
