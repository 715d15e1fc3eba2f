"""Means, variances and flags against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import no_sums
from penumbra_service.film import flags
from penumbra_service.film.counts import count_pixels
from penumbra_service.film.error import EPSILON, image_error, normal_quantile, summarize
from penumbra_service.film.statistics import (
    interval,
    outlier_share,
    pixel_flags,
    pixel_statistics,
    t_quantile,
)

R = 8
SIX_SIGMA = 4.9
"""Two-sided normal quantile of a false-alarm rate of 1e-6."""


def _sums(values, taken=1, lit=None):  # type: ignore[no-untyped-def]
    """(R, h, w) gray sums."""
    values = np.asarray(values, np.float64)
    sums = no_sums(values.shape)
    sums["rgba"][..., :3] = values[..., None]
    sums["rgba"][..., 3] = taken
    sums["taken"] = taken
    sums["lit"] = (values > 0) * np.asarray(taken) if lit is None else lit
    return sums


def _tile(sums):  # type: ignore[no-untyped-def]
    return Tile(0, 0, sums.shape[2], sums.shape[1])


def _stats(sums, **more):  # type: ignore[no-untyped-def]
    return pixel_statistics(_tile(sums), sums, **more)


def test_variance_of_a_mean_by_hand():
    pixels = _stats(_sums(np.array([2.0, 4.0]).reshape(2, 1, 1)))
    assert pixels.mean[0, 0].tolist() == [3.0, 3.0, 3.0, 1.0]
    assert pixels.variance[0, 0].tolist() == [1.0, 1.0, 1.0, 0.0]  # ((2-3)^2 + (4-3)^2) / (2 * 1)


@pytest.mark.parametrize("replicates", [2, 4, 8, 16])
def test_variance_is_unbiased_for_a_uniform_distribution(replicates):  # type: ignore[no-untyped-def]
    """n uniform numbers a replicate: the mean's variance is 1 / (12 n R)."""
    rng = np.random.default_rng(replicates)
    n, pixels_count = 4, 64 * 64
    values = rng.random((n, replicates, 64, 64)).sum(axis=0)
    pixels = _stats(_sums(values, taken=n))
    v = pixels.variance[..., 0]
    true = 1 / (12 * n * replicates)
    assert abs(v.mean() - true) < SIX_SIGMA * v.std() / math.sqrt(pixels_count)


def test_variance_is_unbiased_where_replicates_have_different_counts():
    rng = np.random.default_rng(3)
    counts = rng.integers(0, 4, (R, 64, 64))
    numbers = rng.random((4, R, 64, 64))
    used = np.arange(4)[:, None, None, None] < counts
    pixels = _stats(_sums((numbers * used).sum(axis=0), taken=counts))
    there = counts > 0
    reff = there.sum(axis=0)
    true = (np.where(there, 1 / (12.0 * np.maximum(counts, 1)), 0)).sum(axis=0) / np.maximum(reff, 1) ** 2
    known = reff >= 2
    error = (pixels.variance[..., 0] - true)[known]
    assert abs(error.mean()) < SIX_SIGMA * error.std() / math.sqrt(error.size)
    assert np.array_equal(pixels.replicates, reff)


def test_it_is_the_delete_one_jackknife():
    rng = np.random.default_rng(4)
    values = rng.random((R, 1, 1))
    m = values[:, 0, 0]
    left_out = np.array([np.delete(m, r).mean() for r in range(R)])
    jackknife = (R - 1) / R * ((left_out - left_out.mean()) ** 2).sum()
    assert _stats(_sums(values)).variance[0, 0, 0] == pytest.approx(jackknife, rel=1e-6)


@pytest.mark.parametrize("taken", [1, 4, 5, 7])
def test_equal_counts_make_no_difference(taken):  # type: ignore[no-untyped-def]
    """One pixel that has more samples than the others has the replicates' means formed one by one, theirs too."""
    rng = np.random.default_rng(taken)
    values = taken * rng.random((R, 8, 8))
    sums, other = _sums(values, taken=taken), _sums(values, taken=taken)
    other["taken"][:, 7, 7] += 1
    one, apart = _stats(sums), _stats(other)
    assert (one.scale, apart.scale) == (taken, 1)
    rows = np.s_[:7]
    assert one.mean[rows] == pytest.approx(apart.mean[rows], rel=1e-14)
    assert one.variance[rows] == pytest.approx(apart.variance[rows], rel=1e-12)
    assert one.largest_share[rows] == pytest.approx(apart.largest_share[rows], rel=1e-12)
    assert np.array_equal(one.calm[rows], apart.calm[rows])


def test_replicates_that_agree_have_no_variance_at_all():
    """Not even that of rounding: 0.1 and its sums are no binary fractions."""
    for taken in (3, 4):
        pixels = _stats(_sums(np.full((4, 8, 8), taken * 0.1), taken=taken))
        assert not pixels.variance.any()
        assert pixels.calm.all()


