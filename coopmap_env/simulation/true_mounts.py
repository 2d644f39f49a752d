"""Mounts as they are: their springs differ from what their description says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopmap_env.robots import Mount


def draw_true_mount(mount: Mount, max_error: float, rng: np.random.Generator) -> Mount:
    """A mount whose stiffness of roll and pitch differs from the described one.

    Each is multiplied by a number between 1 - `max_error` and 1 + `max_error`, uniformly drawn.
    """
    if mount.suspension is None:
        return mount
    roll, pitch = (1.0 + rng.uniform(-max_error, max_error, 2)).tolist()
    suspension = replace(
        mount.suspension,
        roll_stiffness=roll * mount.suspension.roll_stiffness,
        pitch_stiffness=pitch * mount.suspension.pitch_stiffness,
    )
    return replace(mount, suspension=suspension)
