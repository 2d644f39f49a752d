"""Whether torch or ONNX Runtime computes networks."""

from __future__ import annotations

import os


def has_torch() -> bool:
    """Whether the extra ``rl`` is installed."""
    try:
        import coopmap_agents._require_rl  # noqa: F401
    except ImportError:
        return False
    return True


def require_torch(path: str | os.PathLike[str]) -> None:
    """Check that a safetensors file can be used here.

    Raises
    ------
    ImportError
        With the pip commands for this file, and for an ONNX file of the same weights.
    """
    try:
        import coopmap_agents._require_rl  # noqa: F401
    except ImportError as error:
        raise ImportError(
            f"{error}, for {path}; an .onnx file of the same weights needs 'coopmap[onnx]' alone"
        ) from error
