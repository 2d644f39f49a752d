"""The house: a real floor plan, from the data of Peter Corke's Robotics Toolbox.

The file ``house.mat`` is read where the distribution ``rtb-data`` installed it; none of it is
copied here. The plan is to scale, with walls, door leaves, fixtures and a garden that is open to
three sides: the world ends at the border of the drawing.
"""

from importlib import resources

import numpy as np

from coopmap_env.core.extras import import_optional
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.planar.recorded import RecordedMap, max_pool
from coopmap_env.simulation.scenes.planar.world import PlanarWorld

CELL_SIZE = 0.045
"""Side of a cell of the drawing in metres, as the Robotics Toolbox states it."""


def load_house(pool: int = 3) -> RecordedMap:
    """Read the house from the installed ``rtb-data``.

    Parameters
    ----------
    pool : int
        Cells of the drawing (0.045 m) per side of a cell of the world. At 3 a cell is 0.135 m,
        the world has 199 x 133 cells, and all places named in the file lie in one free region.

    Returns
    -------
    RecordedMap
        With the origin at the lower left corner of the drawing.

    Raises
    ------
    ImportError
        With the pip command, if ``rtb-data`` is not installed.
    SceneError
        If its file is missing or not as expected.
    """
    from scipy.io import loadmat  # takes a tenth of a second, which only this scene needs

    package = import_optional("rtbdata", "data")
    file = resources.files(package) / "data" / "house.mat"
    try:
        with resources.as_file(file) as path:
            floorplan = loadmat(path)["floorplan"]
    except Exception as error:  # SciPy raises what its parser, zlib and Python raise
        raise SceneError(f"{file}: floorplan cannot be read: {error!r}") from error
    if floorplan.ndim != 2 or not np.isin(floorplan, (0, 1)).all():
        raise SceneError(
            f"{file}: floorplan must be a matrix of 0 and 1, not {floorplan.dtype} of shape "
            f"{floorplan.shape}"
        )
    # Rows are y, upwards, as the places in the file show ("garage" at x 500, y 150).
    occupied = max_pool(np.ascontiguousarray(floorplan.T == 1), pool)
    return RecordedMap(PlanarWorld(occupied, CELL_SIZE * pool, (0.0, 0.0), "house"))
