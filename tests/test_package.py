import subprocess
import sys

import pytest


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_importing_the_environment_needs_no_extra_and_no_statistics():
    heavy = (
        "torch stable_baselines3 matplotlib jinja2 tyro PIL pygame rtbdata scipy.stats "
        "pybullet trimesh embreex ompl pyoctomap viser skimage"
    )
    done = run(
        "import sys, coopmap_env, coopmap_baselines\n"
        f"print(*(name for name in {heavy.split()} if name in sys.modules))"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_the_evaluation_is_there_when_asked_for():
    done = run("import coopmap_env; print(coopmap_env.evaluation.evaluate.__name__)")
    assert done.stdout.strip() == "evaluate"


def test_a_missing_extra_names_its_pip_command():
    from coopmap_env.core.extras import import_optional

    with pytest.raises(ImportError, match=r"pip install 'coopmap\[report\]'"):
        import_optional("no_such_module", "report")
