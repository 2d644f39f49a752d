"""How much memory Python and NumPy took at most."""

import tracemalloc
from contextlib import contextmanager


@contextmanager
def memory_below(n_bytes):
    """Assert that the block takes less, also if it raises what the test expects inside."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < n_bytes
    finally:
        tracemalloc.stop()
