"""Scene files on this machine's disk: reading them, and the files that they name.

A scene names meshes and images either by content, `{"asset": "sha256:..."}`, or, on the command line, by a
file beside it, `{"file": "meshes/cup.ply"}`. The service accepts content hashes only, so files are uploaded
and the names rewritten.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from penumbra_scene import limits
from penumbra_scene.errors import ProblemError
from penumbra_scene.parse import parse_json

from penumbra_client.errors import SceneFileError

JsonObject = dict[str, Any]
_BLOCK: Final = 1 << 20


def read_scene(source: str) -> tuple[JsonObject, Path]:
    """A scene document and the folder of its files; `-` is standard input, with the current folder.

    Raises SceneFileError where it cannot be read or is not a JSON object. Whether it is a valid scene is for
    whoever gets it to say.
    """
    if source == "-":
        return parse_scene(sys.stdin.buffer.read(), "standard input"), Path()
    path = Path(source)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneFileError(f"cannot read {path}: {error.strerror or error}") from error
    return parse_scene(data, str(path)), path.parent


def parse_scene(data: bytes, name: str) -> JsonObject:
    """A document as the service would read it."""
    try:
        document = parse_json(data)
    except ProblemError as error:
        raise SceneFileError(f"{name}: {error}") from None
    if not isinstance(document, dict):
        raise SceneFileError(f"{name} is not a scene: it holds no JSON object, but {type(document).__name__}")
    return document


def named_files(document: Any, pointer: str = "") -> Iterator[tuple[str, str]]:
    """(JSON pointer, file name) of everything in the document that names a file."""
    if isinstance(document, dict):
        if set(document) == {"file"} and isinstance(document["file"], str):
            yield pointer, document["file"]
            return
        for key, value in document.items():
            yield from named_files(value, f"{pointer}/{_escape(key)}")
    elif isinstance(document, list) and not _all_numbers(document):
        for index, value in enumerate(document):
            yield from named_files(value, f"{pointer}/{index}")


def _escape(key: str) -> str:
    """A key as a step of a JSON pointer (RFC 6901)."""
    return key.replace("~", "~0").replace("/", "~1")


def _all_numbers(values: list[Any]) -> bool:
    """Whether there is nothing to look for: inline meshes have millions of numbers."""
    return bool(values) and not isinstance(values[0], (dict, list))


def with_assets(document: Any, hashes: Mapping[str, str]) -> Any:
    """The document with each named file replaced by its content hash (`sha256:...`)."""
    if isinstance(document, dict):
        if set(document) == {"file"} and document["file"] in hashes:
            return {"asset": hashes[document["file"]]}
        return {key: with_assets(value, hashes) for key, value in document.items()}
    if isinstance(document, list) and not _all_numbers(document):
        return [with_assets(value, hashes) for value in document]
    return document


def resolve_file(folder: Path, name: str, pointer: str) -> Path:
    """Where a named file lies. Raises SceneFileError if it is missing, too large, or outside the folder."""
    root = folder.resolve()
    path = (root / name).resolve()
    where = f"{pointer or 'the top'} names the file {name!r}"
    if not path.is_relative_to(root):
        raise SceneFileError(f"{where}, which is outside the scene's folder {root}")
    if not path.is_file():
        raise SceneFileError(f"{where}, but there is no such file in {root}")
    size = path.stat().st_size
    if size > limits.MAX_ASSET_BYTES:
        raise SceneFileError(f"{where} of {size} bytes; accepted: at most {limits.MAX_ASSET_BYTES}")
    return path


def content_hash(path: Path) -> str:
    """`sha256:` and the hexadecimal digest of a file's bytes."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        raise SceneFileError(f"cannot read {path}: {error.strerror or error}") from error
    return f"sha256:{digest.hexdigest()}"