def test_empty_replicates_are_left_out_and_empty_pixels_flagged():
    taken = np.zeros((4, 1, 3))
    taken[:, 0, 0] = [1, 1, 0, 0]
    taken[0, 0, 1] = 1
    values = np.array([1.0, 3.0, 0.0, 0.0]).reshape(4, 1, 1) * (taken > 0)
    pixels = _stats(_sums(values, taken=taken))
    bits = pixel_flags(pixels)[0]
    assert pixels.mean[0, :, 0].tolist() == [2.0, 1.0, 0.0]
    assert pixels.variance[0, 0, 0] == 1.0
    assert np.isnan(pixels.variance[0, 1:, 0]).all()
    assert not bits[0] & (flags.EMPTY | flags.NO_VARIANCE)
    assert bits[1] & flags.NO_VARIANCE
    assert not bits[1] & flags.EMPTY
    assert bits[2] & flags.EMPTY


def test_a_deterministic_sampler_has_no_variance():
    pixels = _stats(_sums(np.ones((1, 8, 8))), deterministic=True)
    assert np.isnan(pixels.variance).all()
    assert (pixel_flags(pixels, deterministic=True) == flags.DETERMINISTIC).all()
    assert not image_error([summarize(pixels)]).known


def test_rejected_samples_are_counted_and_name_their_effects():
    sums = _sums(np.ones((2, 1, 1)))
    sums["rejected"] = [[[2]], [[1]]]
    sums["rejected_in"] = [[[flags.EFFECTS["gloss"]]], [[flags.EFFECTS["lens"]]]]
    pixels = _stats(sums)
    bits = int(pixel_flags(pixels)[0, 0])
    assert pixels.rejected[0, 0] == 3
    assert bits & flags.REJECTED
    assert bits >> flags.EFFECT_SHIFT == flags.EFFECTS["gloss"] | flags.EFFECTS["lens"]
    counts = count_pixels(pixels, pixel_flags(pixels))
    assert {name for name, count in counts.rejected_in.items() if count} == {"gloss", "lens"}
    assert (counts.rejected, counts.flagged, counts.flags["rejected"]) == (3, 1, 1)


def test_grubbs_threshold_against_the_tables():
    """Grubbs and Beck (1972): two-sided critical G at 5 % is 2.126 for 8 and 1.481 for 4 values."""
    for replicates, g in ((8, 2.126), (4, 1.481)):
        share = outlier_share(replicates, 0.05)
        assert math.sqrt(share * (replicates - 1)) == pytest.approx(g, abs=1e-3)
        assert outlier_share(replicates) < (replicates - 1) / replicates


def test_one_spike_flags_its_block_and_no_other():
    rng = np.random.default_rng(5)
    values = 1 + 0.01 * rng.standard_normal((R, 16, 24))
    values[3, 9, 10] = 50.0
    bits = pixel_flags(_stats(_sums(values)))
    assert bits[9, 10] & flags.HEAVY_TAILED
    assert np.count_nonzero(bits & flags.HEAVY_TAILED) == 1
    block = np.zeros((16, 24), bool)
    block[8:16, 8:16] = True
    assert np.array_equal((bits & flags.BLOCK) != 0, block)


def test_blocks_are_aligned_to_the_full_frame():
    values = np.ones((R, 8, 8)) + 0.01 * np.random.default_rng(6).standard_normal((R, 8, 8))
    values[0, 0, 0] = 50.0
    sums = _sums(values)
    bits = pixel_flags(pixel_statistics(Tile(5, 6, 8, 8), sums))
    block = np.zeros((8, 8), bool)
    block[:2, :3] = True  # pixels 5-7 x 6-7 of the full frame
    assert np.array_equal((bits & flags.BLOCK) != 0, block)


def test_rounding_is_no_outlier():
    values = np.full((R, 8, 8), 3.0)
    values[0, 2, 2] += 3e-7
    assert not pixel_flags(_stats(_sums(values))).any()


def test_normal_pixels_are_flagged_at_the_stated_rate():
    rng = np.random.default_rng(8)
    n = 256
    bits = pixel_flags(_stats(_sums(10 + rng.standard_normal((R, n, n)), taken=1)))
    found = np.count_nonzero(bits & flags.HEAVY_TAILED)
    expected = 1e-4 * n * n
    assert abs(found - expected) < SIX_SIGMA * math.sqrt(expected) + 1


def test_few_lit_samples_are_flagged_but_black_and_lit_pixels_are_not():
    values = np.zeros((R, 8, 32))
    lit = np.zeros((R, 8, 32))
    values[:, 0, 0] = np.arange(R)
    lit[0, 0, 0] = 3
    values[:, :, 16:] = 8
    lit[:, :, 16:] = 8
    bits = pixel_flags(_stats(_sums(values, taken=8, lit=lit)))
    assert bits[0, 0] & flags.FEW_LIT
    assert (bits[:, :8] & flags.BLOCK).all()
    assert not bits[:, 8:].any()


@pytest.mark.parametrize("replicates", [4, 8, 16])
def test_t_interval_covers(replicates):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(replicates)
    n = 128
    pixels = _stats(_sums(rng.standard_normal((replicates, n, n)) + 5))
    low, high = interval(pixels)
    covered = ((low <= 5) & (high >= 5))[..., 0].mean()
    assert abs(covered - 0.95) < SIX_SIGMA * math.sqrt(0.95 * 0.05 / n**2)


