"""The inverse sensor model: which occupancies one beam with a Gaussian range implies.

A beam crosses cells 0, 1, 2, ... and reports the distance z with standard deviation sigma. Before
the scan each cell in front of a surface is occupied with probability 1/2, independently, and the
beam ends at the first occupied cell. The cells behind that one are occupied with probability b.
Bayes' rule gives, with L_k the likelihood of z if the beam ends at cell k,

    w_k     proportional to (1/2)**k * L_k        probability that the beam ended at cell k
    P_k     = w_k + b * sum of w_j over j < k     occupancy of cell k after the scan.

So a cell is free before the surface, occupied around it, and of probability b behind it. b = 1/2 is
a world of independent cells, in which a scan says nothing about what is behind. Obstacles are
thicker than a cell: of the cells just behind a measured surface about 95 of 100 are occupied, and
b, fitted on training worlds, says so. Only cells up to `posterior_cutoff` are updated, within a few
sigma of z; what lies deeper stays unknown.

Scans add their log-odds, as if each said something of its own about a cell behind a surface. Truly
the second one repeats the prior of the first, although two scans that agree on where a surface is
rule out that noise had moved it. In the field, where of a scan's updates of a cell only one counts,
the sum is too modest at first and too sure at last: on ten training worksites, after 12 scans with
exact poses, such cells with P = 0.972 are occupied in 99.7 and those with P = 0.999 in 99.6 of 100
cases. In 2-D the beams of a single scan add up as well, so that the prior b counts several
times: on 200 training worlds, after 16 scans, such cells with P = 0.933 are occupied in 90 and
those with P = 0.996 in 97 of 100 cases.

Loop, Cai, Orts-Escolano & Chou 2016 ("A closed-form Bayesian fusion equation using occupancy
probabilities") give P(s) = F(s) - F(s - 3)/2, s in units of sigma behind z: obstacles three sigma
thick, hit at any distance with equal probability. For cells of three sigma the sum above equals
that, except for the prior (1/2)**k. It also follows the cells where sigma is smaller, which is the
usual case near the camera.

The model is not made for cells much finer than sigma: the prior moves the end of the beam by
sigma**2 ln 2 / h toward the camera, h being the length of a cell, and P goes to half of a normal
distribution function there. Such a beam frees the cells far before z and adds nothing about z.

In recorded data a wall fills a part of its cells, and beams pass beside it through the rest. Then
(surface "partial") a beam ends anywhere along its path, half of all beams within each cell's
length: w_k counts the length of the path through cell k, so a beam that only crosses a corner
changes the cell little. Within a scan, a beam that passes does not count against one that ends in
the cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import erf, inlined_exp
from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.mapping.log_odds import STEPS_PER_NAT, to_log_odds_fixed

RANGE_WINDOW = 4.0
"""Standard deviations around z within which a beam can have ended; 6e-5 of the mass is beyond."""
MIN_RANGE_SIGMA = 0.01
"""Cells: no observation is trusted beyond a hundredth of a cell, so a noise-free camera is fine."""
LN2 = 0.6931471805599453
MAX_PATH_IN_CELL = 1.75
"""Cells: no less than the longest path through one, so that no cell in which the beam may have
ended is left among the free ones."""


class BeamParameters(NamedTuple):
    """The constants of a `BeamModel`, as kernels take them."""

    lowest: int
    """Lowest update of one scan, log-odds in fixed point."""
    highest: int
    """Highest update of one scan, log-odds in fixed point."""
    surface_at_entry: bool
    partial_surface: bool
    behind: float
    """Occupancy of a cell behind the surface."""
    posterior_cutoff: float
    """Fraction of the posterior mass behind which cells are not updated."""


@dataclass(frozen=True)
class BeamModel(Settings):
    """Constants of the inverse sensor model; those of environments are tuned on training worlds.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    free: Annotated[float, Bounds(above=0, below=0.5)] = 0.001
    """Lowest occupancy that a single scan may give a cell."""
    occupied: Annotated[float, Bounds(above=0.5, below=1)] = 0.998
    """Highest occupancy that a single scan may give a cell."""
    surface: Literal["entry", "anywhere", "partial"] = "entry"
    """Where the surface of an occupied cell lies: at the face by which the beam enters, if the
    cells are the obstacles; anywhere inside, if cells merely contain surfaces; or in a part of the
    cell, beside which other beams of the scan may pass (measured data, 3-D). "partial" has three
    effects: the posterior of the end cell has its own prior (`partial_endpoint_posterior`); of a
    scan's updates of a cell only the strongest counts (`merge_updates`), not the sum; and passing
    beams are weighted by their path (`weight_by_path_length`)."""

    behind: Annotated[float, Bounds(at_least=0.5, below=1)] = 0.5
    """Occupancy of a cell behind the surface. 0.5: nothing is known about it; more where obstacles
    are thicker than a cell."""
    posterior_cutoff: Annotated[float, Bounds(above=0, below=1)] = 0.95
    """Fraction of the posterior mass: cells behind it are not updated."""
    surface_fusion: Literal["eq_4", "mean"] = "eq_4"
    """How the points in a cell make its surface Gaussian: as observations of one point, by Eq. 4;
    or as different points of one face, by their mean (`coopmap_env.mapping.surface_mean`)."""

    @property
    def log_odds_bounds(self) -> tuple[int, int]:
        """`free` and `occupied` as log-odds in fixed point."""
        return to_log_odds_fixed(self.free), to_log_odds_fixed(self.occupied)

    @property
    def surface_at_entry(self) -> bool:
        """Whether surfaces lie at the entry face."""
        return self.surface == "entry"

    @property
    def partial_surface(self) -> bool:
        """Whether surfaces fill a part of their cells."""
        return self.surface == "partial"

    @property
    def parameters(self) -> BeamParameters:
        """The constants, for kernels."""
        return BeamParameters(
            *self.log_odds_bounds,
            self.surface_at_entry,
            self.partial_surface,
            float(self.behind),
            float(self.posterior_cutoff),
        )


