"""Assets: good files of every format, and broken or hostile ones, which give AssetError and nothing worse."""

from __future__ import annotations

import hashlib
import struct
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import AssetError, MeshData
from penumbra_scene.assets import AssetRef
from penumbra_service.images.assets import CACHE_VERSION, FolderAssets
from penumbra_service.images.decode import attempt
from penumbra_service.images.limits import DecodeLimits

VERTICES = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]]
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES)
ATTRIBUTES = "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nvn 0 2 0\n"


def refused(task: dict[str, Any]) -> None:
    refusal = attempt(task)
    if refusal is not None:
        raise AssetError(refusal)


@pytest.fixture
def assets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FolderAssets:
    """Decodes in this process, which is faster; the process and its limits have tests of their own."""
    assets = FolderAssets(tmp_path / "assets", tmp_path)
    monkeypatch.setattr(assets, "_run", refused)
    return assets


@pytest.fixture
def mesh_of(assets: FolderAssets, tmp_path: Path) -> Any:
    def read(data: bytes | str) -> MeshData:
        (tmp_path / "file").write_bytes(data if isinstance(data, bytes) else data.encode())
        return assets.mesh(AssetRef(file="file"))

    return read


@pytest.fixture
def image_of(assets: FolderAssets, tmp_path: Path) -> Any:
    def read(data: bytes) -> Any:
        (tmp_path / "file").write_bytes(data)
        return assets.image(AssetRef(file="file"))

    return read


def corners(mesh: MeshData) -> NDArray[np.float64]:
    """(triangles, 3, 3): positions of all corners."""
    return np.asarray(mesh.positions)[np.asarray(mesh.indices)]


def ply(faces: list[list[int]], form: str, extra: bool = False) -> bytes:
    """A PLY file with normals and texture coordinates. `form`: one of FORMS."""
    lines = ["ply", f"format {form} 1.0", f"element vertex {len(VERTICES)}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "s", "t")]
    lines += [f"element face {len(faces)}"]
    lines += ["property uchar material"] if extra else []
    lines += ["property list uchar int vertex_indices", "end_header", ""]
    header = "\n".join(lines).encode()
    rows = [[*v, 0, 0, 3, v[0], v[1]] for v in VERTICES]
    if form == "ascii":
        text = "".join(" ".join(map(str, row)) + "\n" for row in rows)
        text += "".join(" ".join(map(str, [*([7] if extra else []), len(f), *f])) + "\n" for f in faces)
        return header + text.encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(order + "8f", *row) for row in rows)
    for f in faces:
        body += (b"\7" if extra else b"") + struct.pack(f"{order}B{len(f)}i", len(f), *f)
    return header + body


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


def test_obj_polygons_become_triangles(mesh_of: Any) -> None:
    mesh = mesh_of(OBJ + "f 1 2 3 4\nf 1 2 3\nf 1 2 3 5 4\n")
    found = {tuple(map(tuple, c.tolist())) for c in corners(mesh)}
    p = [tuple(map(float, v)) for v in VERTICES]
    assert len(mesh.indices) == 6
    assert (p[0], p[1], p[2]) in found
    areas = np.linalg.norm(np.cross(*(corners(mesh)[:, i] - corners(mesh)[:, 0] for i in (1, 2))), axis=1) / 2
    assert areas.sum() == pytest.approx(1 + 0.5 + 1.5)
    assert mesh.normals is None
    assert mesh.uvs is None


def test_obj_vertices_are_split_where_normals_or_uvs_differ(mesh_of: Any) -> None:
    mesh = mesh_of(OBJ + ATTRIBUTES + "f 1/1/1 2/2/1 3/3/1\nf 1/3/2 2/2/2 3/3/2\n")
    assert mesh.normals is not None
    assert mesh.uvs is not None
    order = np.argsort(mesh.normals[mesh.indices][:, 0, 1])
    np.testing.assert_allclose(mesh.normals[mesh.indices][order], [[[0, 0, 1]] * 3, [[0, 1, 0]] * 3])
    np.testing.assert_allclose(
        mesh.uvs[mesh.indices][order], [[[0, 0], [1, 0], [1, 1]], [[1, 1], [1, 0], [1, 1]]]
    )
    assert mesh.normals.dtype == np.float32


