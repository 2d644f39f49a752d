"""Files of map_server, and the cells that both of their readers make of them."""

import numpy as np
import yaml
from PIL import Image

from coopmap_env.mapping.files import load_map
from coopmap_env.simulation.scenes.planar import read_map_server

FIELDS = {
    "image": "map.png",
    "resolution": 0.5,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
F, U, X = -1, 0, 1
"""Free, unknown, occupied."""


def map_file(folder, content, image="map.png", **fields):
    """A map_server file of an image: its bytes, or pixels from the largest y down."""
    if isinstance(content, bytes):
        (folder / image).write_bytes(content)
    else:
        Image.fromarray(np.array(content)).save(folder / image)
    (folder / "map.yaml").write_text(yaml.safe_dump(FIELDS | {"image": image} | fields))
    return folder / "map.yaml"


def cells(path):
    """Cells of the map as in the image: `F`, `U`, `X`, or the probability where it is between."""
    map_ = load_map(path)
    p = np.where(map_.sampled, map_.probability, np.nan)
    certain = abs(map_.log_odds_fixed.reshape(p.shape)) == map_.log_odds_range.clamp
    values = np.where(certain, np.sign(map_.log_odds_fixed.reshape(p.shape)), p)
    return np.where(np.isnan(p), U, values).T[::-1].round(3).tolist()


def tiled(pixels):
    """The same pixels 8 x 8 times: no world is smaller than 8 x 8 cells."""
    pixels = np.array(pixels)
    return np.tile(pixels, (8, 8) + (1,) * (pixels.ndim - 2))


def free_cells(path):
    """Which cells are free in the world of the same file."""
    return (~read_map_server(path).truth.occupied.T[::-1]).tolist()


def saved_by_map_saver():
    rows = np.full((100, 90), 205, np.uint8)
    rows[30:60, 30:60] = 254
    rows[30, 30:60] = 0
    return rows
