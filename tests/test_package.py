import subprocess
import sys

import pytest

import coopmap_env


def test_importing_coopmap_loads_no_compiler_and_registers_the_environments():
    heavy = "numba llvmlite scipy torch tyro matplotlib coopmap_env.envs.planar"
    code = (
        "import sys, coopmap\n"
        f"print(*(name for name in {heavy.split()} if name in sys.modules))\n"
        "import gymnasium, pettingzoo\n"
        "print(gymnasium.spec('coopmap/Planar-v1').id)\n"
        "print('coopmap/Field-v1' in pettingzoo.parallel_registry)\n"
        "print(coopmap.PlanarSettings.__name__, 'torch' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["", "coopmap/Planar-v1", "True", "PlanarSettings False"]


def test_coopmap_shows_its_public_names_only():
    import coopmap

    assert dir(coopmap) == sorted(coopmap.__all__)
    assert coopmap.__version__ == coopmap_env.__version__
    with pytest.raises(AttributeError, match="module 'coopmap' has no attribute 'evaluat'"):
        coopmap.evaluat  # noqa: B018


def test_importing_the_environment_needs_no_extra_and_the_evaluation_is_there_when_asked_for():
    heavy = (
        "torch stable_baselines3 onnxruntime matplotlib jinja2 tyro PIL pygame rtbdata "
        "scipy.ndimage scipy.spatial scipy.stats pybullet trimesh embreex ompl pyoctomap viser "
        "skimage"
    )
    code = (
        "import sys, coopmap_baselines\n"
        "import coopmap_env.planar_v1, coopmap_env.field_v1\n"
        f"print(*(name for name in {heavy.split()} if name in sys.modules))\n"
        "print(coopmap_env.evaluation.evaluate.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["", "evaluate"]


def test_importing_the_environments_loads_no_kernel():
    """Each program that starts would pay for it, some 0.4 s."""
    code = (
        "import gc\n"
        "from numba.core.dispatcher import Dispatcher\n"
        "from coopmap_env import field_v1, planar_v1\n"
        "kernels = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]\n"
        "print(len(kernels) > 100, *(one.py_func.__name__ for one in kernels if one.overloads))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "True"


def test_a_missing_extra_names_its_pip_command():
    from coopmap_env.core.extras import import_optional

    with pytest.raises(ImportError, match=r"pip install 'coopmap\[report\]'"):
        import_optional("no_such_module", "report")
