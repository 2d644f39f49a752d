import os
import signal

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
