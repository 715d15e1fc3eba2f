"""Directional albedos of GGX lobes, by quadrature in float64: what is lost, what a coat lets pass.

One table for each roughness (and index of refraction) that a scene has, in the layout that
cl/materials/compensation.cl states. Directions are local, z the surface's normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene import limits

from penumbra_kernels.layout import CONSTANTS

Array = NDArray[np.float64]

NODES: Final = CONSTANTS["ALBEDO_NODES"]
AZIMUTHS: Final = CONSTANTS["ALBEDO_AZIMUTHS"]
HEADER: Final = 4
ROWS: Final = HEADER + 2 * NODES
"""Where a loss table's rows begin; a coat's begin right after the header."""

QUADRATURE: Final = 40
"""Nodes per dimension of the integral over visible normals: albedos to some 3e-4."""
CELL_QUADRATURE: Final = 6
"""Nodes per table cell and quadrant of azimuth when a table itself is integrated."""
COAT_SCALE: Final = 0.25
"""k of a coat's table: Fresnel reflectance varies over heights of this order, whatever the roughness."""
LOWEST: Final = 1e-6
"""Height that stands for 0 in the first node: the limit exists, the formulas are 0/0 there."""


@dataclass(frozen=True)
class Albedo:
    """Parts of the light that arrives from one direction, each (directions,)."""

    reflected: Array
    transmitted: Array
    fresnel: Array
    """Mean Fresnel reflectance over the visible normals: what they would reflect without masking."""


def fresnel(c: Array, eta: float) -> tuple[Array, Array]:
    """Unpolarised reflectance and the refracted cosine for cosines c; eta: far index over near index."""
    scaled = np.sqrt(np.maximum(eta * eta - 1.0 + c * c, 0.0))
    cos_t = scaled / eta
    with np.errstate(invalid="ignore"):
        across = np.where(c + scaled > 0, (c - scaled) / (c + scaled), 1.0)
        along = np.where(c + scaled > 0, (eta * c - cos_t) / (eta * c + cos_t), 1.0)
    return np.where(scaled > 0, 0.5 * (across**2 + along**2), 1.0), cos_t


def _visible_normals(wo: Array, ax: float, ay: float) -> tuple[Array, Array]:
    """Normals visible from wo (directions, 3), as (directions, nodes, 3), and their weights (nodes,).

    Spherical caps (Dupuy and Benyoub 2023), over Gauss nodes in height and the midpoint rule in azimuth, half
    of which is enough where every wo lies in the plane y = 0.
    """
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    u = 0.5 * (x + 1.0)
    count = QUADRATURE if wo[:, 1].any() else QUADRATURE // 2
    phi = (np.arange(count) + 0.5) * (2.0 * np.pi / QUADRATURE)
    standard = wo * (ax, ay, 1.0)
    standard /= np.linalg.norm(standard, axis=-1, keepdims=True)
    below = u * (1.0 + standard[:, 2:3])  # 1 - z on the cap
    sine = np.sqrt(below * (2.0 - below))
    h = np.empty((len(wo), QUADRATURE, count, 3))
    h[..., 0] = ax * (sine[:, :, None] * np.cos(phi) + standard[:, None, None, 0])
    h[..., 1] = ay * (sine[:, :, None] * np.sin(phi) + standard[:, None, None, 1])
    h[..., 2] = ((1.0 - u) * (1.0 + standard[:, 2:3]))[:, :, None]
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    weights = np.repeat(0.5 * w, count) / count
    return h.reshape(len(wo), -1, 3), weights


def _length(w: Array, ax: float, ay: float) -> Array:
    """L(w) of cl/materials/microfacet.cl."""
    return np.sqrt(w[..., 2] ** 2 + (ax * w[..., 0]) ** 2 + (ay * w[..., 1]) ** 2)


