import os

# Tests run side by side, one on each processor. Threads of torch and BLAS on top of that wait for
# each other: a small training took five times the processor's time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
