"""One episode in the field environment; the map is saved for OctoMap and for mesh viewers."""

import coopmap_baselines
from coopmap_env import field_v1
from coopmap_env.evaluation import rollout
from coopmap_env.mapping.files import save_map, save_surfaces

SCANS_EACH = 3
SEED = 0

env = field_v1.parallel_env(
    n_robots=2, mount="mast", scene="worksite", split="test", max_scans=SCANS_EACH
)
policy = coopmap_baselines.make("rating_function", search=100)

for step in rollout(env, policy, SEED):
    info = step.infos["robot_0"]
    print(f"observed {info['observed_fraction']:.1%}, camera error {info['camera_error']:.3f} m")

map_ = env.belief().map
save_map(map_, "field.ot")  # needs the extra `octomap`
save_surfaces(map_, "field.ply")  # merged surface points with their covariances
env.close()