def test_obj_indices_may_count_backwards_from_where_they_stand(mesh_of: Any) -> None:
    mesh = mesh_of("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n")
    z = corners(mesh)[..., 2]
    assert sorted(map(tuple, z.tolist())) == [(0, 0, 0), (5, 5, 5)]


def test_obj_objects_and_materials_make_one_mesh(mesh_of: Any) -> None:
    text = "mtllib ../../etc/passwd\no a\n" + OBJ + "usemtl x\nf 1 2 3\no b\nusemtl y\nf 2 3 4\n"
    assert len(mesh_of(text).indices) == 2


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize(
    "faces",
    [[[0, 1, 2]], [[0, 1, 2, 3]], [[0, 1, 2, 4, 3]], [[0, 1, 2], [0, 2, 4, 3]], [[0, 1, 2, 4, 3], [0, 1, 2]]],
)
def test_ply_of_every_form(mesh_of: Any, form: str, faces: list[list[int]], extra: bool) -> None:
    mesh = mesh_of(ply(faces, form, extra))
    expected = [(f[0], f[i], f[i + 1]) for f in faces for i in range(1, len(f) - 1)]
    edges = corners(mesh)
    areas = np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1) / 2
    p = np.array(VERTICES, float)
    due = [np.linalg.norm(np.cross(p[b] - p[a], p[c] - p[a])) / 2 for a, b, c in expected]
    assert areas.sum() == pytest.approx(sum(due))
    assert len(mesh.indices) == len(expected)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (len(mesh.positions), 1)))
    np.testing.assert_allclose(mesh.uvs[mesh.indices], edges[..., :2])
    assert mesh.indices.dtype == np.uint32


def test_ply_texture_coordinates_of_faces_split_vertices(mesh_of: Any) -> None:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property float nx\nproperty float ny\nproperty float nz\nelement face 2\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    )
    vertices = "0 0 0 0 0 1\n1 0 0 0 1 0\n1 1 0 1 0 0\n0 1 0 0 0 -1\n"
    faces = "3 0 1 2 6 0 0 .5 0 .5 .5\n3 0 2 3 6 .25 .25 1 1 0 1\n"
    mesh = mesh_of(head + vertices + faces)
    order = np.argsort(corners(mesh)[:, 1, 1])
    at = mesh.indices[order]
    np.testing.assert_allclose(mesh.uvs[at], [[[0, 0], [0.5, 0], [0.5, 0.5]], [[0.25, 0.25], [1, 1], [0, 1]]])
    n = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1]])
    np.testing.assert_allclose(mesh.normals[at], n[[[0, 1, 2], [0, 2, 3]]])


def test_glb_transforms_are_applied_and_mirrors_keep_the_outside(mesh_of: Any) -> None:
    import trimesh

    scene = trimesh.Scene()
    box = trimesh.creation.box()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(box, transform=np.diag([-1.0, 1.0, 2.0, 1.0]))
    mesh = mesh_of(scene.export(file_type="glb"))
    a, b, c = (corners(mesh)[:, i] for i in range(3))
    # the divergence theorem: a closed surface whose outside is outside has this volume
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(1 + 2)
    assert mesh.positions[:, 0].max() == pytest.approx(5.5)


