"""The probabilistic map: grid, inverse sensor model, Gaussian fusion, occupancy."""

from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.beam import BeamModel, beam_occupancy
from coopmap_env.mapping.gaussian import gaussian_density, merge_gaussians
from coopmap_env.mapping.grid import GridGeometry, VoxelGrid
from coopmap_env.mapping.line_of_sight import has_line_of_sight
from coopmap_env.mapping.log_odds import (
    FREE_LOG_ODDS_FIXED,
    FREE_PROBABILITY,
    STEPS_PER_NAT,
    LogOddsRange,
    to_log_odds_fixed,
)
from coopmap_env.mapping.occupancy_map import MapArrays, OccupancyMap, ScanGain
from coopmap_env.mapping.surface_mean import mean_gaussian

__all__ = [
    "FREE_LOG_ODDS_FIXED",
    "FREE_PROBABILITY",
    "STEPS_PER_NAT",
    "BeamModel",
    "GridGeometry",
    "LogOddsRange",
    "MapArrays",
    "OccupancyMap",
    "ScanGain",
    "SurfaceArrays",
    "VoxelGrid",
    "beam_occupancy",
    "gaussian_density",
    "has_line_of_sight",
    "mean_gaussian",
    "merge_gaussians",
    "to_log_odds_fixed",
]
