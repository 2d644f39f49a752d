"""Custom scenes: a class that makes planar worlds, and a YAML file for the field environment.

A scene class of the field environment has the methods of
`coopmap_env.simulation.scenes.field.FieldScene`, and is passed to `field_v1` in the same way.
"""

from pathlib import Path

import numpy as np

import coopmap_baselines
from coopmap_env import field_v1, planar_v1
from coopmap_env.evaluation import rollout
from coopmap_env.simulation.scenes.planar import PlanarWorld

SCANS_EACH = 2


class Pillars:
    """Planar worlds with pillars of two by two cells at random positions."""

    name = "pillars"
    shape = (60, 40)  # cells along x and y
    resolution = 1.0  # metres per cell
    origin = (0.0, 0.0)  # of the lower corner, metres

    def world(self, rng):
        """Make a world; all random numbers come from `rng`, which the seed and the split decide."""
        occupied = np.zeros(self.shape, dtype=bool)
        for x, y in rng.integers(0, np.array(self.shape) - 1, size=(20, 2)):
            occupied[x : x + 2, y : y + 2] = True
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)


FIELD_SCENE = """
objects:
  # metres; roll, pitch and yaw in degrees; `mesh: part.stl` or `urdf: robot.urdf` instead of `box`
  - {name: shed, box: [1.2, 0.8, 1.6], position: [0, 0, 0.8], rpy: [0, 0, 20], target: true}
  - {name: crate, box: [0.5, 0.5, 0.5], position: [1.1, 1.2, 0.25]}
bases:  # optional: x, y, heading in degrees
  - [3.0, -1.5, 150]
  - [-2.5, 2.0, -40]
"""

Path("shed.yaml").write_text(FIELD_SCENE, encoding="utf-8")
for env in (
    planar_v1.parallel_env(scene=Pillars(), max_scans=SCANS_EACH),
    field_v1.parallel_env(scene="shed.yaml", n_robots=2, max_scans=SCANS_EACH),
):
    for step in rollout(env, coopmap_baselines.make("coverage", search=50), seed=0):
        fraction = step.infos["robot_0"]["observed_fraction"]
        print(f"{env.metadata['name']}: observed {fraction:.1%}")
    env.close()
