"""Arguments, seeds and options of every kind; sizes that would take hours or all of the memory."""

from dataclasses import fields, replace

import numpy as np
import pytest
from plain.odd_values import odd_values

from coopmap_env.envs.field import FieldArguments, FieldEnv, FieldSettings, FieldTeamEnv
from coopmap_env.envs.planar import PlanarArguments, PlanarEnv, PlanarSettings, PlanarTeamEnv
from coopmap_env.localization import CorrectionSettings, RegistrationSettings, SearchSettings
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import DepthCamera, PlanarCamera
from coopmap_env.simulation.scenes.field import Clutter, Occluded, Rubble, Worksite
from coopmap_env.simulation.scenes.planar import Corridors, Obstacles, Rooms

SMALL = {"scene": Obstacles(shape=(24, 24), side_max=8.0), "settings": PlanarSettings(crop_cells=8)}
NAMES = [field.name for field in fields(PlanarArguments)]


@pytest.mark.parametrize("make", [PlanarEnv, PlanarTeamEnv])
@pytest.mark.parametrize("name", NAMES)
def test_a_planar_argument_of_any_kind_is_accepted_or_refused_by_its_name(make, name):
    for value in odd_values():
        try:
            env = make(**{**SMALL, name: value})
        except ValueError as error:
            message = str(error)
        else:
            env.close()
            continue
        assert name in message
        assert len(message) < 1_000


@pytest.mark.parametrize("name", [f.name for f in fields(FieldArguments)])
def test_a_field_argument_of_any_kind_is_accepted_or_refused_by_its_name(name):
    for value in odd_values():
        try:
            arguments = FieldArguments(**{name: value})
        except ValueError as error:
            message = str(error)
        else:
            assert name in ("scene", "mount") or isinstance(
                getattr(arguments, name), int | float | str | type(None)
            )
            continue
        assert f"FieldArguments.{name}" in message
        assert len(message) < 1_000


def test_numpy_scalars_are_arguments_and_are_kept_as_plain_values():
    env = PlanarEnv(
        np.int64(3), np.str_("candidates"), max_scans=np.uint8(5), n_candidates=np.int16(4)
    )
    assert env.possible_agents == ["robot_0", "robot_1", "robot_2"]
    assert type(env.max_scans) is int
    assert env.action_space("robot_0").n == 4


@pytest.mark.parametrize("value", [10**30, 10**400, 2**63, 10**6, 1_001])
def test_a_team_of_too_many_robots_is_refused_at_once(value):
    with pytest.raises(ValueError, match=r"n_robots must be an integer >= 1 of at most 1,000"):
        PlanarEnv(n_robots=value)


def test_more_vehicles_than_the_physics_engine_keeps_apart_are_refused_at_once():
    pytest.importorskip("pybullet")
    with pytest.raises(ValueError, match="n_robots must be at most 28"):
        FieldEnv(n_robots=29)


def planar(**changes):
    return {"settings": replace(PlanarSettings(), **changes)}


TOO_LARGE_PLANAR = [
    (lambda: {"n_candidates": 10**9}, "n_candidates"),
    (lambda: {"max_scans": 10**30}, "max_scans"),
    (lambda: {"scene": Obstacles(shape=(10**6, 10**6))}, "shape"),
    (lambda: planar(crop_cells=10**9), "crop_cells"),
    (lambda: planar(crop_cells=20_000), "crop_cells"),
    (lambda: {**planar(crop_cells=1_000), "n_robots": 1_000}, "crop_cells"),
    (lambda: planar(n_headings=10**9), "n_headings"),
    (lambda: planar(camera=PlanarCamera(depth_of_field=1e9)), "depth_of_field"),
    (lambda: planar(camera=PlanarCamera(n_beams=10**9)), "n_beams"),
    (lambda: planar(camera=PlanarCamera(n_beams=10_000), n_headings=3_600), "n_beams"),
]


@pytest.mark.parametrize(("arguments", "name"), TOO_LARGE_PLANAR)
def test_planar_sizes_are_refused_before_memory_is_taken(arguments, name):
    with pytest.raises(ValueError, match=name):
        PlanarEnv(**arguments())


def field(**changes):
    return {"settings": replace(FieldSettings(), **changes)}


def huge_grid():
    return VoxelGrid((5_000, 5_000, 5_000), 0.1, (0.0, 0.0, -1.0))


TOO_LARGE_FIELD = [
    (lambda: {"scene": Worksite(grid=huge_grid())}, "shape"),
    (lambda: {"n_candidates": 10**9}, "n_candidates"),
    (lambda: field(camera=DepthCamera(width=10_000, height=10_000)), "width"),
    (lambda: field(camera=DepthCamera(width=10**12)), "width"),
    (lambda: field(camera=DepthCamera(far=1e6)), "far"),
    (lambda: field(camera=DepthCamera(near=1e5, far=2e5)), "far"),
    (lambda: field(crop_cells=(10**6, 16)), "crop_cells"),
    (lambda: field(crop_cells=(40, 10**9)), "crop_cells"),
    (lambda: field(crop_pooling=10**6), "crop_pooling"),
    (lambda: field(crop_pooling=64, crop_cells=(100, 16)), "crop_pooling"),
    (lambda: field(max_grid_poses=10**12), "max_grid_poses"),
    (lambda: field(correction=CorrectionSettings(target_spacing=1e-9)), "target_spacing"),
    (lambda: field(registration=RegistrationSettings(SearchSettings(n_levels=60))), "n_levels"),
    (lambda: field(registration=RegistrationSettings(SearchSettings(xy_step=1e-9))), "xy_step"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "name"), TOO_LARGE_FIELD)
