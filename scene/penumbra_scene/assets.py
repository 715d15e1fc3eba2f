"""Assets: bytes that a scene names by their SHA-256, or, on the command line, by a file beside the scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import StringConstraints, model_validator

from penumbra_scene.base import Model, error_at

Sha256 = Annotated[str, StringConstraints(pattern=r"^sha256:[0-9a-f]{64}$")]


_OUTSIDE = "is no path inside the scene's folder; and files can be named on the command line only"
_INSIDE = """{"asset": "sha256:..."}, uploaded to /v1/assets; on the command line also a relative path without '..'"""


def _leaves_folder(path: str) -> bool:
    parts = path.replace("\\", "/").split("/")
    return parts[0] == "" or ":" in parts[0] or ".." in parts or "\0" in path


class AssetRef(Model):
    """Exactly one of `asset` and `file`. The service takes `asset` only; the command line uploads files."""

    asset: Sha256 | None = None
    file: Annotated[str, StringConstraints(min_length=1, max_length=1024)] | None = None
    """A path relative to the scene's own folder, which it must not leave."""

    @model_validator(mode="after")
    def _one_source(self) -> AssetRef:
        if (self.asset is None) == (self.file is None):
            raise error_at(
                "", "has neither or both of asset and file", '{"asset": "sha256:..."} or {"file": path}'
            )
        if self.file is not None and _leaves_folder(self.file):
            raise error_at("/file", _OUTSIDE, _INSIDE)
        return self
