"""Observations as the input of networks: n robots stacked, and which entries are special."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from coopmap_env.envs import Observation

SPECIAL_KEYS = ("candidates", "action_mask", "teammates", "located", "state")
"""Entries of an observation that are not simply concatenated."""
VARIABLE_LENGTH_KEYS = ("candidates", "action_mask", "teammates", "located")
"""Entries of an observation whose first axis may differ in length from training."""
LATER_KEYS = ("budget",)
"""Entries that observations did not have when some policies were trained, which ignore them."""


def stack(observations: Iterable[Observation]) -> Observation:
    """Stack the observations of n robots: each entry gets a first axis of length n."""
    rows = list(observations)
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}
