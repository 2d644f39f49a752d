"""Learned policies and predictions act where torch and what belongs to it are missing."""

import json
import subprocess
import sys

import pytest
from tiny_policies import tiny_policy_file

from coopmap_agents.map_prediction import MapNetwork, MapNetworkSettings, save_map_network
from coopmap_agents.pretrained import LearnedPolicy, convert_policy, pretrained_path
from coopmap_env.evaluation import make_policy

HIDE = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
"""
RL = ("torch", "stable_baselines3", "safetensors", "tensorboard")
ACT = """
import json
from coopmap_env import planar_v1
from coopmap_env.evaluation import evaluate, make_policy, policy_names
assert "learned" in policy_names()
arguments = {"max_scans": 3, "split": "test"}
played = {}
for mode in ("pose", "candidates"):
    env = planar_v1.parallel_env(action_mode=mode, **arguments)
    for spec in ("learned", f"learned:model=planar-{mode}+seed=1"):
        policy = make_policy(spec)
        table = evaluate(env, policy, [0]).table
        played[f"{mode} {spec}"] = [float(table["coverage"][0]), policy.fingerprint]
policy = make_policy("predictive:search=30")
played["candidates predictive:search=30"] = [
    float(evaluate(env, policy, [0]).table["coverage"][0]), policy.fingerprint
]
assert not any(name in sys.modules for name in hidden)
print(json.dumps(played))
"""


def run(code, hidden=RL):
    return subprocess.run(
        [sys.executable, "-c", f"hidden = {hidden!r}\n{HIDE}{code}"], capture_output=True, text=True
    )


def test_pretrained_policies_act_as_with_torch():
    from coopmap_env import planar_v1
    from coopmap_env.evaluation import evaluate

    pytest.importorskip("onnxruntime")
    done = run(ACT)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for key, (coverage, fingerprint) in json.loads(done.stdout.splitlines()[-1]).items():
        mode, spec = key.split(" ")
        env = planar_v1.parallel_env(action_mode=mode, max_scans=3, split="test")
        policy = make_policy(spec)
        assert evaluate(env, policy, [0]).table["coverage"][0] == pytest.approx(coverage, rel=1e-3)
        assert policy.fingerprint == fingerprint


def test_a_missing_package_is_named_with_its_pip_command(tmp_path):
    path = tiny_policy_file(tmp_path)
    convert_policy(path, path.with_suffix(".onnx"))
    network = tmp_path / "map.safetensors"
    for name in ("map.safetensors", "map.onnx"):
        save_map_network(MapNetwork(MapNetworkSettings(widths=(4, 6, 8))), tmp_path / name)
    codes = {
        f"make_policy('learned:model={path}')": "coopmap[rl]",
        "import coopmap_agents.pretrained as p; p.save_policy": "coopmap[rl]",
        "make_policy('learned:model=planar-pose')": "coopmap[onnx]",
        f"make_policy('learned:model={path.with_suffix('.onnx')}')": "coopmap[onnx]",
        f"make_policy('predictive:model={network}')": "coopmap[rl]",
        "import coopmap_agents.map_prediction as m; m.MapPredictor()": "coopmap[onnx]",
        "import coopmap_agents.map_prediction as m; m.save_map_network": "coopmap[rl]",
        "import coopmap_agents.map_prediction as m; m.run_map_training": "coopmap[rl]",
        "make_policy('predictive_surface')": "coopmap[onnx]",
        f"make_policy('predictive:model={network.with_suffix('.onnx')}')": "coopmap[onnx]",
    }
    done = run(
        f"""
from coopmap_env.evaluation import make_policy
for code in {list(codes)!r}:
    try:
        exec(code)
    except ImportError as error:
        print(error)
""",
        hidden=(*RL, "onnxruntime"),
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(codes)
    for line, extra in zip(lines, codes.values(), strict=True):
        assert f"is needed here and is not installed: pip install '{extra}'" in line
    for k in (0, 4):  # files of safetensors
        assert lines[k].endswith("an .onnx file of the same weights needs 'coopmap[onnx]' alone")


def test_with_torch_it_decides_except_for_onnx_files():
    pytest.importorskip("onnxruntime")
    for model, decides in {
        "planar-pose": "TorchNetwork",
        pretrained_path("planar-pose"): "TorchNetwork",
        pretrained_path("planar-pose", file_format="onnx"): "OnnxNetwork",
    }.items():
        assert type(LearnedPolicy(model)._network).__name__ == decides