def albedo(wo: Array, ax: float, ay: float, eta: float | None) -> Albedo:
    """Single-scattering albedo towards wo (directions, 3) with z > 0; eta None: a perfect reflector."""
    h, weights = _visible_normals(wo, ax, ay)
    c = np.einsum("dk,dnk->dn", wo, h)
    out = wo[:, None, :]
    wi = 2.0 * c[..., None] * h - out
    zo, zi = out[..., 2], np.maximum(wi[..., 2], 0.0)
    lo, li = _length(out, ax, ay), _length(wi, ax, ay)
    seen = zi * (zo + lo) / (zo * li + zi * lo)  # G2 / G1(wo)
    if eta is None:
        return Albedo(seen @ weights, np.zeros(len(wo)), np.ones(len(wo)))
    f, cos_t = fresnel(c, eta)
    wt = h * (c / eta - cos_t)[..., None] - out / eta
    zt = np.maximum(-wt[..., 2], 0.0)
    passing = (1.0 - f) * 2.0 * zt / (zt + _length(wt, ax, ay))
    return Albedo((f * seen) @ weights, passing @ weights, f @ weights)


def heights(k: float) -> Array:
    """The table's nodes: heights z with z (1 + k) / (z + k) evenly spaced in [0, 1]."""
    t = np.linspace(0.0, 1.0, NODES)
    return np.minimum(t * k / (1.0 + k - t), 1.0)


def _directions(k: float, anisotropic: bool) -> Array:
    """The table's directions, (rows * NODES, 3)."""
    z = np.maximum(heights(k), LOWEST)
    cos2 = np.linspace(0.0, 1.0, AZIMUTHS) if anisotropic else np.array([1.0])
    r = np.sqrt(1.0 - z * z)
    w = np.empty((len(cos2), NODES, 3))
    w[..., 0] = np.sqrt(cos2)[:, None] * r
    w[..., 1] = np.sqrt(1.0 - cos2)[:, None] * r
    w[..., 2] = z
    return w.reshape(-1, 3)


def _mean_over_azimuth(rows: Array) -> Array:
    """Mean of (rows, NODES) over the azimuth, interpolated in its squared cosine as the device does."""
    if len(rows) == 1:
        return np.asarray(rows[0])
    cos2 = np.cos((np.arange(64) + 0.5) * (0.5 * np.pi / 64)) ** 2
    nodes = np.linspace(0.0, 1.0, len(rows))
    weights = np.array([np.mean(np.interp(cos2, nodes, row)) for row in np.eye(len(rows))])
    return np.asarray(weights @ rows)


def _cell_masses(mean: Array, k: float) -> Array:
    """The integral of mean(z) 2 z dz over each cell, mean interpolated as the device does: (NODES - 1,)."""
    x, w = np.polynomial.legendre.leggauss(CELL_QUADRATURE)
    z = heights(k)
    low, high = z[:-1, None], z[1:, None]
    at = low + (high - low) * 0.5 * (x + 1.0)
    fraction = at * (1.0 + k) / (at + k) * (NODES - 1) - np.arange(NODES - 1)[:, None]
    values = mean[:-1, None] + (mean[1:] - mean[:-1])[:, None] * fraction
    return np.asarray((values * 2.0 * at * 0.5 * w * (high - low)).sum(axis=1))


def _loss_table(missing: Array, k: float, transmitted: float) -> tuple[Array, float]:
    """One table of compensation.cl from missing light (rows, NODES), and its cosine-weighted mean."""
    mean = _mean_over_azimuth(missing)
    masses = _cell_masses(mean, k)
    total = float(masses.sum())
    squares = np.diff(heights(k) ** 2)
    share = masses / total if total > 0 else squares
    cdf = np.concatenate([[0.0], np.cumsum(share)])
    cdf[-1] = 1.0
    header = [k, 1.0 / total if total > 0 else 0.0, transmitted, 1.0 - total]
    density = np.concatenate([share / squares, [0.0]])
    return np.concatenate([header, cdf, density, missing.reshape(-1)]), total


