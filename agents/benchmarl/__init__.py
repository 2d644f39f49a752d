"""Tasks and a model for BenchMARL; needs the extra ``benchmarl``.

::

    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from coopmap_agents.benchmarl import CoopmapTask, NetworkConfig

    experiment = Experiment(
        task=CoopmapTask.CROWDED.get_task({"n_candidates": 32, "reward": "coverage"}),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=NetworkConfig(),
        seed=0,
        config=ExperimentConfig.get_from_yaml(),
    )
    experiment.run()
    save_policy(*trained_network(experiment), "policy.safetensors")  # of coopmap_agents.pretrained

BenchMARL's own models take observations of one vector; `NetworkConfig` makes the networks that
coopmap's own trainers use, of the whole observation, as actors and critics of BenchMARL.
"""

import coopmap_agents._require_benchmarl  # noqa: F401
from coopmap_agents.benchmarl.model import Network, NetworkConfig, trained_network
from coopmap_agents.benchmarl.task import CoopmapTask, CoopmapTaskClass

__all__ = ["CoopmapTask", "CoopmapTaskClass", "Network", "NetworkConfig", "trained_network"]
