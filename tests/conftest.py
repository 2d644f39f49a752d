import os
import signal
from pathlib import Path

# Tests run side by side, one on each processor. Threads of torch and BLAS on top of that wait for
# each other: a small training took five times the processor's time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Programs that tests start import what the tests import. With the folder that they start in, often
# this repository, in their path they would take its sources, and numba would compile for these all
# kernels again.
os.environ["PYTHONSAFEPATH"] = "1"

# A shell starts background jobs with SIGINT ignored, nohup with SIGHUP. The programs that tests
# start would inherit that, and those that are ended by such a signal would run for ever. A handler
# that does nothing is not inherited.
for signum in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(signum) == signal.SIG_IGN:
        signal.signal(signum, lambda *_: None)

TESTS = Path(__file__).parent
LONGEST = (
    "agents/test_rllib.py",
    "test_kill_and_resume.py",
    "test_golden_trajectories.py",
    "test_notebooks.py",
    "studies/test_speed.py",
    "studies/test_section3.py",
    "studies/test_localization_study.py",
    "studies/test_equality.py",
    "agents/test_ppo_learns.py",
)
"""Files with tests of half a minute and more, the longest first."""


def pytest_collection_modifyitems(items):
    """The longest tests begin first: at the end, one would run while other processors wait."""
    order = {TESTS / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path, len(order)))
