"""Numbers in the records of searches."""

N_DIGITS = 5


def significant(value: float) -> float:
    """The value with `N_DIGITS` significant digits."""
    return float(f"{value:.{N_DIGITS}g}")
