import subprocess
import sys

import pytest


def test_importing_the_environment_needs_no_extra_and_the_evaluation_is_there_when_asked_for():
    heavy = (
        "torch stable_baselines3 matplotlib jinja2 tyro PIL pygame rtbdata scipy.stats "
        "pybullet trimesh embreex ompl pyoctomap viser skimage"
    )
    code = (
        "import sys, coopmap_env, coopmap_baselines\n"
        f"print(*(name for name in {heavy.split()} if name in sys.modules))\n"
        "print(coopmap_env.evaluation.evaluate.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["", "evaluate"]


def test_a_missing_extra_names_its_pip_command():
    from coopmap_env.core.extras import import_optional

    with pytest.raises(ImportError, match=r"pip install 'coopmap\[report\]'"):
        import_optional("no_such_module", "report")
