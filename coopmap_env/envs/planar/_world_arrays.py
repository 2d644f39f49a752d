"""Planar worlds as arrays with a leading axis of worlds, and what one step of them writes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, inlined_kernel
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.random_streams import STATE_WORDS
from coopmap_env.envs.planar._observation_kernels import (
    CropTables,
    FeatureScale,
    WorldExtent,
)
from coopmap_env.envs.planar._starts import StartBuffers, StartSettings
from coopmap_env.envs.rewards import RewardScale
from coopmap_env.information.planar.view_arrays import (
    ReservedCells,
    ViewBuffers,
    ViewTables,
    allocate_reserved,
    allocate_view,
)
from coopmap_env.mapping import GridGeometry, SurfaceArrays
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.beam import BeamParameters
from coopmap_env.mapping.integration_scalar import BeamBuffers, EndCells, allocate_beam
from coopmap_env.robots import LatticeGeometry
from coopmap_env.robots.planar.feasible_poses import PoseSampling, picked_size
from coopmap_env.robots.planar.motion_time import LatticeSpeeds
from coopmap_env.sensing import NoiseParameters
from coopmap_env.sensing.beam_fan import FanArrays
from coopmap_env.simulation.planar_scans import PlanarCameraArrays

N_REWARD_TERMS = 4


class WorldArrays(NamedTuple):
    """The state of E worlds with N robots each, on grids of n cells."""

    occupied: NDArray[np.bool_]
    """The truth (E, n)."""
    log_odds_fixed: NDArray[np.int32]
    """Shape (E, n); see `MapArrays`."""
    sampled_mask: NDArray[np.uint8]
    """Shape (E, n)."""
    codes: NDArray[np.uint8]
    """What views need to know of each cell (E, n); see `cell_codes`."""
    surfaces: SurfaceArrays
    """Shapes (E, n, ...), or (E, 0, ...) where no surfaces are kept."""
    labels: NDArray[np.uint16]
    """Shape (E, n); see `RegionArrays`."""
    access: NDArray[np.uint16]
    """Shape (E, N, 4)."""
    n_labels: NDArray[np.int64]
    """Shape (E, 1)."""
    pose_ids: NDArray[np.int64]
    """Poses of the robots (E, N)."""
    start_streams: NDArray[np.uint64]
    """Random numbers of the start poses (E, 3)."""
    noise_streams: NDArray[np.uint64]
    """Random numbers of the range noise (E, 3)."""
    candidate_streams: NDArray[np.uint64]
    """Random numbers of the candidates (E, 3)."""
    candidates: NDArray[np.int64]
    """Pose ids (E, N, m)."""
    n_candidates: NDArray[np.int64]
    """How many of them there are (E, N)."""
    n_observed: NDArray[np.int64]
    """Sampled cells (E,)."""
    n_scans: NDArray[np.int64]
    """Scans of each robot so far (E,)."""
    elapsed: NDArray[np.float64]
    """Seconds on the clock of the team (E,)."""
    shown_mask: NDArray[np.uint8]
    """1 at the cells that scans have truly shown or that were known at the start (E, n), for
    scores and rewards only; (E, 0) where that is not kept."""
    n_shown: NDArray[np.int64]
    """How many they are (E,)."""

    @classmethod
    def empty(
        cls,
        occupied: NDArray[np.bool_],
        n_robots: int,
        m: int,
        surfaces: SurfaceArrays,
        keeps_shown: bool,
    ) -> WorldArrays:
        """Worlds of these truths (E, n) with empty maps; m is 0 in "pose" mode."""
        n_worlds, team = len(occupied), (len(occupied), n_robots)
        cells = occupied.shape
        return cls(
            occupied,
            np.zeros(cells, dtype=np.int32),
            np.zeros(cells, dtype=np.uint8),
            np.zeros(cells, dtype=np.uint8),
            surfaces,
            np.zeros(cells, dtype=np.uint16),
            np.zeros((*team, 4), dtype=np.uint16),
            np.zeros((n_worlds, 1), dtype=np.int64),
            np.zeros(team, dtype=np.int64),
            np.zeros((n_worlds, STATE_WORDS), dtype=np.uint64),
            np.zeros((n_worlds, STATE_WORDS), dtype=np.uint64),
            np.zeros((n_worlds, STATE_WORDS), dtype=np.uint64),
            np.zeros((*team, m), dtype=np.int64),
            np.zeros(team, dtype=np.int64),
            np.zeros(n_worlds, dtype=np.int64),
            np.zeros(n_worlds, dtype=np.int64),
            np.zeros(n_worlds),
            np.zeros(cells if keeps_shown else (n_worlds, 0), dtype=np.uint8),
            np.zeros(n_worlds, dtype=np.int64),
        )


class StepResults(NamedTuple):
    """What came of a step, for each robot of each world."""

    rewards: NDArray[np.float64]
    """Shape (E, N)."""
    reward_terms: NDArray[np.float64]
    """Shape (E, N, terms), in the order of `REWARD_TERMS`."""
    new_information: NDArray[np.float64]
    """NI of the executed pose, nats (E, N)."""
    distance: NDArray[np.float64]
    """d of Eq. 5 that the camera moved (E, N)."""
    motion_cost: NDArray[np.float64]
    """K d**n of Eq. 9, nats (E, N)."""
    rating: NDArray[np.float64]
    """RF (Eq. 9) of the executed pose (E, N)."""
    new_cells: NDArray[np.int64]
    """Cells sampled for the first time (E, N)."""
    entropy_reduction: NDArray[np.float64]
    """Nats (E, N)."""
    newly_shown: NDArray[np.int64]
    """Cells truly shown for the first time (E, N); 0 where that is not kept."""
    rejections: NDArray[np.int8]
    """FEASIBLE, or why the action was rejected (E, N): results of `feasibility`, or MASKED."""
    collided: NDArray[np.bool_]
    """Shape (E, N)."""
    points: NDArray[np.float64]
    """Scans: ends of the beams (E, N, n_beams, 2), metres."""
    covariances: NDArray[np.float64]
    """Shape (E, N, n_beams, 2, 2), square metres."""
    hit: NDArray[np.bool_]
    """Shape (E, N, n_beams)."""

    @classmethod
    def empty(cls, n_worlds: int, n_robots: int, n_beams: int) -> StepResults:
        """Room for the results of a step."""
        team = (n_worlds, n_robots)
        return cls(
            np.zeros(team),
            np.zeros((*team, N_REWARD_TERMS)),
            np.zeros(team),
            np.zeros(team),
            np.zeros(team),
            np.zeros(team),
            np.zeros(team, dtype=np.int64),
            np.zeros(team),
            np.zeros(team, dtype=np.int64),
            np.zeros(team, dtype=np.int8),
            np.zeros(team, dtype=np.bool_),
            np.zeros((*team, n_beams, 2)),
            np.zeros((*team, n_beams, 2, 2)),
            np.zeros((*team, n_beams), dtype=np.bool_),
        )


class StepConstants(NamedTuple):
    """What is the same for all worlds and steps."""

    grid: GridGeometry
    clamp: int
    """Highest log-odds in fixed point."""
    start: StartSettings
    sampling: PoseSampling
    fan: FanArrays
    views: ViewTables
    code_of_log_odds: NDArray[np.uint8]
    """See `CodeTable`."""
    camera: PlanarCameraArrays
    beam: BeamParameters
    entropy: NDArray[np.float64]
    """Of the clamped log-odds; see `LogOddsRange`."""
    probability: NDArray[np.float64]
    """Likewise."""
    cost_law: tuple[float, float]
    """K and n of Eq. 9."""
    alphas: tuple[float, float]
    """Weights of position and heading in Eq. 5."""
    reward_scale: RewardScale
    reward_term: int
    """Number of the term that is paid."""
    is_reward_shared: bool
    crop: CropTables
    extent: WorldExtent
    feature_scale: FeatureScale
    speeds: LatticeSpeeds
    scan_time: float
    """Seconds."""


class StepScratch(NamedTuple):
    """Buffers of one thread."""

    updates: UpdateBuffers
    touched: NDArray[np.int64]
    """Cells of all scans of a step (N (n + 1),)."""
    beam: BeamBuffers
    hit_cells: NDArray[np.int64]
    """Shape (n_beams,)."""
    free_beams: NDArray[np.uint64]
    """Bits of the beams without a hit (words,)."""
    view_buffers: ViewBuffers
    reserved: ReservedCells
    queue: NDArray[np.int32]
    """Shape (n,)."""
    start: StartBuffers
    picked: NDArray[np.int64]
    """See `sample_feasible_poses`."""
    targets: NDArray[np.int64]
    """Shape (N,)."""
    poses: NDArray[np.float64]
    """Shape (N, 3): metres, radians."""
    ratings: NDArray[np.float64]
    """Cost, P and rating of the team or of all candidates (3, N max(m, 1))."""
    new_information: NDArray[np.float64]
    """Shape (N max(m, 1),)."""
    distance: NDArray[np.float64]
    unknown: NDArray[np.int64]
    candidate_ids: NDArray[np.int64]
    start_ids: NDArray[np.int64]
    shown_cells: NDArray[np.int32]
    """Cells that a scan truly shows."""
    shown_beams: NDArray[np.uint64]
    """Bits of the beams that have met no surface (words,)."""

    @classmethod
    def empty(cls, constants: StepConstants, n_robots: int, m: int) -> StepScratch:
        """Buffers for worlds of n_robots robots with m candidates."""
        n_cells = math.prod(constants.grid.shape)
        check_bytes(8 * n_robots * (n_cells + 1), "a list of the cells that all robots scan")
        n_rated = n_robots * max(m, 1)
        queue = np.empty(n_cells, dtype=np.int32)
        return cls(
            UpdateBuffers.empty(n_cells),
            np.empty(n_robots * (n_cells + 1), dtype=np.int64),
            allocate_beam(constants.grid.shape, 2),
            np.empty(len(constants.camera.beams), dtype=np.int64),
            np.empty(len(constants.fan.all_beams), dtype=np.uint64),
            allocate_view(constants.fan, constants.views),
            allocate_reserved(constants.fan, n_robots),
            queue,
            StartBuffers.empty(constants.grid.shape[:2], queue),
            np.empty(picked_size(max(m, 1)), dtype=np.int64),
            np.empty(n_robots, dtype=np.int64),
            np.empty((n_robots, 3)),
            np.empty((3, n_rated)),
            np.empty(n_rated),
            np.empty(n_rated),
            np.empty(n_rated, dtype=np.int64),
            np.empty(n_rated, dtype=np.int64),
            np.empty(n_rated, dtype=np.int64),
            np.empty(constants.fan.max_visible_cells, dtype=np.int32),
            np.empty(len(constants.fan.all_beams), dtype=np.uint64),
        )


@inlined_kernel
def name_worlds(t: PlainTuple) -> WorldArrays:
    """Name the parts of a plain `WorldArrays`; the other functions do likewise."""
    return WorldArrays(
        t[0], t[1], t[2], t[3], SurfaceArrays(*t[4]), t[5], t[6], t[7], t[8], t[9], t[10], t[11],
        t[12], t[13], t[14], t[15], t[16], t[17], t[18],
    )  # fmt: skip


@inlined_kernel
def name_results(t: PlainTuple) -> StepResults:
    return StepResults(*t)


@inlined_kernel
def name_constants(t: PlainTuple) -> StepConstants:
    sampling = PoseSampling(LatticeGeometry(*t[3][0]), t[3][1], t[3][2])
    camera = PlanarCameraArrays(t[7][0], t[7][1], NoiseParameters(*t[7][2]))
    return StepConstants(
        GridGeometry(*t[0]), t[1], StartSettings(*t[2]), sampling, FanArrays(*t[4]),
        ViewTables(*t[5]), t[6], camera, BeamParameters(*t[8]), t[9], t[10], t[11], t[12],
        RewardScale(*t[13]), t[14], t[15], CropTables(*t[16]), WorldExtent(*t[17]),
        FeatureScale(*t[18]), LatticeSpeeds(*t[19]), t[20],
    )  # fmt: skip


@inlined_kernel
def name_scratch(t: PlainTuple) -> StepScratch:
    beam = BeamBuffers(EndCells(*t[2][0]), t[2][1], t[2][2], t[2][3])
    return StepScratch(
        UpdateBuffers(*t[0]), t[1], beam, t[3], t[4], ViewBuffers(*t[5]), ReservedCells(*t[6]),
        t[7], StartBuffers(*t[8]), t[9], t[10], t[11], t[12], t[13], t[14], t[15], t[16], t[17],
        t[18], t[19],
    )  # fmt: skip
