"""Cooperative active mapping: all that users need, under one name.

::

    import coopmap

    env = coopmap.planar_v1.parallel_env(n_robots=2, max_scans=16)
    policy = coopmap.make_policy("rating_function:search=100")
    print(coopmap.evaluate(env, policy, seeds=range(10)).table["coverage"])

It gathers names of three packages: `coopmap_env` (environments, maps, evaluation),
`coopmap_baselines` (planners) and `coopmap_agents` (learned policies). Importing it registers the
environments in Gymnasium and PettingZoo; everything else is loaded on first use, torch only by
what trains and by networks of torch.

==================  ================================================================================
environments        `planar_v1` (2-D), `field_v1` (3-D, extra ``field``), `families` (benchmark)
policies            `make_policy`, `policy_names`, `Policy`; `Planner` to inherit from
evaluation          `rollout`, `evaluate`, `compare`, `summarize`, `write_episodes`; `bounds`
maps                `OccupancyMap`, `VoxelGrid`, `load_map`, `save_map`, `save_surfaces`
cameras             `PlanarCamera`, `DepthCamera`, `RangeNoise`, `BeamModel`
robots              `make_mount`, `mount_from_urdf`
scenes              `Obstacles`, `Rooms`, `Corridors`; `Worksite`, `Clutter`, `Rubble`, `Occluded`;
                    your own: `PlanarWorld`, `FieldWorld`, files: `read_map_server`,
                    `read_user_scene`
learned policies    `LearnedPolicy`, `pretrained_names`; training (extra ``rl``): `train_network`,
                    `run_training`, `save_policy`
==================  ================================================================================
"""

from typing import TYPE_CHECKING

from coopmap_env import __version__
from coopmap_env.core.lazy import load_on_first_use

if TYPE_CHECKING:
    import coopmap_agents as agents
    import coopmap_baselines as baselines
    import coopmap_env.evaluation.bounds as bounds
    import coopmap_env.families as families
    import coopmap_env.field_v1 as field_v1
    import coopmap_env.planar_v1 as planar_v1
    from coopmap_agents.config import EnvConfig, ImitationSettings, PPOSettings, TrainingConfig
    from coopmap_agents.map_prediction import MapPredictor
    from coopmap_agents.networks import make_network
    from coopmap_agents.ppo import train_network
    from coopmap_agents.pretrained import (
        LearnedPolicy,
        load_policy,
        pretrained_names,
        pretrained_path,
        save_policy,
    )
    from coopmap_agents.training import run_training
    from coopmap_baselines.planner import Planner
    from coopmap_env.core.files import FileError
    from coopmap_env.core.settings import settings_from_dict, settings_to_dict
    from coopmap_env.envs import (
        REWARD_TERMS,
        Belief,
        Budget,
        Infos,
        InvalidActionError,
        MappingEnv,
        Observation,
        TeamEnv,
    )
    from coopmap_env.envs.field import FieldSettings
    from coopmap_env.envs.planar import PlanarSettings
    from coopmap_env.evaluation import (
        Episode,
        Evaluation,
        Policy,
        Step,
        compare,
        evaluate,
        make_policy,
        policy_names,
        policy_rng,
        rollout,
        run_episode,
        summarize,
        with_efficiencies,
        write_episodes,
    )
    from coopmap_env.evaluation.replay import record_replay, write_replay
    from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
    from coopmap_env.mapping.files import (
        MapFileError,
        load_map,
        load_surfaces,
        save_map,
        save_surfaces,
        write_map_server,
    )
    from coopmap_env.robots import Mount, Suspension, UrdfError, make_mount, mount_from_urdf
    from coopmap_env.sensing import DepthCamera, PlanarCamera, RangeNoise, Scan
    from coopmap_env.simulation.scenes import SceneError
    from coopmap_env.simulation.scenes.field import (
        BasePlacement,
        Clutter,
        FieldScene,
        FieldWorld,
        Occluded,
        Rubble,
        Solid,
        Worksite,
        make_field_scene,
        read_user_scene,
        solid_from_boxes,
        solid_from_hull,
    )
    from coopmap_env.simulation.scenes.planar import (
        Corridors,
        Obstacles,
        PlanarScene,
        PlanarWorld,
        RecordedMap,
        Rooms,
        make_planar_scene,
        read_map_server,
    )
    from coopmap_env.vector import MappingVectorEnv
else:
    __getattr__ = load_on_first_use(__name__)

__all__ = [
    "REWARD_TERMS",
    "BasePlacement",
    "BeamModel",
    "Belief",
    "Budget",
    "Clutter",
    "Corridors",
    "DepthCamera",
    "EnvConfig",
    "Episode",
    "Evaluation",
    "FieldScene",
    "FieldSettings",
    "FieldWorld",
    "FileError",
    "ImitationSettings",
    "Infos",
    "InvalidActionError",
    "LearnedPolicy",
    "LogOddsRange",
    "MapFileError",
    "MapPredictor",
    "MappingEnv",
    "MappingVectorEnv",
    "Mount",
    "Observation",
    "Obstacles",
    "Occluded",
    "OccupancyMap",
    "PPOSettings",
    "PlanarCamera",
    "PlanarScene",
    "PlanarSettings",
    "PlanarWorld",
    "Planner",
    "Policy",
    "RangeNoise",
    "RecordedMap",
    "Rooms",
    "Rubble",
    "Scan",
    "SceneError",
    "Solid",
    "Step",
    "Suspension",
    "TeamEnv",
    "TrainingConfig",
    "UrdfError",
    "VoxelGrid",
    "Worksite",
    "__version__",
    "agents",
    "baselines",
    "bounds",
    "compare",
    "evaluate",
    "families",
    "field_v1",
    "load_map",
    "load_policy",
    "load_surfaces",
    "make_field_scene",
    "make_mount",
    "make_network",
    "make_planar_scene",
    "make_policy",
    "mount_from_urdf",
    "planar_v1",
    "policy_names",
    "policy_rng",
    "pretrained_names",
    "pretrained_path",
    "read_map_server",
    "read_user_scene",
    "record_replay",
    "rollout",
    "run_episode",
    "run_training",
    "save_map",
    "save_policy",
    "save_surfaces",
    "settings_from_dict",
    "settings_to_dict",
    "solid_from_boxes",
    "solid_from_hull",
    "summarize",
    "train_network",
    "with_efficiencies",
    "write_episodes",
    "write_map_server",
    "write_replay",
]


def __dir__() -> list[str]:
    return __all__