BROKEN_MESHES: dict[str, bytes] = {
    "empty": b"",
    "words": b"this is no mesh",
    "zeros": bytes(1000),
    "obj without faces": OBJ.encode(),
    "obj index too large": (OBJ + "f 1 2 9\n").encode(),
    "obj index zero": (OBJ + "f 0 1 2\n").encode(),
    "obj index below the first": (OBJ + "f -9 1 2\n").encode(),
    "obj nan": (OBJ.replace("v 0 0 0", "v nan 0 0") + "f 1 2 3\n").encode(),
    "obj infinite": (OBJ.replace("v 0 0 0", "v 1e999 0 0") + "f 1 2 3\n").encode(),
    "obj huge": (OBJ.replace("v 0 0 0", "v 1e30 0 0") + "f 1 2 3\n").encode(),
    "obj face of two": (OBJ + "f 1 2\n").encode(),
    "obj letters": (OBJ + "f a b c\n").encode(),
    "obj two coordinates": b"v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n",
    "ply cut": ply([[0, 1, 2]], "ascii")[:-20],
    "ply binary cut": ply([[0, 1, 2]], "binary_little_endian")[:-5],
    "ply mixed cut": ply([[0, 1, 2], [0, 1, 2, 3]], "binary_little_endian")[:-5],
    "ply header cut": b"ply\nformat ascii 1.0\nelement vertex 4\n",
    "ply header only": b"ply\nformat ascii 1.0\nend_header\n",
    "ply index too large": ply([[0, 1, 99]], "binary_little_endian"),
    "ply index negative": ply([[0, 1, -1]], "ascii"),
    "ply mixed index negative": ply([[0, 1, -1], [0, 1, 2, 3]], "binary_little_endian"),
    "ply without faces": ply([], "ascii"),
    "ply more than there is": ply([[0, 1, 2]], "ascii").replace(b"vertex 5", b"vertex 4000000000"),
    "ply binary more than there is": ply([[0, 1, 2]], "binary_little_endian").replace(
        b"vertex 5", b"vertex 4000000000"
    ),
    "ply faces more than there are": ply([[0, 1, 2], [0, 1, 2, 3]], "binary_little_endian").replace(
        b"face 2", b"face 2000000000"
    ),
    "ply nan": ply([[0, 1, 2]], "binary_little_endian").replace(
        struct.pack("<3f", 1, 1, 0), struct.pack("<3f", 1, np.nan, 0)
    ),
    "glb cut": b"glTF" + struct.pack("<II", 2, 100),
    "glb junk": b"glTF" + bytes(range(256)) * 4,
    "glb huge length": b"glTF" + struct.pack("<IIII", 2, 2**32 - 1, 2**32 - 1, 0x4E4F534A) + b"{}",
    "an image": b"\x89PNG\r\n\x1a\n",
}


@pytest.mark.parametrize("name", BROKEN_MESHES)
def test_a_broken_mesh_gives_an_error_that_tells(mesh_of: Any, name: str) -> None:
    with pytest.raises(AssetError) as caught:
        mesh_of(BROKEN_MESHES[name])
    assert str(caught.value).startswith("mesh file: ")
    assert len(str(caught.value)) > len("mesh file: ") + 10
    assert "Traceback" not in str(caught.value)


def written(
    tmp_path: Path, name: str, pixels: NDArray[Any], kind: str, channels: tuple[str, ...] = ()
) -> bytes:
    path = tmp_path / name
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], oiio.TypeDesc(kind))
    if channels:
        spec.channelnames = channels
    writer = oiio.ImageOutput.create(str(path))
    assert writer.open(str(path), spec), writer.geterror()
    writer.write_image(pixels)
    writer.close()
    return path.read_bytes()


def test_an_8_bit_png_is_scaled_and_has_row_0_on_top(image_of: Any, tmp_path: Path) -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (5, 7, 3), np.uint8)
    image = image_of(written(tmp_path, "a.png", pixels, "uint8"))
    assert image.eight_bit
    np.testing.assert_allclose(image.pixels, pixels / 255.0, atol=1e-7)