def test_field_sizes_are_refused_before_memory_is_taken(arguments, name):
    pytest.importorskip("pybullet")
    with pytest.raises(ValueError, match=name):
        FieldEnv(**arguments())


def test_a_camera_that_sees_no_voxel_is_refused():
    pytest.importorskip("pybullet")
    narrow = DepthCamera(horizontal_field_of_view=1e-3, vertical_field_of_view=1e-3)
    with pytest.raises(ValueError, match=r"camera must see a voxel of 0\.1 m"):
        FieldEnv(**field(camera=narrow))


@pytest.mark.parametrize(
    ("scene", "name"),
    [
        (lambda: Worksite(rocks=(0, 10**9)), "Worksite.rocks"),
        (lambda: Rubble(blocks=(40, 10**9)), "Rubble.blocks"),
        (lambda: Occluded(around=(0, 10**9)), "Occluded.around"),
        (lambda: Clutter(object_scale=1e9), "Clutter.object_scale"),
        (lambda: Rooms(furniture=1e9), "Rooms.furniture"),
        (lambda: Corridors(shape=(10**6, 10**6)), "Corridors.shape"),
        (lambda: Obstacles(resolution=1e-29), "Obstacles.resolution"),
    ],
)
def test_scenes_that_would_take_hours_are_refused_by_their_field(scene, name):
    with pytest.raises(ValueError, match=name):
        scene()


def test_a_limit_is_raised_by_its_variable(monkeypatch):
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "1000000")
    with pytest.raises(ValueError, match="COOPMAP_MAX_BYTES"):
        PlanarEnv(settings=PlanarSettings(crop_cells=200))
    monkeypatch.delenv("COOPMAP_MAX_BYTES")
    assert PlanarEnv(settings=PlanarSettings(crop_cells=200)).settings.crop_cells == 200


@pytest.mark.parametrize("make", [PlanarEnv, PlanarTeamEnv])
def test_seeds_and_options_that_are_none_are_refused_by_name_and_leave_the_episode_as_it_is(make):
    env = make(**SMALL)
    env.reset(seed=3)
    parallel = getattr(env, "parallel", env)
    before = parallel.state().tobytes()
    seeds = [v for v in odd_values() if v is not None and not is_seed(v)]
    for seed in [*seeds, -1, -(10**5000), "1", 1.0]:
        with pytest.raises(ValueError, match="seed must be an integer of at least 0") as raised:
            env.reset(seed=seed)
        assert len(str(raised.value)) < 500
    for options in odd_values():
        if options is not None and not isinstance(options, dict):
            with pytest.raises(ValueError, match="options must be a dict or None"):
                env.reset(seed=1, options=options)
    assert parallel.state().tobytes() == before


def is_seed(value):
    is_integer = isinstance(value, int | np.integer) and not isinstance(value, np.timedelta64)
    whole = is_integer or (isinstance(value, np.ndarray) and value.ndim == 0)
    kind = value.dtype.kind if isinstance(value, np.ndarray) else "i"
    return whole and kind in "iu" and not isinstance(value, bool) and int(value) >= 0


def test_large_seeds_are_seeds():
    for make in (PlanarEnv, PlanarTeamEnv):
        first, same = make(**SMALL), make(**SMALL)
        for seed in (2**32, 2**64, 10**30):
            assert repr(first.reset(seed=seed)) == repr(same.reset(seed=seed))


class Wrong(Obstacles):
    """A scene whose method makes something else than a world."""

    def world(self, rng):
        return np.zeros(self.shape, dtype=bool)


def test_a_scene_that_makes_no_world_is_named():
    with pytest.raises(ValueError, match="scene 'obstacles' must make a PlanarWorld, not array"):
        PlanarEnv(scene=Wrong()).reset(seed=0)


def test_an_environment_is_closed_twice_and_used_again():
    for make in (PlanarEnv, PlanarTeamEnv):
        env = make(**SMALL)
        env.close()
        first = repr(env.reset(seed=1))
        env.close()
        env.close()
        assert repr(env.reset(seed=1)) == first


def test_a_closed_field_environment_asks_for_a_reset_and_is_used_again():
    pytest.importorskip("pybullet")
    env = FieldTeamEnv(settings=FieldSettings(crop_cells=(8, 4)))
    env.close()
    first = repr(env.reset(seed=1))
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match=r"closed: call reset\(\)"):
        env.step(np.zeros(env.action_space.shape))
    assert repr(env.reset(seed=1)) == first
    env.close()
