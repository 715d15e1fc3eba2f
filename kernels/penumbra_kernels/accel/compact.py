"""The tree for devices that give every ray a thread of its own: small nodes, triangles one by one.

A node's boxes are bytes on a grid of its own (Ylitie, Karras, Laine 2017, section 3.2): 96 bytes instead of 256. Every box on
the grid holds the box that it stands for, in the very float32 arithmetic of cl/geometry/compact.cl, so that nothing is missed
that the wide tree finds; and since ties go by ids, both find the same hits, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import COMPACT_NODE, COMPACT_TRIANGLE, CONSTANTS

AXES: Final = "xyz"
STEPS: Final = 255
LEAST_EXPONENT: Final = 1
"""2^-126, the least normal number."""
GREATEST_EXPONENT: Final = 254
_ROUNDS: Final = 4


def tree_arrays(arrays: Mapping[str, NDArray[Any]], flags: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """A scene's arrays with `nodes` and `packets` in the layout that the device's flags ask for; lanes alone need `corners`."""
    if not flags.get("PENUMBRA_COMPACT_TREE", 0):
        return dict(arrays)
    compact = {
        "nodes": compact_nodes(arrays["nodes"]),
        "packets": compact_triangles(arrays["packets"]),
        "corners": arrays["corners"][:0],
    }
    return {**arrays, **compact}


def compact_nodes(nodes: NDArray[Any]) -> NDArray[Any]:
    """(m,) of NODE8 -> (m,) of COMPACT_NODE. Empty children get boxes turned inside out."""
    out = np.zeros(len(nodes), COMPACT_NODE)
    out["child"] = nodes["child"]
    there = nodes["child"] != CONSTANTS["LEAF_FLAG"]
    for axis, name in enumerate(AXES):
        lo, hi = nodes[f"lo_{name}"], nodes[f"hi_{name}"]
        origin = np.where(there, lo, np.inf).min(axis=1).astype(np.float32)
        far = np.where(there, hi, -np.inf).max(axis=1)
        exponent, first, last = _grid(lo, hi, origin, far, there)
        out["origin"][:, axis] = origin
        out["exponents"] |= exponent.astype(np.uint32) << np.uint32(8 * axis)
        out[f"lo_{name}"] = np.where(there, first, STEPS)
        out[f"hi_{name}"] = np.where(there, last, 0)
    return out


def compact_triangles(packets: NDArray[Any]) -> NDArray[Any]:
    """(p,) of PACKET8 -> (8 p,) of COMPACT_TRIANGLE: lane j of packet i at 8 i + j."""
    out = np.zeros((len(packets), 8), COMPACT_TRIANGLE)
    for vertex in ("v0", "v1", "v2"):
        out[vertex] = packets[vertex].transpose(0, 2, 1)
    primitive = packets["primitive"]
    out["primitive"] = primitive
    out["last"][:, :-1] = primitive[:, 1:] == primitive[:, :-1]
    out["last"][:, -1] = 1
    return out.reshape(-1)


def plane(origin: NDArray[Any], exponent: NDArray[Any], step: NDArray[Any]) -> NDArray[np.float32]:
    """Where the device puts a plane: fma(step, 2^(exponent - 127), origin), rounded once. Shapes broadcast."""
    with np.errstate(over="ignore"):
        exact = step * np.ldexp(1.0, exponent.astype(np.int64) - 127) + origin.astype(np.float64)
        return exact.astype(np.float32)


def _grid(
    lo: NDArray[Any], hi: NDArray[Any], origin: NDArray[Any], far: NDArray[Any], there: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """(m,) exponents, (m, 8) first and last steps: the least grid whose boxes hold the children's."""
    extent = np.maximum(far.astype(np.float64) - origin, 0.0)
    _, power = np.frexp(extent / STEPS)
    exponent = np.clip(power.astype(np.int64) + 127, LEAST_EXPONENT, GREATEST_EXPONENT)
    for _ in range(_ROUNDS):
        first, last, holds = _steps(lo, hi, origin, exponent, there)
        if holds.all():
            return exponent, first, last
        exponent = np.where(holds, exponent, np.minimum(exponent + 1, GREATEST_EXPONENT))
    raise ValueError("boxes reach too far for float32 steps")


def _steps(
    lo: NDArray[Any], hi: NDArray[Any], origin: NDArray[Any], exponent: NDArray[Any], there: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
    size = np.ldexp(1.0, exponent - 127)[:, None]
    base, column = origin[:, None], exponent[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        low = np.where(there, (lo.astype(np.float64) - base) / size, 0.0)
        high = np.where(there, (hi.astype(np.float64) - base) / size, 0.0)
    first = np.clip(np.floor(low), 0, STEPS)
    last = np.clip(np.ceil(high), 0, STEPS + 1)
    # The device rounds once more: step back, or on, where that crosses the plane. A float64 sum that is not exact could round
    # otherwise than the device does, so such planes are demanded with one float to spare.
    first -= there & (first > 0) & ~(_outward(base, column, first, np.inf) <= lo)
    last += there & (last < STEPS) & ~(_outward(base, column, last, -np.inf) >= hi)
    fits = (_outward(base, column, first, np.inf) <= lo) | (first == 0)
    fits &= (last <= STEPS) & (_outward(base, column, np.minimum(last, STEPS), -np.inf) >= hi)
    return first, last, (fits | ~there).all(axis=1)


def _outward(
    origin: NDArray[Any], exponent: NDArray[Any], step: NDArray[Any], towards: float
) -> NDArray[np.float32]:
    """The plane, moved one float towards the box where the float64 sum was rounded."""
    at = plane(origin, exponent, step)
    with np.errstate(over="ignore", invalid="ignore"):
        moved = step * np.ldexp(1.0, exponent - 127)
        total = origin.astype(np.float64) + moved
        exact = (total - moved == origin) & (total - origin == moved)
    return np.where(exact, at, np.nextafter(at, np.float32(towards)))
