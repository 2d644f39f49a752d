"""What the commands say while they work."""

import sys


def log(text: str) -> None:
    """Print a line where progress belongs, apart from results."""
    print(text, file=sys.stderr, flush=True)
