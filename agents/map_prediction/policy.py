"""Look-ahead on maps whose unknown part is predicted, planar and field ones."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from coopmap_agents.map_prediction.predictor import MapPredictor
from coopmap_baselines import LookaheadPolicy
from coopmap_baselines.planner import Search
from coopmap_env.core.settings import UnitInterval, checked_value
from coopmap_env.envs import Belief, Foresight

if TYPE_CHECKING:
    from coopmap_agents.map_prediction.network import MapNetwork


class _OnPredictedMaps(LookaheadPolicy):
    """The look-ahead planner, with a network's prediction of the cells that are still unknown."""

    def __init__(self, predictor: MapPredictor, **options: Any) -> None:
        super().__init__(**options)
        self.predictor = predictor

    def foresight(self, belief: Belief) -> Foresight:
        """The map with its predicted part."""
        return belief.planning.foresight(belief, self.predictor.occupancy(belief.map))

    @property
    def fingerprint(self) -> str:
        """Hash of the weights."""
        return self.predictor.fingerprint

    @property
    def n_parameters(self) -> int:
        """Numbers of the network."""
        return self.predictor.n_parameters

    @property
    def model_bytes(self) -> int:
        """Bytes of these."""
        return self.predictor.model_bytes


class PredictivePolicy(_OnPredictedMaps):
    """The look-ahead planner on predicted planar maps.

    Where `LookaheadPolicy` expects the same of all unknown cells at the same distance from a known
    surface, a network that has seen many worlds expects rooms behind doors, and walls that go on.

    Parameters
    ----------
    model : MapNetwork or path, optional
        By default the network that ships with coopmap.
    horizon : int
        Views of each robot that are planned one after another.
    search : int or "exhaustive"
        Number of random poses, of which the first view is one. A network takes as long as some
        thousand views, so many of them are worth it.
    hazard_scale : float
        Factor of the predicted hazards, in [0, 1]. The cells along a beam are not independent: if
        the first one behind a gap is free, those behind it probably are, too. Their product would
        expect too little of views deep into the unknown. Chosen on validation worlds, see
        `docs/what_was_tried.md`.
    seed : int, optional
        Seed of the training, for a network that ships with coopmap: 0 by default.
    **options
        As of `LookaheadPolicy`.

    Raises
    ------
    ValueError
        If an option is not one of its choices, or no network of this seed ships.
    FileError
        If the file is not of a map network.
    ImportError
        With the pip command, if what the file needs is not installed.
    """

    def __init__(
        self,
        model: MapNetwork | str | os.PathLike[str] | None = None,
        horizon: int = 1,
        search: Search = 1000,
        hazard_scale: float = 0.5,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__(MapPredictor(model, seed=seed), horizon=horizon, search=search, **options)
        self.hazard_scale: float = checked_value("hazard_scale", hazard_scale, UnitInterval)

    def foresight(self, belief: Belief) -> Foresight:
        """The map with its predicted hazards."""
        hazards = np.float32(self.hazard_scale) * self.predictor.occupancy(belief.map)
        return belief.planning.foresight(belief, hazards)


class PredictiveSurfacePolicy(_OnPredictedMaps):
    """The planner of new surface on predicted field maps.

    `SurfacePolicy` expects the same of all unknown voxels at the same distance from the known
    surface; a network that has seen many scenes expects the far side of an object.

    Parameters
    ----------
    model : MapNetwork or path, optional
        By default the network that ships with coopmap.
    horizon : int
        Views of each robot that are planned one after another.
    search : int or "exhaustive"
        Number of random poses, of which the first view is one.
    motion_weight : float
        Gain, as a fraction of a full view, that is worth one unit of d (Eq. 5). On validation
        worlds, 0.001 covers as much as less does, and 0.002 a little less for less motion.
    seed : int, optional
        Seed of the training, for a network that ships with coopmap: 0 by default.
    **options
        As of `LookaheadPolicy`.

    Raises
    ------
    ValueError
        If an option is not one of its choices, or no network of this seed ships.
    FileError
        If the file is not of a map network.
    ImportError
        With the pip command, if what the file needs is not installed.
    """

    def __init__(
        self,
        model: MapNetwork | str | os.PathLike[str] | None = None,
        horizon: int = 1,
        search: Search = 100,
        motion_weight: float = 1e-3,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        predictor = MapPredictor(model, dimension=3, seed=seed)
        super().__init__(
            predictor, horizon=horizon, search=search, motion_weight=motion_weight, **options
        )