def test_colours_under_alpha_are_as_stored(image_of: Any, tmp_path: Path) -> None:
    pixels = np.full((2, 2, 4), 200, np.uint8)
    pixels[..., 3] = 10
    spec_bytes = written(tmp_path, "a.tif", pixels, "uint8")
    image = image_of(spec_bytes)
    assert image.pixels.shape == (2, 2, 3)
    np.testing.assert_allclose(image.pixels, 200 / 255, atol=1e-6)


def test_gray_becomes_three_channels_and_16_bits_are_not_eight(image_of: Any, tmp_path: Path) -> None:
    pixels = np.array([[[0], [65535]], [[257], [32768]]], np.uint16)
    image = image_of(written(tmp_path, "a.png", pixels, "uint16"))
    assert not image.eight_bit
    np.testing.assert_allclose(image.pixels, np.repeat(pixels / 65535.0, 3, axis=2), atol=1e-6)


def test_exr_channels_are_found_by_name(image_of: Any, tmp_path: Path) -> None:
    pixels = np.random.default_rng(5).lognormal(0, 3, (4, 6, 5)).astype(np.float32)
    data = written(tmp_path, "a.exr", pixels, "float", ("Z", "B", "A", "G", "R"))
    image = image_of(data)
    assert not image.eight_bit
    np.testing.assert_array_equal(image.pixels, pixels[..., [4, 3, 1]])


def test_radiance_hdr_is_read(image_of: Any, tmp_path: Path) -> None:
    pixels = np.full((9, 10, 3), 3.0, np.float32)
    image = image_of(written(tmp_path, "a.hdr", pixels, "float"))
    np.testing.assert_allclose(image.pixels, pixels, rtol=0.01)
    assert not image.eight_bit


def test_the_decoding_process_tells_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ + "f 1 2 9\n")
    line = OBJ.count("\n") + 1
    told = f"line {line} refers to v 9, but there are only {line - 1} of them"  # OBJ counts from 1
    with pytest.raises(AssetError, match=told):
        FolderAssets(tmp_path / "a", tmp_path).mesh(AssetRef(file="m.obj"))


