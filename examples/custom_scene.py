"""A custom scene of the field environment: boxes, meshes and URDFs in a YAML file."""

from pathlib import Path

import coopmap_baselines
from coopmap_env import field_v0
from coopmap_env.evaluation import rollout

SCANS_EACH = 2
SCENE = """
objects:
  # metres; roll, pitch and yaw in degrees; `mesh: part.stl` or `urdf: robot.urdf` instead of `box`
  - {name: shed, box: [1.2, 0.8, 1.6], position: [0, 0, 0.8], rpy: [0, 0, 20], target: true}
  - {name: crate, box: [0.5, 0.5, 0.5], position: [1.1, 1.2, 0.25]}
bases:  # optional: x, y, heading in degrees
  - [3.0, -1.5, 150]
  - [-2.5, 2.0, -40]
"""

Path("shed.yaml").write_text(SCENE, encoding="utf-8")
env = field_v0.parallel_env(scene="shed.yaml", n_robots=2, max_scans=SCANS_EACH)
for step in rollout(env, coopmap_baselines.make("coverage", search=50), seed=0):
    print(f"observed {step.infos['robot_0']['observed_fraction']:.1%}")
env.close()