def _missing(ax: float, ay: float, eta: float | None) -> tuple[Array, float]:
    """Light that single scattering loses, (rows, NODES), and the table's k: at heights of order alpha."""
    k = max(ax, ay)
    part = albedo(_directions(k, ax != ay), ax, ay, eta)
    missing = np.clip(1.0 - part.reflected - part.transmitted, 0.0, 1.0)
    return missing.reshape(-1, NODES), k


def mean_fresnel(eta: float) -> float:
    """Cosine-weighted mean of the Fresnel reflectance over directions."""
    x, w = np.polynomial.legendre.leggauss(256)
    # z = s^3 (4 - 3 s): both ends are smoothed, and the critical angle of eta < 1 is an integrable kink.
    z0 = np.sqrt(max(1.0 - eta * eta, 0.0))
    s = 0.5 * (x + 1.0)
    z = z0 + (1.0 - z0) * s * s * s * (4.0 - 3.0 * s)
    dz = (1.0 - z0) * 12.0 * s * s * (1.0 - s)
    return float(z0 * z0 + (fresnel(z, eta)[0] * 2.0 * z * dz * 0.5 * w).sum())


@lru_cache(maxsize=limits.MAX_ALBEDO_TABLES)
def conductor_table(ax: float, ay: float) -> Array:
    """Losses of a perfect reflector; E1 = its mean albedo."""
    missing, k = _missing(ax, ay, None)
    return _loss_table(missing, k, 0.0)[0]


@lru_cache(maxsize=limits.MAX_ALBEDO_TABLES)
def sheet_table(alpha: float, ior: float) -> Array:
    """Losses of a thin sheet: a reflector's; what is given back passes as diffuse light would."""
    missing, k = _missing(alpha, alpha, None)
    mean = mean_fresnel(ior)
    return _loss_table(missing, k, 1.0 - 2.0 * mean / (1.0 + mean))[0]


@lru_cache(maxsize=limits.MAX_ALBEDO_TABLES)
def dielectric_tables(ax: float, ay: float, ior: float) -> Array:
    """Losses seen from outside and from inside, one table after the other.

    With A the mean losses of the two sides and x the shares of them that leave on the other one, reciprocity
    asks for x_outer A_outer = ior^2 x_inner A_inner. x_outer is that of diffuse light, 1 - mean Fresnel,
    unless x_inner would exceed 1.
    """
    outer, k = _missing(ax, ay, ior)
    inner, _ = _missing(ax, ay, 1.0 / ior)
    _, outer_mean = _loss_table(outer, k, 0.0)
    _, inner_mean = _loss_table(inner, k, 0.0)
    if min(outer_mean, inner_mean) <= 0.0:
        from_outside, from_inside = 0.0, 0.0
    else:
        bound = ior * ior * inner_mean / outer_mean
        from_outside = min(1.0 - mean_fresnel(ior), bound)
        from_inside = from_outside / bound
    return np.concatenate([_loss_table(outer, k, from_outside)[0], _loss_table(inner, k, from_inside)[0]])


@lru_cache(maxsize=limits.MAX_ALBEDO_TABLES)
def coat_table(ax: float, ay: float, ior: float, compensate: bool) -> Array:
    """What a dielectric coat lets pass: all that it does not reflect, or, not compensated, what Fresnel lets
    pass, so that light lost between microfacets stays lost. A perfectly smooth coat has only its mean."""
    if ax == 0.0:
        return np.array([1.0, 1.0 / (1.0 - mean_fresnel(ior)), 0.0, 0.0])
    k = max(ax, ay, COAT_SCALE)
    part = albedo(_directions(k, ax != ay), ax, ay, ior)
    passing = (1.0 - (part.reflected if compensate else part.fresnel)).reshape(-1, NODES)
    mean = float(_cell_masses(_mean_over_azimuth(passing), k).sum())
    return np.concatenate([[k, 1.0 / mean, 0.0, 1.0 - mean], passing.reshape(-1)])
