"""Makes binary PLY files whose faces differ in size readable for trimesh, which needs records of one length.

Such files (triangles mixed with quads and larger polygons) are what modelling programs often write. The
face element is rewritten as triangles (fans); all before it stays as it is, all after it is dropped,
since nobody here reads it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from penumbra_kernels.assets import AssetError

_CODES: Final = {
    **{"char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h"},
    **{"ushort": "H", "uint16": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I"},
    **{"float": "f", "float32": "f", "double": "d", "float64": "d"},
}
_INDEX_NAMES: Final = ("vertex_indices", "vertex_index")


@dataclass
class _Property:
    name: str
    code: str
    count_code: str | None = None  # of a list


@dataclass
class _Element:
    name: str
    count: int
    line: int  # in the header
    properties: list[_Property] = field(default_factory=list)


def with_equal_faces(data: bytes) -> bytes:
    """The same file if its faces have one size (or it is text), else one with triangles only. Raises
    AssetError."""
    end = data.find(b"end_header")
    line_end = data.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise AssetError("a PLY file needs a header that ends with end_header")
    lines = data[:line_end].decode("ascii", "replace").split("\n")
    order = next((">" if "big" in line else "<" for line in lines if line.startswith("format binary")), None)
    if order is None:
        return data
    elements = _elements(lines)
    at = next((i for i, element in enumerate(elements) if element.name == "face"), None)
    if at is None:
        return data
    before = elements[:at]
    if any(p.count_code for element in before for p in element.properties):
        return data
    start = line_end + 1
    start += sum(e.count * sum(struct.calcsize("=" + p.code) for p in e.properties) for e in before)
    face = elements[at]
    polygons, sizes = _polygons(data, start, face, order)
    if len(sizes) <= 1:
        return data
    return _rewritten(data[line_end + 1 : start], lines, elements, at, polygons, order)


def _elements(lines: list[str]) -> list[_Element]:
    elements: list[_Element] = []
    for number, line in enumerate(lines):
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append(_Element(words[1], int(words[2]), number))
        elif words[:1] == ["property"] and elements:
            elements[-1].properties.append(_property(words))
    return elements


def _property(words: list[str]) -> _Property:
    try:
        if words[1] == "list":
            return _Property(words[4], _CODES[words[3]], _CODES[words[2]])
        return _Property(words[2], _CODES[words[1]])
    except (IndexError, KeyError):
        raise AssetError(f"the PLY header holds what cannot be read: {' '.join(words)[:80]!r}") from None


def _polygons(data: bytes, at: int, face: _Element, order: str) -> tuple[list[tuple[int, ...]], set[int]]:
    """The vertex indices of every face, and the lengths in bytes that faces have."""
    polygons: list[tuple[int, ...]] = []
    sizes = set()
    try:
        for _ in range(face.count):
            polygon: tuple[int, ...] = ()
            first = at
            for prop in face.properties:
                values, at = _values(data, at, prop, order)
                if prop.name in _INDEX_NAMES:
                    polygon = values
            polygons.append(polygon)
            sizes.add(at - first)
    except struct.error:
        raise AssetError(f"the file ends after {len(polygons)} of {face.count} faces") from None
    return polygons, sizes


def _values(data: bytes, at: int, prop: _Property, order: str) -> tuple[tuple[int, ...], int]:
    count = 1
    if prop.count_code:
        (count,) = struct.unpack_from(order + prop.count_code, data, at)
        at += struct.calcsize(order + prop.count_code)
        if not isinstance(count, int) or count < 0:
            raise AssetError(f"a face has {count} vertices")
    layout = f"{order}{count}{prop.code}"
    size = struct.calcsize(layout)
    if at + size > len(data):
        raise struct.error
    return struct.unpack_from(layout, data, at), at + size


def _rewritten(
    body: bytes,
    lines: list[str],
    elements: list[_Element],
    at: int,
    polygons: list[tuple[int, ...]],
    order: str,
) -> bytes:
    triangles = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    if any(len(p) < 3 for p in polygons):
        raise AssetError("a face must have at least 3 vertices")
    record = np.dtype([("n", "u1"), ("v", order + "i8", (3,))])
    faces = np.empty(len(triangles), record)
    faces["n"] = 3
    faces["v"] = np.array(triangles, np.int64)
    if len(triangles) and (faces["v"].min() < -(2**31) or faces["v"].max() >= 2**31):
        raise AssetError("a face refers to a vertex beyond 2^31")
    narrow = faces.astype(np.dtype([("n", "u1"), ("v", order + "i4", (3,))]))
    header = [
        *lines[: elements[at].line],
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode() + body + narrow.tobytes()
