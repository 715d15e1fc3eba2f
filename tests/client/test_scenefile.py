"""Scene files: what is read, which files they name, and that no name leads out of the scene's folder."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from penumbra_client.errors import SceneFileError
from penumbra_client.scenefile import (
    content_hash,
    named_files,
    parse_scene,
    read_scene,
    resolve_file,
    with_assets,
)

SCENE = {
    "version": 1,
    "textures": {"wood/oak": {"type": "image", "image": {"file": "wood.png"}}},
    "shapes": [
        {"type": "mesh", "source": {"file": "cup.ply"}},
        {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "indices": [[0, 1, 2]]},
        {"type": "mesh", "source": {"asset": "sha256:" + "0" * 64}},
    ],
}


def test_named_files_are_found_with_their_pointers() -> None:
    assert list(named_files(SCENE)) == [
        ("/textures/wood~1oak/image", "wood.png"),
        ("/shapes/0/source", "cup.ply"),
    ]


def test_a_material_that_is_called_file_is_no_file() -> None:
    assert list(named_files({"materials": {"file": {"type": "diffuse"}}})) == []


def test_files_become_assets_and_nothing_else_changes() -> None:
    hashes = {"wood.png": "sha256:" + "a" * 64, "cup.ply": "sha256:" + "b" * 64}
    changed = with_assets(SCENE, hashes)
    assert list(named_files(changed)) == []
    assert changed["shapes"][0]["source"] == {"asset": hashes["cup.ply"]}
    assert changed["shapes"][1:] == SCENE["shapes"][1:]


def test_content_hash_is_sha256_of_the_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"penumbra" * 300_000)  # more than one block
    assert content_hash(path) == "sha256:" + hashlib.sha256(b"penumbra" * 300_000).hexdigest()


def test_a_file_beside_the_scene_is_resolved(tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "cup.ply").touch()
    assert resolve_file(tmp_path, "m/cup.ply", "/x") == tmp_path / "m" / "cup.ply"


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "a/../../secret", "link"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "secret").write_text("x")
    (folder / "link").symlink_to(tmp_path / "secret")
    with pytest.raises(SceneFileError, match="outside the scene's folder"):
        resolve_file(folder, name, "/shapes/0/source")


def test_a_missing_file_is_told_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(
        SceneFileError, match=r"/shapes/0/source names the file 'cup.ply', but there is no such file"
    ):
        resolve_file(tmp_path, "cup.ply", "/shapes/0/source")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"{", "line 1, column 2"),
        (b"[]", "holds no JSON object, but list"),
        (b'{"a": 1, "a": 2}', "twice"),
        (b"\xff\xfe{}", "byte 0 is not UTF-8"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_what_is_no_scene_document_is_told(data: bytes, message: str) -> None:
    with pytest.raises(SceneFileError, match=message):
        parse_scene(data, "scene.json")


def test_read_scene_gives_the_folder_of_its_files(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    assert read_scene(str(path)) == (SCENE, tmp_path)
    with pytest.raises(SceneFileError, match="cannot read"):
        read_scene(str(tmp_path / "other.json"))