@borrowing_kernel
def endpoint_posterior(
    entries: NDArray[np.float64],
    exits: NDArray[np.float64],
    n: int,
    z: float,
    sigma: float,
    surface_at_entry: bool,
    weights: NDArray[np.float64],
) -> int:
    """Write w_k, the probability that the beam ended at cell k of n; return the likeliest k.

    `entries` and `exits` are the distances at which the beam enters and leaves each cell. If no
    cell explains z, the cell that holds z does. The likeliest cell, to which the Gaussian of the
    point belongs, is that of the largest L_k: the prior would pull it towards the camera.
    """
    total = 0.0
    prior = 1.0
    highest = 0.0
    best = 0
    for k in range(n):
        if surface_at_entry:
            a = (z - entries[k]) / sigma
            likelihood = math.exp(-0.5 * a * a)
        else:
            scale = 1.0 / (sigma * math.sqrt(2.0))
            a = (entries[k] - z) * scale
            width = (exits[k] - entries[k]) * scale
            if width > 1e-6:
                likelihood = (math.erf(a + width) - math.erf(a)) / width
            else:  # only a corner, over which the density is even
                likelihood = 2.0 / math.sqrt(math.pi) * math.exp(-a * a)
        weights[k] = prior * likelihood
        total += weights[k]
        prior *= 0.5
        if likelihood > highest:
            best, highest = k, likelihood
    if total <= 0.0:
        best = n - 1
        for k in range(n):
            weights[k] = 0.0
            if z < exits[k]:
                best = min(best, k)
        weights[best] = 1.0
        return best
    for k in range(n):
        weights[k] /= total
    return best


@inlined_kernel
def inlined_half_power(exponent: float) -> float:
    """`half_power`; see `inlined_exp`."""
    return inlined_exp(-LN2 * min(exponent, 1000.0))


@kernel
def half_power(exponent: float) -> float:
    """``0.5**exponent`` of 0 <= exponent <= 1000; beyond, that of 1000."""
    return inlined_half_power(exponent)


