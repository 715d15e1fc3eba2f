"""Hard cases 19-25: frames, microfacets, Fresnel, energy and reciprocity. The local frame: z the surface's normal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy import stats

from penumbra_kernels.hardcases.benches.materials import (
    RECIPROCAL,
    TILTED,
    MaterialBench,
    Parts,
    albedo_of,
    exact_fresnel,
    function_of,
)
from penumbra_kernels.hardcases.case import (
    FALSE_ALARM,
    HardCase,
    Measure,
    Workbench,
    Z,
    at_least,
    at_most,
    enough,
    hard_case,
)


@hard_case(
    19,
    "frame-at-the-pole",
    "Frames about normals that point nearly down, n.z = -1 + 1e-8, are orthonormal.",
    oracle="the Gram matrix and the determinant of the frame are 1",
    algorithm="Duff et al. 2017, listing 3: the sign of n.z keeps the denominator away from 0",
)
def frame_at_the_pole(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(2)
    tilt = 10.0 ** rng.uniform(-9, 0, bench.count(20_000, 1_000_000))
    phi = rng.uniform(0, 2 * np.pi, len(tilt))
    z = rng.choice([-1.0, 1.0], len(tilt)) * np.sqrt(1 - np.minimum(tilt, 1) ** 2)
    n = np.stack([tilt * np.cos(phi), tilt * np.sin(phi), z], -1)
    n = np.concatenate([n, [[0, 0, 1], [0, 0, -1], [-0.0, 0, -1], [1.2e-4, 0, -1 + 1e-8]]])
    n = (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
    out = bench.get(Parts).run("frame", [n], (len(n), 6)).astype(np.float64)
    basis = np.stack([out[:, :3], out[:, 3:], n.astype(np.float64)], axis=1)
    gram = basis @ basis.transpose(0, 2, 1)
    yield at_most("largest deviation of the Gram matrix from 1", np.abs(gram - np.eye(3)).max(), 1e-6)
    yield at_most("largest deviation of the determinant from 1", np.abs(np.linalg.det(basis) - 1).max(), 1e-6)


@hard_case(
    20,
    "narrow-ggx",
    "The density of GGX normals at alpha 1e-3 and 1e-4, also across and along a brush.",
    oracle="float64, relative error 1e-5",
    algorithm="cos^2 alpha^2 beside x^2 + y^2: no 1 - cos^2, no power of a tangent, some 8 roundings",
)
def narrow_ggx(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(5)
    n = bench.count(50_000, 1_000_000)
    for alpha in ((1.0, 1.0), (0.1, 0.1), (1e-3, 1e-3), (1e-4, 1e-4), (0.5, 1e-4), (1e-3, 0.9)):
        phi = rng.uniform(0, 2 * np.pi, n)
        tangent = np.exp(rng.uniform(np.log(1e-6), np.log(1e3), n))
        m = np.stack([tangent * np.cos(phi), tangent * np.sin(phi), np.ones(n)], -1)
        m = (m / np.linalg.norm(m, axis=1, keepdims=True)).astype(np.float32)
        out = bench.get(Parts).run("density", [m, alpha], (n,))
        a, b = np.asarray(alpha, np.float32).astype(np.float64)
        x, y, z = m.astype(np.float64).T
        expected = 1.0 / (np.pi * a * b * ((x / a) ** 2 + (y / b) ** 2 + z * z) ** 2)
        yield at_most(
            f"relative error, alpha {alpha[0]:g}, {alpha[1]:g}", np.abs(out / expected - 1).max(), 1e-5
        )


ALPHAS: Final = ((1e-4, 1e-4), (1e-3, 1e-3), (0.1, 0.1), (1.0, 1.0), (0.5, 1e-3))
COSINES: Final = (1.0, 0.5, 1e-2, 1e-4, 1e-6)


def _visible_normals(bench: Workbench, alpha: tuple[float, float], cosine: float) -> tuple[float, int, int]:
    """(p-value, normals that are not finite or below the surface, normals beyond the test's cells).

    Stretched to roughness 1, w mirrored about its visible normals is uniform over the cap of directions above -w.z
    (Dupuy and Benyoub 2023, section 3): both coordinates there are uniform numbers.
    """
    n = bench.count(100_000, 1_000_000)
    u = np.random.default_rng(17).integers(0, 1 << 24, (n, 2)) * 2.0**-24
    sine = np.sqrt(1 - cosine * cosine)
    wo = np.asarray([sine * 0.8, sine * 0.6, cosine], np.float32)
    m = bench.get(Parts).run("visible", [u, wo, alpha], (n, 3))
    broken = int(np.count_nonzero(~(np.isfinite(m).all(axis=1) & (m[:, 2] > 0))))
    a = np.asarray([*alpha, 1.0], np.float32).astype(np.float64)
    w = wo.astype(np.float64) * a
    w /= np.linalg.norm(w)
    standard = m.astype(np.float64) / a
    standard /= np.linalg.norm(standard, axis=1, keepdims=True)
    cap = 2 * (standard @ w)[:, None] * standard - w
    height = (cap[:, 2] + w[2]) / (1 + w[2])
    angle = np.arctan2(cap[:, 1], cap[:, 0]) / (2 * np.pi) + 0.5
    seen, _, _ = np.histogram2d(height, angle, bins=16, range=[[0, 1], [0, 1]])
    expected = seen.sum() / 256
    return float(stats.chi2.sf(((seen - expected) ** 2 / expected).sum(), 255)), broken, int(n - seen.sum())


@hard_case(
    21,
    "visible-normals",
    "Visible normals of alpha 1e-4 to 1 seen at cosines of 1 down to 1e-6.",
    oracle="chi^2 against the uniform cap; weights of at most 1; no NaN; a mirror below alpha 1e-4",
    algorithm="Spherical caps (Dupuy and Benyoub 2023), the sine from both heights; below alpha 1e-4 a perfect mirror",
)
def visible_normals(bench: Workbench) -> Iterator[Measure]:
    broken = beyond = 0
    for alpha in ALPHAS:
        found = [_visible_normals(bench, alpha, cosine) for cosine in COSINES]
        yield at_least(
            f"smallest of {len(found)} p-values, alpha {alpha[0]:g}, {alpha[1]:g}",
            min(f[0] for f in found),
            FALSE_ALARM,
        )
        broken += sum(f[1] for f in found)
        beyond = max(beyond, *(f[2] for f in found))
    yield at_most("normals not finite, or below the surface", broken, 0)
    yield at_most("normals that rounding puts just outside the cap, most of one setting", beyond, 20)
    materials = bench.get(MaterialBench)
    largest = 0.0
    for width in (1e-4, 1e-3, 0.1, 1.0):
        metal = {
            "type": "conductor",
            "base_color": 1,
            "roughness": np.sqrt(width),
            "energy_compensation": False,
        }
        for cosine in COSINES:
            s = materials.sample(metal, materials.toward(cosine), materials.uniforms(20_000, 3))
            largest = max(largest, float(s.weight[s.alive].max(initial=0)))
    yield at_most("largest weight", largest, 1 + 2.0**-20)
    up = (0.0, 0.0, 1.0)
    lobes = [materials.describe({"type": "conductor", "roughness": r}, up)[1][0] for r in (0.0099, 0.0101)]
    yield at_most("rough lobes below alpha 1e-4", lobes[0], 0)
    yield at_least("rough lobes above alpha 1e-4", lobes[1], 1)


@hard_case(
    22,
    "ggx-furnace",
    "White metal in a white furnace: single scattering loses just what it must, compensation brings it back.",
    oracle="1 - ln 2 (alpha 1), .6877 (alpha .5), both at normal incidence; .8834 (alpha .1, cosine .1); compensated 1 +- 1 %",
    algorithm="Height-correlated Smith (Heitz 2014); multiple scattering by a tabled second lobe (Kulla and Conty 2017)",
)
def ggx_furnace(bench: Workbench) -> Iterator[Measure]:
    materials = bench.get(MaterialBench)
    n = bench.count(100_000, 1_000_000)
    for alpha, cosine, expected in ((1.0, 1.0, 0.30685), (0.5, 1.0, 0.6877), (0.1, 0.1, 0.8834)):
        metal = {
            "type": "conductor",
            "base_color": 1,
            "roughness": float(np.sqrt(alpha)),
            "energy_compensation": False,
        }
        mean, error = albedo_of(materials, metal, cosine, samples=n)
        # Known to four or five digits: half a unit in the last.
        z = max(abs(mean - expected) - 5e-5, 0.0) / error
        yield at_most(f"|z| of the energy {mean:.4f}, alpha {alpha:g}, cosine {cosine:g}", z, Z)
    worst = 0.0
    for alpha in (1e-3, 0.1, 0.3, 1.0):
        for cosine in (1.0, 0.3, 0.1, 1e-3):
            metal = {"type": "conductor", "base_color": 1, "roughness": float(np.sqrt(alpha))}
            mean, error = albedo_of(materials, metal, cosine, samples=n)
            worst = max(worst, abs(mean - 1) - Z * error)
    yield at_most("compensated energy, |1 - mean| beyond its noise", worst, 0.01)


@hard_case(
    23,
    "reciprocity",
    "Light goes both ways alike through every material, about straight and bent shading normals.",
    oracle="f(i, o) = f(o, i), transmission scaled by eta^2 (Veach 1997, eq. 5.14)",
    algorithm="One expression for both directions; values are f times the cosine of the shading normal",
)
def reciprocity(bench: Workbench) -> Iterator[Measure]:
    materials = bench.get(MaterialBench)
    n = bench.count(50_000, 200_000)
    for name, material in RECIPROCAL.items():
        errors = []
        for frame in (materials.FLAT, TILTED):
            wo, wi = materials.directions(n, 1), materials.directions(n, 2)
            # Cosines carry absolute errors of some 2^-23: beyond a fiftieth they are good to 1e-5.
            clear = (np.abs(wo @ np.asarray(frame[1])) > 0.02) & (np.abs(wi @ np.asarray(frame[1])) > 0.02)
            there = function_of(materials, material, frame, wo[clear], wi[clear])
            back = function_of(materials, material, frame, wi[clear], wo[clear])
            errors.append(np.abs(there - back) / np.maximum(np.abs(there), 1.0))
        error = np.concatenate(errors).max(axis=1)
        yield at_most(f"pairs that differ by more than 1e-5, {name}", np.mean(error > 1e-5), 1e-3)
        # On the flank of a narrow refracted lobe the rounding of the half vector is amplified.
        yield at_most(f"largest difference, {name}", error.max(), 1.1e-4)


@hard_case(
    24,
    "critical-angle",
    "Fresnel reflectance at the critical angle and 1e-7 to either side of it.",
    oracle="extended precision, absolute error 2e-6; at most 1, never NaN",
    algorithm="eta^2 - 1 + c^2 from error-free products and sums (fma; Dekker 1971); total reflection where it is not positive",
)
def critical_angle(bench: Workbench) -> Iterator[Measure]:
    eta = np.repeat(np.array([1 / 1.5, 1 / 1.33, 1 / 2.4, 0.9, 0.15, 0.9999], np.float32), 4001)
    offset = np.tile(np.linspace(-1e-5, 1e-5, 4001), 6)
    offset += np.tile(np.concatenate([np.linspace(-3e-7, 3e-7, 2001), np.zeros(2000)]), 6)
    c = (np.sqrt(1.0 - eta.astype(np.float64) ** 2) + offset).astype(np.float32)
    out = bench.get(Parts).run("fresnel", [c, eta], (len(c), 2))
    reflected, cosine = (x.astype(np.float64) for x in exact_fresnel(c, eta))
    yield at_most("values not finite", np.count_nonzero(~np.isfinite(out)), 0)
    yield at_most("largest reflectance", out[:, 0].max(), 1)
    yield at_most("error of the reflectance", np.abs(out[:, 0] - reflected).max(), 2e-6)
    yield at_most("error of the refracted cosine", np.abs(out[:, 1] - cosine).max(), 2e-6)
    yield enough("angles on the side of total reflection", np.count_nonzero(reflected == 1), 1000)
    yield enough("angles on the other side", np.count_nonzero(reflected < 1), 1000)


@hard_case(
    25,
    "glass-slab",
    "A slab of glass passes (1 - R) / (1 + R) of the light, a sheet too; glass of index 1 is not seen.",
    oracle="R = .04: T = .92308; at index 1 every ray goes straight on with weight 1",
    algorithm="Radiance scales by eta^2 at each interface; index 1 is a case of its own, without refraction",
)
def glass_slab(bench: Workbench) -> Iterator[Measure]:
    materials = bench.get(MaterialBench)
    n = bench.count(100_000, 1_000_000)
    expected = 0.96 / 1.04
    share, energy = _through_a_slab(materials, n)
    yield at_most(
        "|z| of the share that passes", abs(share - expected) / np.sqrt(expected * (1 - expected) / n), Z
    )
    yield at_most("energy lost or gained in and out", energy, 1e-6)
    sheet = materials.sample(
        {"type": "thin_dielectric", "ior": 1.5}, (0.0, 0.0, 1.0), materials.uniforms(1000, 1)
    )
    chances = np.where(sheet.transmitted, expected, 1 - expected)
    yield at_most("error of the sheet's chances", np.abs(sheet.pdf - chances).max(), 1e-6)
    bent = 0
    wo = materials.directions(20_000, 4)
    for kind, roughness in (("dielectric", 0.0), ("dielectric", 0.5), ("thin_dielectric", 0.0)):
        for frame in (materials.FLAT, TILTED):
            clear = {"type": kind, "ior": 1.0, "roughness": roughness}
            s = materials.sample(clear, wo, materials.uniforms(len(wo), 5), frame)
            bent += int(
                np.count_nonzero((s.wi != -wo).any(axis=1) | (s.weight != 1).any(axis=1) | (s.pdf != 1))
            )
    yield at_most("rays changed by glass of index 1", bent, 0)


def _through_a_slab(materials: MaterialBench, n: int) -> tuple[float, float]:
    """(share of n rays that leave at the far side, largest error of the weight in and out), rays followed between the faces."""
    rng = np.random.default_rng(8)
    glass = {"type": "dielectric"}
    s = materials.sample(glass, (0.0, 0.0, 1.0), rng.random((n, 3)))
    inside = int(np.count_nonzero(s.transmitted))
    weight = float(s.weight[s.transmitted][0, 0])
    through, error, bounce = 0, 0.0, 0
    while inside and bounce < 40:
        s = materials.sample(glass, (0.0, 0.0, -1.0), rng.random((inside, 3)))
        out = int(np.count_nonzero(s.transmitted))
        if out:
            error = max(error, abs(float(s.weight[s.transmitted][0, 0]) * weight - 1.0))
        through += out if bounce % 2 == 0 else 0
        inside -= out
        bounce += 1
    return through / n, error


CASES: Final[tuple[HardCase, ...]] = (
    frame_at_the_pole,
    narrow_ggx,
    visible_normals,
    ggx_furnace,
    reciprocity,
    critical_angle,
    glass_slab,
)
