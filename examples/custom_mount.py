"""A custom camera mount from a URDF: a pole with pan and tilt on a small vehicle."""

from pathlib import Path

import coopmap_baselines
from coopmap_env import field_v1
from coopmap_env.evaluation import rollout

SCANS_EACH = 2
URDF = """<robot name="pan_tilt">
  <link name="body">
    <inertial><mass value="80"/>
      <inertia ixx="4" iyy="5" izz="7" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.7 0.6 0.3"/></geometry></collision>
  </link>
  <joint name="pan" type="revolute">
    <parent link="body"/><child link="pole"/><origin xyz="0 0 0.15"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="50" velocity="1"/>
  </joint>
  <link name="pole">
    <inertial><origin xyz="0 0 0.5"/><mass value="4"/>
      <inertia ixx="0.4" iyy="0.4" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.5"/>
      <geometry><cylinder radius="0.04" length="1.0"/></geometry></collision>
  </link>
  <joint name="tilt" type="revolute">
    <parent link="pole"/><child link="camera"/><origin xyz="0 0 1.05"/><axis xyz="0 1 0"/>
    <limit lower="-0.6" upper="1.0" effort="20" velocity="1"/>
  </joint>
  <link name="camera"> <!-- x is the optical axis, y left, z up -->
    <inertial><mass value="0.5"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.06 0.12 0.06"/></geometry></collision>
  </link>
</robot>
"""

Path("pan_tilt.urdf").write_text(URDF, encoding="utf-8")
mount = field_v1.mount_from_urdf(
    "pan_tilt.urdf", joints=["pan", "tilt"], camera_link="camera", home=[0.0, 0.2], root_height=0.4
)
env = field_v1.parallel_env(mount=mount, n_robots=2, split="test", max_scans=SCANS_EACH)
for step in rollout(env, coopmap_baselines.make("rating_function", search=50), seed=0):
    print(f"observed {step.infos['robot_0']['observed_fraction']:.1%}")
env.close()
