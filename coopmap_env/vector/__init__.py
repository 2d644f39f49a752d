"""Vector environments: many worlds in one call, with one contract for both kinds of worlds.

::

    env = field_v1.vector_env(16, num_workers=4, action_mode="candidates", double_buffer=True)
    observations, infos = env.reset(seed=0)
    observations, rewards, terminations, truncations, infos = env.step(actions)

A vector environment is a `gymnasium.vector.VectorEnv`. A row is a robot (``rows="agents"``: row
world * n_robots + robot) or a team as `TeamEnv` sees it (``rows="teams"``); `rows` has a table.

=================  ==============================================================================
observations       dict of arrays (rows, ...), with_state=True adds "state" (`MappingEnv.state`)
actions            in `action_space`: (rows,) or (rows, n_robots) candidates, (rows, k) numbers,
                   which are converted to the type of the space
rewards            float64 (rows,)
terminations,      bool (rows,); robots of a world end together
truncations
infos              dict of arrays: the entries of the environment's infos, and beside each ``key``
                   the mask ``_key``, bool (rows,), of the rows that have it; (rows,) for robots,
                   (rows, n_robots) for teams
=================  ==============================================================================

*Arrays are written in place.* They are valid until the next `step` or `reset`, or, with
``double_buffer=True``, until the one after it. No array is copied for a step; `torch.from_numpy`
and DLPack share the memory. Copy what has to live longer.

*Automatic resets* are gymnasium's: ``autoreset_mode`` is

============  ===================================================================================
"NextStep"    the step after an end resets the world: its action is ignored, its reward is 0
"SameStep"    the step at an end returns the first observations of the next episode; the last ones
              are in ``infos["final_obs"]``, row by row, and in `final_observations`, as arrays;
              infos of the end are in ``infos["final_info"]``
"Disabled"    ``reset(options={"reset_mask": terminations | truncations})``
============  ===================================================================================

*Seeds.* ``reset(seed=...)`` takes one seed for each world, or that of world 0. Each world plays the
episodes of a single environment that is reset with its seed, to the last bit; later resets draw
their seeds as the single environment does without a seed.

*Errors.* An action that is not in its space is an `InvalidActionError` that names world, robot and
value, and no world has moved. An environment's own error names the world; the worlds then need a
`reset`. A worker process that has ended is a `WorkerError`. `close` works always.

*Looking inside.* `MappingVectorEnv.world` is the environment of a world. `apply` calls a function
of it where it is, in its worker: planners decide by ``env.belief()`` there.
"""

from coopmap_env.vector.planar_env import PlanarVectorEnv
from coopmap_env.vector.rows import RowName
from coopmap_env.vector.step_arrays import StepArrays
from coopmap_env.vector.team_spaces import TeamSpaces
from coopmap_env.vector.vector_env import MappingVectorEnv
from coopmap_env.vector.worker_env import WorkerVectorEnv
from coopmap_env.vector.world_block import EnvFactory

__all__ = [
    "EnvFactory",
    "MappingVectorEnv",
    "PlanarVectorEnv",
    "RowName",
    "StepArrays",
    "TeamSpaces",
    "WorkerVectorEnv",
]
