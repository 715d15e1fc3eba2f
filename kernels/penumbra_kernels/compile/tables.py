"""Densities that are linear between knots, laid out for `sample_table` in cl/sampling/warp.cl."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROW: Final = 16
"""Bounds that lanes compare at once."""
MAX_CELLS: Final = ROW * ROW


def density_table(knots: Array, values: Array, areas: Array | None = None) -> NDArray[np.float32]:
    """The table of |f| over [knots[0], knots[-1]], f linear between knots and of one sign in each cell.

    knots: (n + 1,), rising. values: (n + 1,) of f. areas: (n,) exact integrals of |f| over the cells, where
    the straight lines' own are not good enough: the lines are scaled to them and the CDF is exact at knots.
    Layout: number of cells, weight (integral of |f| / integral of f), then for each cell: left end, width,
    probability to its left, probability per unit of the cell's coordinate at its left and right end, sign. Behind
    several cells, of which there may be MAX_CELLS, come their bounds (`_bounds`).
    """
    widths = np.diff(knots)
    left, right = np.abs(values[:-1]), np.abs(values[1:])
    straight = 0.5 * (left + right) * widths
    areas = straight if areas is None else areas
    signs = np.where(values[:-1] + values[1:] < 0.0, -1.0, 1.0)
    total = float(areas.sum())
    scale = np.divide(areas, straight, out=np.zeros_like(areas), where=straight > 0.0) * widths / total
    cdf = np.concatenate([[0.0], np.cumsum(areas)[:-1]]) / total
    cells = np.stack([knots[:-1], widths, cdf, left * scale, right * scale, signs], axis=1)
    cells = cells[areas > 0.0]
    header = [len(cells), total / float((signs * areas).sum())]
    return np.concatenate([header, cells.reshape(-1), _bounds(cells[:, 2])]).astype(np.float32)


def _bounds(cdf: Array) -> Array:
    """Probabilities to the left of cells, to find one in two steps: a row of every sixteenth cell's, then all cells', a row for
    each of those. The first cell's is left out; rows end in infinities."""
    count = len(cdf)
    assert count <= MAX_CELLS, f"a table of {count} cells, at most {MAX_CELLS} can be searched"
    if count == 1:
        return np.empty(0)
    rows = np.full(ROW + ROW * -(-count // ROW), np.inf)
    rows[: len(cdf[ROW::ROW])] = cdf[ROW::ROW]
    rows[ROW : ROW + count - 1] = cdf[1:]
    return rows
