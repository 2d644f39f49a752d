"""An estimate with its confidence interval."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval.

    ``str(interval)`` reads "9.12 [8.90, 9.33]"; ``f"{interval:.3f}"`` sets the digits.
    """

    estimate: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        spec = spec or ".2f"
        return f"{self.estimate:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def __str__(self) -> str:
        return format(self, "")

    def as_dict(self) -> dict[str, float]:
        """Return estimate, low and high by name, ready for JSON."""
        return asdict(self)
