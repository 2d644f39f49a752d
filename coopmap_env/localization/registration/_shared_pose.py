"""One pose of the base from views whose camera poses have common and independent errors.

View v sees the base not at its pose x but displaced by e + e_v: the error of the camera's pose, as
a displacement of the base. e is common to all views (calibration of the joints), e_v is independent
(encoders, suspension). With the Gaussian information H_v, g_v of a view's points about x + e + e_v,
both errors are eliminated one after the other,

    W_v = (I + H_v S_v)^-1 H_v,      W = sum W_v,      W' = (I + W S)^-1 W

and likewise g. W is the sum of (H_v^-1 + S_v)^-1, but no view has to determine all of a pose. The
prior of the base is added: x = (W' + P)^-1 (g' + P x_0), with that inverse as its covariance (a
Schur complement: Triggs et al. 2000, section 6).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import eigh, inverse, product, solve
from coopmap_env.geometry import skew

Array = NDArray[np.float64]

_KNOWN_STD = np.array([0.3, 0.3, 0.3, 0.1, 0.1, 0.1])
"""Metres and radians: a direction with a larger standard deviation counts as undetermined."""
_UNKNOWN_VARIANCE_RATIO = 1e4
"""Variance of an undetermined direction, in units of `_KNOWN_STD` squared."""


class SharedPose(NamedTuple):
    """The estimate, to first order about the linearisation point."""

    x: Array
    """Displacement (6,) of the base."""
    covariance: Array
    """Covariance of x, shape (6, 6)."""
    errors: Array
    """e + e_v of each view, (v, 6)."""


def camera_to_base_covariances(
    covariances: Array, t_base_camera: Array, R_target_base: Array
) -> Array:
    """Covariances (v, 6, 6) of camera poses, as those of displacements of the base.

    A camera displaced by [dt, dw] sees what it would see from a base displaced by
    [dt + t x dw, dw]; both are rotated into the target's frame.

    Parameters
    ----------
    covariances : ndarray, shape (v, 6, 6)
        Of T_base_camera, in the base frame.
    t_base_camera : ndarray, shape (v, 3)
        Positions of the cameras, metres.
    R_target_base : ndarray, shape (3, 3)
    """
    A = np.zeros_like(covariances)
    A[:, :3, :3] = A[:, 3:, 3:] = R_target_base
    A[:, :3, 3:] = product(R_target_base, skew(t_base_camera))
    return product(product(A, covariances), A.transpose(0, 2, 1))


def shared_pose(
    H: Array, g: Array, independent: Array, common: Array, P: Array, Px: Array
) -> SharedPose:
    """Estimate x from the views' information about x + e + e_v.

    Parameters
    ----------
    H, g : ndarray, shapes (v, 6, 6) and (v, 6)
        H_v and H_v (x + e + e_v) as measured.
    independent, common : ndarray, shapes (v, 6, 6) and (6, 6)
        Covariances S_v and S of the errors.
    P, Px : ndarray, shapes (6, 6) and (6,)
        Prior: information, and information times x. P must determine what all views together do
        not.
    """
    eye = np.eye(6)
    L = eye + product(H, independent)
    W_v = solve(L, H)
    g_v = solve(L, g[..., None])[..., 0]
    W, w = W_v.sum(axis=0), g_v.sum(axis=0)
    L = eye + product(W, common)
    total = solve(L, W) + P
    total = 0.5 * (total + total.T)
    covariance = inverse(total)
    x = product(covariance, solve(L, w) + Px)
    e = solve(eye + product(common, W), product(common, w - product(W, x)))
    residual = g - product(H, x + e)
    forces = product(independent, residual[..., None])
    e_v = solve(eye + product(independent, H), forces)[..., 0]
    return SharedPose(x, 0.5 * (covariance + covariance.T), e + e_v)


def view_chi2(H: Array, g: Array, independent: Array) -> tuple[Array, Array]:
    """Disagreement of each view with all others: chi^2 (v,) and its degrees of freedom (v,).

    Each view's W_v, g_v are compared with their sum over the other views, in the directions that
    both determine; common errors are in both and cancel. With no such direction, both are 0.
    """
    L = np.eye(6) + product(H, independent)
    W_v = solve(L, H)
    g_v = solve(L, g[..., None])[..., 0]
    chi2, dof = np.zeros(len(H)), np.zeros(len(H))
    for v in range(len(H)):
        W, w = W_v.sum(axis=0) - W_v[v], g_v.sum(axis=0) - g_v[v]
        C_others, C = _covariance_of(W), _covariance_of(W_v[v])
        x_others, x = product(C_others, w), product(C, g_v[v])
        # an undetermined direction is no disagreement: compare where the covariances are small
        spread = C_others + C
        values, vectors = eigh(0.5 * (spread + spread.T) / np.outer(_KNOWN_STD, _KNOWN_STD))
        known = values < 1.0
        along = product(vectors.T, (x - x_others) / _KNOWN_STD)
        chi2[v] = float((along[known] ** 2 / values[known]).sum())
        dof[v] = int(known.sum())
    return chi2, dof


def _covariance_of(W: Array) -> Array:
    """Covariance of an information matrix that may be singular."""
    prior = np.diag(1.0 / (_UNKNOWN_VARIANCE_RATIO * _KNOWN_STD**2))
    return inverse(0.5 * (W + W.T) + prior)
