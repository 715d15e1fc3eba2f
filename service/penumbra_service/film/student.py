"""Student's t distribution for whole degrees of freedom, where it has a closed form."""

from __future__ import annotations

import math


def within(degrees: int, angle: float) -> float:
    """P(|t| <= sqrt(degrees) tan(angle)), angle in [0, pi / 2] (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    odd = degrees % 2
    term = cosine if odd else 1.0
    total = 0.0
    for k in range(1 + odd, degrees, 2):
        total += term
        term *= cosine * cosine * k / (k + 1)
    return (angle + sine * total) * 2.0 / math.pi if odd else sine * total


def quantile(degrees: int, tail: float) -> float:
    """t that is exceeded with probability `tail` < 1/2; its relative error is some 1e-16 / tail."""
    low, high = 0.0, 0.5 * math.pi
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if within(degrees, middle) < 1.0 - 2.0 * tail else (low, middle)
    return math.sqrt(degrees) * math.tan(low)
