"""A planar replay as one HTML page with a timeline, drawn by a script of its own.

The page holds the map as what changes from frame to frame, in base64: 16 scans of two robots take
about 50 KB. It loads nothing, and nothing but this package is needed to write it.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.replay.planar_recording import PlanarFrame, PlanarReplay
from coopmap_env.rendering import robot_color
from coopmap_env.rendering.panels import FREE, NEVER_SAMPLED, NEW_CELL_COLOR, OCCUPIED
from coopmap_env.simulation.scenes.planar import PlanarWorld

PAGE_TEMPLATE = Path(__file__).with_name("planar.html")
MAX_CELLS = 1 << 24
"""Browsers of phones draw no larger picture."""
BEAM_STEPS = 256.0
"""Steps of a cell to which the ends of beams are rounded; fewer where beams are very long."""


def render_planar_page(replay: PlanarReplay) -> str:
    """The whole page as HTML.

    Raises
    ------
    ValueError
        If the map has more cells than browsers draw.
    """
    n_cells = replay.world.occupied.size
    if n_cells > MAX_CELLS:
        raise ValueError(
            f"a page can show maps of at most {MAX_CELLS:,} cells, and this one has {n_cells:,}: "
            "choose a coarser resolution"
        )
    # within a script, "<" could end it ("</script>") or hide its end ("<!--<script>")
    text = json.dumps(page_data(replay)).replace("<", "\\u003c")
    return PAGE_TEMPLATE.read_text(encoding="utf-8").replace("/*DATA*/", text)


def page_data(replay: PlanarReplay) -> dict[str, Any]:
    """What the page's script draws, as JSON values; positions are in cells."""
    world, frames = replay.world, replay.frames
    scale = _beam_scale(replay)
    return {
        "title": replay.title,
        "shape": world.shape,
        "field_of_view": replay.camera.field_of_view,
        "depth_of_field": replay.camera.depth_of_field / world.resolution,
        "truth": _base64(run_lengths(world.occupied.ravel())),
        "beam_scale": scale,
        "frames": [_frame_data(frame, world, scale) for frame in frames],
        "bounds": None if replay.bounds is None else replay.bounds[: len(frames)].tolist(),
        "efficiency": replay.efficiency_curve(),
        "colors": {
            "robots": [robot_color(k) for k in range(len(frames[0].poses))],
            "free": FREE,
            "occupied": OCCUPIED,
            "never_sampled": NEVER_SAMPLED,
            "new": NEW_CELL_COLOR,
        },
    }


def _frame_data(frame: PlanarFrame, world: PlanarWorld, beam_scale: float) -> dict[str, Any]:
    positions = (frame.poses[:, :2] - world.origin) / world.resolution
    steps = beam_scale / world.resolution
    return {
        "poses": np.column_stack([positions, frame.poses[:, 2]]).round(4).tolist(),
        "beams": [
            _base64(np.column_stack([np.rint(steps * (ends - pose[:2])), hit]).astype("<i2"))
            for pose, ends, hit in zip(frame.poses, frame.beams, frame.hits, strict=True)
        ],
        "cells": _base64(varints(np.diff(frame.changed, prepend=0))),
        "levels": _base64(frame.levels),
        "observed": round(frame.observed_fraction, 6),
        "time": round(frame.elapsed_time, 2),
        "rewards": [round(value, 4) for value in frame.rewards],
        "notes": list(frame.notes),
        "shown": frame.n_shown,
    }


def _beam_scale(replay: PlanarReplay) -> float:
    """Steps of a cell in which ends of beams are counted from the camera, so that 16 bits do."""
    longest = max(
        np.abs(ends - pose[:2]).max(initial=0.0) / replay.world.resolution
        for frame in replay.frames
        for pose, ends in zip(frame.poses, frame.beams, strict=True)
    )
    return float(min(BEAM_STEPS, np.iinfo(np.int16).max / max(longest, 1.0)))


def run_lengths(flags: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Lengths of the runs of equal flags, beginning with False, as `varints`."""
    changes = np.flatnonzero(np.diff(flags, prepend=False))
    return varints(np.diff(changes, prepend=0, append=len(flags)))


def varints(values: ArrayLike) -> NDArray[np.uint8]:
    """Integers from 0 to 2**35 - 1 as bytes: seven bits each, the lowest first.

    All bytes of a number but its last one have the highest bit.
    """
    groups = np.asarray(values, dtype=np.int64)[:, None] >> np.arange(0, 35, 7)
    is_used = groups > 0
    is_used[:, 0] = True
    more = np.pad(is_used[:, 1:], ((0, 0), (0, 1)))
    return ((groups & 127) | (more << 7))[is_used].astype(np.uint8)


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
