"""Where a body rests on its springs: by hand, by least energy, by what PyBullet swings to."""

from dataclasses import replace

import numpy as np
import pytest
from plain.crane import BODY_MASS, SLIDER_MASS, crane, potential_energy
from scipy.optimize import minimize

from coopmap_env.robots import GRAVITY, Equilibrium, Suspension, make_mount

pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def mast():
    return make_mount("mast")


def test_at_home_nothing_is_deflected(mast):
    settled = Equilibrium.from_mount(mast).rest_configurations(np.array([mast.home]))
    assert settled[0, :3] == pytest.approx([0, 0, 0], abs=1e-12)
    assert settled[0, 3:].tolist() == list(mast.home)


def test_the_springs_carry_the_weight(mast):
    """Post, arms, wrist, head and camera weigh 25.01 kg, the chassis 120, two links 1 g each."""
    equilibrium = Equilibrium.from_mount(mast)
    assert equilibrium.springs.preload[0] == pytest.approx(145.012 * 9.81)
    assert equilibrium.model.pivot == pytest.approx([0, 0, 0.25])


@pytest.mark.parametrize(
    ("along", "roll", "pitch"), [("1 0 0", 0.0, 1.0), ("0 1 0", -1.0, 0.0), ("-1 0 0", 0.0, -1.0)]
)
def test_a_mass_off_axis_rotates_the_body_by_its_moment_over_the_stiffness(
    tmp_path, along, roll, pitch
):
    """10 kg, 0.5 m out, on springs of 9000 and 12000 N m/rad: 5.45 and 4.09 milliradians.

    Forward, the nose goes down: a positive turn about y. To the left, the left side goes down: a
    negative turn about x. What this leaves out is of second order, 1e-5 of it.
    """
    equilibrium = Equilibrium.from_mount(crane(tmp_path, along))
    heave, by_roll, by_pitch = equilibrium.rest_configurations(np.array([[0.5]]))[0, :3]
    moment = SLIDER_MASS * GRAVITY * 0.5
    assert heave == pytest.approx(0.0, abs=1e-12)
    assert by_roll == pytest.approx(roll * moment / 9000, rel=1e-4)
    assert by_pitch == pytest.approx(pitch * moment / 12000, rel=1e-4)


def test_rest_is_where_the_energy_is_least(mast):
    """A minimum by differences of energies is known to the square root of their rounding."""
    equilibrium, chain = Equilibrium.from_mount(mast), mast.chain(with_suspension=True)
    rng, springs = np.random.default_rng(0), equilibrium.springs
    joints = rng.uniform(chain.lower[3:], chain.upper[3:], (4, 5))
    scale = np.array([1e-3, 1e-2, 1e-2])
    for q, settled in zip(joints, equilibrium.rest_configurations(joints), strict=True):
        found = minimize(
            lambda x, q=q: potential_energy(chain, springs, [0, 0, -GRAVITY], x * scale, q),
            np.zeros(3), method="BFGS", options={"gtol": 1e-7},
        )  # fmt: skip
        assert settled[:3] == pytest.approx(found.x * scale, abs=2e-6)


def test_rest_on_a_slope_is_where_the_energy_is_least(tmp_path):
    """Soft springs and a steep slope, so that nothing is small."""
    soft = Suspension(heave_stiffness=2e3, roll_stiffness=800.0, pitch_stiffness=900.0)
    mount = crane(tmp_path, "0.6 0.8 0", suspension=soft)
    gravity = GRAVITY * np.array([0.3, -0.2, -0.9])
    equilibrium, chain = Equilibrium.from_mount(mount, gravity), mount.chain(with_suspension=True)
    assert equilibrium.rest_configurations(np.array([[0.0]]))[0, :3] == pytest.approx(
        [0, 0, 0], abs=1e-12
    )
    springs = equilibrium.springs
    for slide in (-1.5, 1.9):
        settled = equilibrium.rest_configurations(np.array([[slide]]))[0]
        found = minimize(
            lambda x, s=slide: potential_energy(chain, springs, gravity, x, np.array([s])),
            np.zeros(3), method="BFGS", options={"gtol": 1e-9},
        )  # fmt: skip
        assert np.abs(settled[1:3]).min() > 0.03
        assert settled[:3] == pytest.approx(found.x, abs=1e-6)


def test_stiffer_springs_give_way_less(mast):
    joints = np.array([[1.2, 0.5, 0.4, 0.0, 0.0]])
    stiff = replace(mast, suspension=Suspension(roll_stiffness=18_000.0))
    soft, hard = (
        Equilibrium.from_mount(mast).rest_configurations(joints),
        Equilibrium.from_mount(stiff).rest_configurations(joints),
    )
    assert abs(hard[0, 1]) == pytest.approx(abs(soft[0, 1]) / 2, rel=0.03)


def test_deflections_of_the_mast_are_of_a_plausible_size(mast):
    """Tenths of a degree, seldom more than one."""
    chain = mast.chain()
    joints = np.random.default_rng(1).uniform(chain.lower, chain.upper, (500, 5))
    tilt = np.degrees(np.abs(Equilibrium.from_mount(mast).rest_configurations(joints)[:, 1:3])).max(
        axis=1
    )
    assert 0.05 < np.median(tilt) < 1.0
    assert tilt.max() < 3.0


@pytest.mark.parametrize(
    "compliance", [[-0.2, 1.0], [1.0, 0.0], [np.nan, 1.0], [1.0, np.inf], [1.0], [1.0, 1.0, 1.0]]
)
def test_a_compliance_that_is_not_two_numbers_above_zero_is_an_error(mast, compliance):
    equilibrium = Equilibrium.from_mount(mast)
    with pytest.raises(ValueError, match=r"compliance must be two .* above 0, got \[.*\]"):
        equilibrium.with_compliance(np.array(compliance))


def test_a_suspension_with_other_axes_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="heave along z, then roll about"):
        Equilibrium.from_mount(crane(tmp_path, roll_axis="0 0 1"))


def test_a_mount_without_a_suspension_has_no_equilibrium(mast):
    with pytest.raises(ValueError, match="no suspension"):
        Equilibrium.from_mount(replace(mast, suspension=None))


def test_masses_are_those_of_the_links(tmp_path):
    assert Equilibrium.from_mount(crane(tmp_path)).model.masses.sum() == pytest.approx(
        BODY_MASS + SLIDER_MASS + 0.002
    )