@borrowing_kernel
def partial_endpoint_posterior(
    entries: NDArray[np.float64],
    exits: NDArray[np.float64],
    n: int,
    z: float,
    sigma: float,
    weights: NDArray[np.float64],
) -> int:
    """Like `endpoint_posterior`, for a beam that may end anywhere along its path.

    w_k proportional to (1/2)**entry_k * integral of N(z; s, sigma) ds over the path through cell k,
    distances in cells.
    """
    total = 0.0
    highest = 0.0
    best = 0
    scale = 1.0 / (sigma * math.sqrt(2.0))
    upper = 0.0
    for k in range(n):
        # a cell begins where the one before ends: the error function is half of the work
        joined = k > 0 and entries[k] == exits[k - 1]
        lower = upper if joined else erf((entries[k] - z) * scale)
        upper = erf((exits[k] - z) * scale)
        mass = upper - lower
        weights[k] = half_power(entries[k] - entries[0]) * mass if mass > 0.0 else 0.0
        total += weights[k]
        if mass > highest:
            best, highest = k, mass
    if total <= 0.0:
        return endpoint_posterior(entries, exits, n, z, sigma, False, weights)
    for k in range(n):
        weights[k] /= total
    return best


@kernel
def beam_log_odds_fixed(weight: float, before: float, beam: BeamParameters) -> int:
    """Fixed-point log-odds of P_k = w_k + b * before, within the bounds of one scan."""
    lowest, highest = beam.lowest, beam.highest
    p = weight + beam.behind * before
    if p <= 0.0:
        return lowest
    if p >= 1.0:
        return highest
    update = math.floor(math.log(p / (1.0 - p)) * STEPS_PER_NAT + 0.5)
    return min(max(update, lowest), highest)


@inlined_kernel
def merge_updates(one: int, other: int) -> int:
    """Which of two beams' updates of a cell counts where surfaces are partial: ends before passes.

    The strongest of both ends, or of both passes. The update of a cell behind a surface counts as
    an end where b > 1/2: one such beam outweighs all beams of its scan that pass through the cell.
    With the field's constants, b = 0.97, more free voxels get P > 1/2 than with those of v0,
    b = 1/2: 0.068 % instead of 0.050 % of the free ones that were observed (20 test worlds). Fewer
    stay closed to robots, whose limit is P = 0.05: 2.5 % instead of 4.0 %.
    """
    return max(one, other) if one > 0 or other > 0 else min(one, other)


@inlined_kernel
def weight_by_path_length(update: int, path_length: float) -> int:
    """Update by a passing beam, in proportion to its path through the cell (cells), at most 1."""
    return math.floor(update * min(path_length, 1.0) + 0.5)


@kernel
def _write_posterior(
    entries: NDArray[np.float64],
    exits: NDArray[np.float64],
    z: float,
    sigma: float,
    beam: BeamParameters,
    weights: NDArray[np.float64],
) -> None:
    """Write the posterior (n,) of a beam's end, by the model of surfaces that is set."""
    n, at_entry = len(entries), beam.surface_at_entry
    if beam.partial_surface:
        partial_endpoint_posterior(entries, exits, n, z, sigma, weights)
    else:
        endpoint_posterior(entries, exits, n, z, sigma, at_entry, weights)


def beam_occupancy(
    entries: ArrayLike, exits: ArrayLike, z: float, sigma: float, model: BeamModel
) -> NDArray[np.float64]:
    """P_k of every cell that a beam crosses, before a scan's bounds; for plots and tests.

    Parameters
    ----------
    entries, exits : array_like, shape (n,)
        Distances at which the beam enters and leaves each cell, in any unit (cells if surfaces
        are partial).
    z, sigma : float
        Observed distance and its standard deviation, same unit; sigma > 0.

    Raises
    ------
    ValueError
        If there is not one exit for each entry, or sigma is not above 0.
    """
    entries, exits = np.asarray(entries, dtype=np.float64), np.asarray(exits, dtype=np.float64)
    if entries.ndim != 1 or entries.shape != exits.shape:
        raise ValueError(f"entries {entries.shape} and exits {exits.shape} do not fit together")
    if not sigma > 0:
        raise ValueError(f"sigma must be > 0, got {sigma}")
    weights = np.empty(len(entries))
    _write_posterior(entries, exits, float(z), float(sigma), model.parameters, weights)
    before = np.concatenate([[0.0], np.cumsum(weights)[:-1]])
    return weights + model.behind * before
