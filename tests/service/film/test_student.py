"""Student's t against SciPy, which the service itself does not wait for."""

from __future__ import annotations

import pytest
from penumbra_service.film.student import quantile
from scipy.special import stdtrit


@pytest.mark.parametrize("degrees", [1, 2, 3, 6, 7, 15, 16, 100, 1001])
@pytest.mark.parametrize("tail", [0.4, 0.025, 0.005, 1e-4 / 16])
def test_quantiles_are_scipys(degrees: int, tail: float) -> None:
    assert quantile(degrees, tail) == pytest.approx(-stdtrit(degrees, tail), rel=1e-14 / tail + 1e-12)
