"""Broken scene files give a scene or one error that names the file."""

import numpy as np
import pytest

pytest.importorskip("yaml")
pytest.importorskip("trimesh")

from plain.fuzz import cases, mutants, read_or_refuse
from plain.meshes import dae

from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.field import read_user_scene

SCENE = b"""ground: true
grid: {shape: [40, 40, 20], resolution: 0.2, origin: [-4, -4, -1]}
package_dirs: [.]
objects:
  - {box: [1.0, 0.6, 0.8], position: [0, 0, 0.4], rpy: [0, 0, 30], target: true}
  - mesh: a.dae
    name: rock
    scale: [0.5, 1, 2.5e-1]
    position: [2, 1, 0]
  - {urdf: r.urdf, name: shelf, position: [-2, 1, 0], scale: 2}
bases: [[3, 0, 180], [-3, -3, 9e1]]
"""
URDF = b"""<robot name="r"><link name="a"><visual><origin xyz="0 0 1" rpy="0 0 0.5"/><geometry>
<box size="1 1 2"/></geometry></visual><visual><geometry><sphere radius="0.5"/></geometry></visual>
</link><link name="b"><visual><geometry><mesh filename="package://a.dae" scale="1 1 2"/></geometry>
</visual></link><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<origin xyz="3 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/>
</joint></robot>
"""


def is_read(path):
    """Whether a scene was read; what it holds must be usable."""
    scene = read_or_refuse(read_user_scene, path, SceneError)
    if scene is None:
        return False
    for solid in scene.solids:
        assert np.isfinite(solid.triangles).all()
        assert np.abs(solid.bounds).max() < 1e13
    return True


@pytest.mark.filterwarnings("ignore:.*the surface is open:UserWarning")
@cases(short=150, long=3_000)
@pytest.mark.parametrize("broken", ["yard.yaml", "r.urdf", "a.dae"])
def test_broken_scenes_are_refused_by_name_or_read(tmp_path, broken, n_cases):
    files = {"yard.yaml": SCENE, "r.urdf": URDF, "a.dae": dae()}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert is_read(tmp_path / "yard.yaml")
    n_read = 0
    for content in mutants([files[broken]], n_cases):
        (tmp_path / broken).write_bytes(content)
        n_read += is_read(tmp_path / "yard.yaml")
    assert 0 < n_read < n_cases