def test_quantiles_against_the_tables():
    assert t_quantile(0.95, 7) == pytest.approx(2.3646, abs=1e-4)
    assert normal_quantile(0.95) == pytest.approx(1.95996, abs=1e-5)


def test_relmse_of_a_known_picture():
    """Signal s and noise sigma known: relmse = sigma^2 / R / (s^2 + eps), mse = sigma^2 / R."""
    rng = np.random.default_rng(9)
    n, s, sigma = 128, 2.0, 0.5
    pixels = _stats(_sums(s + sigma * rng.standard_normal((R, n, n))))
    error = image_error([summarize(pixels)])
    mse = sigma**2 / R
    assert error.mse == pytest.approx(mse, rel=SIX_SIGMA * math.sqrt(2 / (R - 1)) / n)
    assert error.relmse == pytest.approx(mse / (s * s + EPSILON), rel=0.03)
    assert error.relative_error == math.sqrt(error.relmse)
    assert error.psnr == pytest.approx(10 * math.log10(pixels.mean[..., :3].max() ** 2 / error.mse))
    low, high = error.relative_interval(0.95)
    assert low < error.relative_error < high


def test_relmse_does_not_collapse_where_one_replicate_has_all_the_light():
    """A firefly's m^2 - V is 0 on average: pooling keeps the quotient from being V / V per pixel."""
    rng = np.random.default_rng(10)
    n, p, bright = 256, 0.01, 100.0
    values = bright * (rng.random((R, n, n)) < p)
    pixels = _stats(_sums(values))
    error = image_error([summarize(pixels)])
    true = bright**2 * p * (1 - p) / R / ((bright * p) ** 2 + EPSILON)
    assert error.relmse == pytest.approx(true, rel=0.25)
    naive = float(np.mean(pixels.variance[..., 0] / (pixels.mean[..., 0] ** 2 + EPSILON)))
    assert naive < 0.2 * true


def test_the_pixels_that_carry_an_error_are_counted():
    """Equal spikes of one replicate in five blocks: five pixels carry it. Of normal noise, E V^2 = (1 + 2 / (R - 1)) E^2 V in
    each of N pixels: N / (1 + 2 / (R - 1)) do."""
    values = np.full((R, 64, 64), 1.0)
    for y, x in ((0, 0), (20, 3), (37, 37), (63, 63), (5, 60)):
        values[1, y, x] = 1000.0
    pixels = _stats(_sums(values))
    few = image_error([summarize(pixels)])
    assert few.carriers == pytest.approx(5, rel=1e-6)
    assert few.of_few
    rng = np.random.default_rng(11)
    pixels = _stats(_sums(5 + rng.standard_normal((R, 64, 64))))
    many = image_error([summarize(pixels)])
    assert many.carriers == pytest.approx(64**2 / (1 + 2 / (R - 1)), rel=0.1)
    assert not many.of_few


@pytest.mark.parametrize("brightness", [0.01, 0.1, 1.0])
def test_the_floors_share_is_that_of_what_is_added(brightness):  # type: ignore[no-untyped-def]
    """Signal s: the share is eps / (s^2 + eps), and 1 / (1 - share) times relmse is V / s^2."""
    rng = np.random.default_rng(12)
    sigma = 0.1 * brightness
    pixels = _stats(_sums(brightness + sigma * rng.standard_normal((R, 64, 64))))
    error = image_error([summarize(pixels)])
    assert error.floor == pytest.approx(EPSILON / (brightness**2 + EPSILON), rel=0.01)
    assert error.relmse / (1 - error.floor) == pytest.approx(sigma**2 / R / brightness**2, rel=0.05)


def test_a_black_picture_has_no_error():
    pixels = _stats(_sums(np.zeros((R, 32, 32))))
    error = image_error([summarize(pixels)])
    assert (error.relmse, error.deviation, error.mse) == (0.0, 0.0, 0.0)


def test_sums_beyond_float32_leave_a_finite_mean_without_a_variance():
    values = np.ones((R, 1, 2))
    values[3, 0, 1] = np.inf
    pixels = _stats(_sums(values))
    assert pixels.mean[0, 1, :3].tolist() == [float(np.finfo(np.float32).max)] * 3
    assert np.isnan(pixels.variance[0, 1]).all()
    assert pixel_flags(pixels)[0, 1] & flags.NO_VARIANCE
    assert pixels.variance[0, 0].tolist() == [0.0] * 4  # its neighbour is not touched
    assert image_error([summarize(pixels)]).relmse == 0.0


def test_variance_of_the_brightest_radiance_is_finite():
    values = np.linspace(1.0, 3e38, R).reshape(R, 1, 1)
    pixels = _stats(_sums(values))
    assert pixels.variance[0, 0, 0] == pytest.approx(values.var(ddof=1) / R, rel=1e-6)  # float32 sums
    error = image_error([summarize(pixels)])
    assert error.relmse == pytest.approx(float(values.var(ddof=1) / R / values.mean() ** 2), rel=1e-6)