def png_bomb(width: int, height: int) -> bytes:
    """A small PNG file that claims (and, decompressed, holds) many pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    packed = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def test_broken_images_give_errors_that_tell(image_of: Any, tmp_path: Path) -> None:
    nan = np.full((2, 2, 3), np.nan, np.float32)
    good = written(tmp_path, "b.png", np.zeros((30, 30, 3), np.uint8), "uint8")
    broken = {
        "none of the accepted formats": b"no image",
        "empty": b"",
        "finite": written(tmp_path, "n.exr", nan, "float"),
        "claims": png_bomb(40_000, 40_000),
        "limit": png_bomb(100_000, 100_000),
    }
    for words, data in broken.items():
        with pytest.raises(AssetError, match=words):
            image_of(data)
    for data in (
        good[: len(good) // 2],
        png_bomb(1000, 1000),
        b"\x76\x2f\x31\x01" + bytes(50),
        b"II*\x00" + b"\xff" * 90,
    ):
        with pytest.raises(AssetError):
            image_of(data)
    with pytest.raises(AssetError, match="accepted formats"):
        image_of(OBJ.encode())


@pytest.mark.parametrize(
    ("limits", "words"), [(DecodeLimits(side=29), "29"), (DecodeLimits(pixels=899), "899")]
)
def test_images_have_limits(
    assets: FolderAssets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: DecodeLimits, words: str
) -> None:
    written(tmp_path, "b.png", np.zeros((30, 30, 3), np.uint8), "uint8")
    monkeypatch.setattr(assets, "_limits", limits)
    with pytest.raises(AssetError, match=f"30 x 30 pixels.*{words}"):
        assets.image(AssetRef(file="b.png"))


def test_decoding_has_a_memory_limit(tmp_path: Path) -> None:
    (tmp_path / "big.obj").write_text(OBJ + "f 1 2 3\n" * 1_000_000)
    assets = FolderAssets(tmp_path / "a", tmp_path, limits=DecodeLimits(memory_bytes=400 << 20))
    with pytest.raises(AssetError, match="memory"):
        assets.mesh(AssetRef(file="big.obj"))
    (tmp_path / "small.obj").write_text(OBJ + "f 1 2 3\n")
    assert len(assets.mesh(AssetRef(file="small.obj")).indices) == 1


def test_decoding_has_a_time_limit(tmp_path: Path) -> None:
    (tmp_path / "slow.obj").write_text(OBJ + "f 1 2 3\n" * 100_000)
    assets = FolderAssets(tmp_path / "a", tmp_path, limits=DecodeLimits(seconds=0.05))
    began = time.monotonic()
    with pytest.raises(AssetError, match=r"0\.05 s"):
        assets.mesh(AssetRef(file="slow.obj"))
    assert time.monotonic() - began < 5


def test_files_triangles_and_pixels_have_limits(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ + "f 1 2 3\nf 1 2 4\n")
    ref = AssetRef(file="m.obj")
    for limits, words in (
        (DecodeLimits(file_bytes=10), "10"),
        (DecodeLimits(triangles=1), "2 triangles"),
        (DecodeLimits(vertices=2), "vertices"),
    ):
        with pytest.raises(AssetError, match=words):
            FolderAssets(tmp_path / f"a{words[0]}", tmp_path, limits=limits).mesh(ref)


@pytest.mark.parametrize("found", ["a file", "an empty folder", "another folder"])
def test_what_is_no_entry_gives_way_to_one(assets: FolderAssets, tmp_path: Path, found: str) -> None:
    (tmp_path / "file").write_text(OBJ + "f 1 2 3\n")
    digest = hashlib.sha256((tmp_path / "file").read_bytes()).hexdigest()
    place = tmp_path / "assets" / ".decoded" / f"v{CACHE_VERSION}" / "mesh" / digest
    place.parent.mkdir(parents=True)
    if found == "a file":
        place.write_text("")
    else:
        place.mkdir()
    if found == "another folder":
        (place / "note.txt").write_text("")
    for _ in range(2):
        assert len(assets.mesh(AssetRef(file="file")).indices) == 1


def test_files_stay_inside_the_scenes_folder(tmp_path: Path) -> None:
    inside, outside = tmp_path / "scene", tmp_path / "secret.obj"
    inside.mkdir()
    outside.write_text(OBJ + "f 1 2 3\n")
    (inside / "link.obj").symlink_to(outside)
    assets = FolderAssets(tmp_path / "a", inside)
    with pytest.raises(AssetError, match="outside"):
        assets.mesh(AssetRef(file="link.obj"))
    with pytest.raises(AssetError, match="no such file"):
        assets.mesh(AssetRef(file="none.obj"))
    with pytest.raises(AssetError, match="command line"):
        FolderAssets(tmp_path / "a").mesh(AssetRef(file="link.obj"))


def test_assets_by_content_are_found_and_decoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = (OBJ + "f 1 2 3\n").encode()
    digest = hashlib.sha256(data).hexdigest()
    folder = tmp_path / "assets"
    (folder / digest[:2]).mkdir(parents=True)
    (folder / digest[:2] / digest).write_bytes(data)
    ref = AssetRef(asset=f"sha256:{digest}")
    first = FolderAssets(folder).mesh(ref)

    def nothing_runs(*_: object, **__: object) -> None:
        raise AssertionError("it was decoded again")

    monkeypatch.setattr("subprocess.run", nothing_runs)
    again = FolderAssets(folder).mesh(ref)
    np.testing.assert_array_equal(first.positions, again.positions)
    with pytest.raises(ValueError, match="read-only"):
        again.positions[0] = 1
    with pytest.raises(AssetError, match="upload"):
        FolderAssets(folder).mesh(AssetRef(asset="sha256:" + "0" * 64))
