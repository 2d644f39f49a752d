import os
import signal

# Tests run side by side, one on each processor. Threads of torch and BLAS on top of that wait for
# each other: a small training took five times the processor's time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell starts background jobs with SIGINT ignored, and the programs that tests start would
# inherit that: those that are ended by SIGINT would run for ever.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
