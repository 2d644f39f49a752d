"""What a plain installation does: the plane works, and the field says what it needs."""

import json
import subprocess
import sys

import pytest

HIDDEN = (
    "pybullet", "pybullet_data", "trimesh", "embreex", "ompl", "pyoctomap", "viser",
    "skimage", "example_robot_data", "cmeel", "matplotlib", "torch", "stable_baselines3",
    "onnxruntime", "h5py",
)  # fmt: skip
HIDE = f"""
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HIDDEN!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hide())
"""


def run(code):
    return subprocess.run([sys.executable, "-c", HIDE + code], capture_output=True, text=True)


def test_the_planar_world_is_played_and_evaluated():
    done = run(
        "from coopmap_env import evaluation, planar_v1\n"
        "import coopmap_baselines\n"
        "env = planar_v1.parallel_env(max_scans=2)\n"
        "policy = coopmap_baselines.make('rating_function', search=10)\n"
        "print(evaluation.evaluate(env, policy, [0]).table['coverage'][0] > 0)\n"
    )
    assert done.stdout.split() == ["True"], done.stderr


CODES = {
    "from coopmap_env import field_v1; field_v1.parallel_env().reset(seed=0)": (
        "pip install 'coopmap[field]'"
    ),
    "import gymnasium, coopmap_env; gymnasium.make('coopmap/Field-v1').reset(seed=0)": (
        "pip install 'coopmap[field]'"
    ),
    "from coopmap_env import field_v1; field_v1.parallel_env(mount='tiago')": (
        "pip install 'coopmap["
    ),
    "from coopmap_env.mapping import OccupancyMap, VoxelGrid\n"
    "from coopmap_env.mapping.files import save_map\n"
    "save_map(OccupancyMap(VoxelGrid((2, 2, 2))), 'map.ot')": "pip install 'coopmap[octomap]'",
    "from coopmap_env.evaluation import make_policy; make_policy('learned:model=planar-pose')": (
        "pip install 'coopmap[onnx]'"
    ),
    "from coopmap_env.cli import main\n"
    "main(['evaluate', '--env', 'field', '--out', 'nowhere'])": "pip install 'coopmap[field]'",
    "from coopmap_env.cli import main\n"
    "main(['record', '--out', 'nowhere'])": "pip install 'coopmap[record]'",
}
"""Code that fails, and the command that its error names."""


@pytest.fixture(scope="module")
def errors():
    """What each code raises, in forks of one process: each new one takes seconds."""
    done = run(f"""
import json, os, coopmap_env
for code in {list(CODES)!r}:
    child = os.fork()
    if child == 0:
        error = None
        try:
            exec(code, {{}})
        except BaseException as raised:
            error = str(raised)
        os.write(1, json.dumps(error).encode() + b"\\n")
        os._exit(0)
    os.waitpid(child, 0)
""")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    return dict(zip(CODES, map(json.loads, lines), strict=True))


@pytest.mark.parametrize(("code", "command"), CODES.items())
def test_what_needs_an_extra_names_its_pip_command(code, command, errors):
    assert errors[code] is not None, "it works"
    assert command in errors[code]
