"""Which file formats are accepted, told by a file's first bytes, never by its name."""

from __future__ import annotations

from typing import Final

HEAD_BYTES: Final = 4096
_IMAGES: Final = (
    (b"\x89PNG\r\n\x1a\n", "png", "image/png"),
    (b"\xff\xd8\xff", "jpg", "image/jpeg"),
    (b"\x76\x2f\x31\x01", "exr", "image/x-exr"),
    (b"#?RADIANCE", "hdr", "image/vnd.radiance"),
    (b"#?RGBE", "hdr", "image/vnd.radiance"),
    (b"II*\x00", "tif", "image/tiff"),
    (b"MM\x00*", "tif", "image/tiff"),
)
_MESHES: Final = (
    (b"ply\n", "ply", "model/ply"),
    (b"ply\r", "ply", "model/ply"),
    (b"glTF", "glb", "model/gltf-binary"),
)
_OBJ_KEYWORDS: Final = frozenset(
    b"# v vt vn f o g s l p mtllib usemtl cstype vp parm curv surf deg lod shadow_obj trace_obj".split()
)
IMAGE_FORMATS: Final = "PNG, JPEG, OpenEXR, Radiance HDR, TIFF"
MESH_FORMATS: Final = "OBJ, PLY, GLB"


def image_format(head: bytes) -> str | None:
    """The extension of the image format that a file beginning with these bytes has."""
    return next((name for magic, name, _ in _IMAGES if head.startswith(magic)), None)


def mesh_format(head: bytes) -> str | None:
    """The same for meshes. OBJ has no magic number: its first line with text begins with one of its
    keywords."""
    for magic, name, _ in _MESHES:
        if head.startswith(magic):
            return name
    return "obj" if _looks_like_obj(head) else None


def media_type(head: bytes) -> str:
    """What to call a file that begins with these bytes in HTTP."""
    for magic, _, media in (*_IMAGES, *_MESHES):
        if head.startswith(magic):
            return media
    return "model/obj" if _looks_like_obj(head) else "application/octet-stream"


def _looks_like_obj(head: bytes) -> bool:
    if b"\x00" in head:
        return False
    for line in head.removeprefix(b"\xef\xbb\xbf").splitlines():
        words = line.split(maxsplit=1)
        if words:
            return words[0] in _OBJ_KEYWORDS or words[0].startswith(b"#")
    return False
