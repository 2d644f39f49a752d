"""Where a planar camera can stand and turn, and which of it is reached safely."""

from coopmap_env.robots.lattice import PoseLattice
from coopmap_env.robots.reach import Reach, free_cells, straight_path_is_free, why_not

__all__ = ["PoseLattice", "Reach", "free_cells", "straight_path_is_free", "why_not"]
