"""Prediction of what lies in the unknown part of a map, and planning with it.

A network sees the team's map, and gives the probability that a beam that reaches an unknown cell
ends there; in 3-D, that an unknown voxel is surface. It is trained on maps that planners made of
training worlds, with the truth behind them. `PredictivePolicy` is the look-ahead planner on the
predicted planar map, `PredictiveSurfacePolicy` the planner of new surface on the predicted field
map. Other planners can use `MapPredictor.occupancy` too: `Planning.foresight` takes it::

    coopmap train-map --out results/map
    coopmap evaluate --family crowded --policies predictive,lookahead:horizon=1

What trains, and what reads and writes networks of torch, is loaded on first use: without torch,
networks predict from their ONNX files.
"""

from typing import TYPE_CHECKING

from coopmap_agents.map_config import MapNetworkSettings, MapTrainingConfig
from coopmap_agents.map_prediction.examples import MapExamples, collect_examples
from coopmap_agents.map_prediction.images import map_image
from coopmap_agents.map_prediction.policy import PredictivePolicy, PredictiveSurfacePolicy
from coopmap_agents.map_prediction.predictor import MapPredictor
from coopmap_agents.map_prediction.scores import PredictionScores, score_predictions
from coopmap_env.core.lazy import load_on_first_use

if TYPE_CHECKING:
    from coopmap_agents.map_prediction.model_file import (
        convert_map_network,
        load_map_network,
        save_map_network,
    )
    from coopmap_agents.map_prediction.network import MapNetwork
    from coopmap_agents.map_prediction.training import run_map_training
else:
    __getattr__ = load_on_first_use(__name__)

__all__ = [
    "MapExamples",
    "MapNetwork",
    "MapNetworkSettings",
    "MapPredictor",
    "MapTrainingConfig",
    "PredictionScores",
    "PredictivePolicy",
    "PredictiveSurfacePolicy",
    "collect_examples",
    "convert_map_network",
    "load_map_network",
    "map_image",
    "run_map_training",
    "save_map_network",
    "score_predictions",
]
