"""Assets: bytes that a scene names by their SHA-256, or, on the command line, by a file beside the scene."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import StringConstraints, model_validator

from penumbra_scene.base import Model

Sha256 = Annotated[str, StringConstraints(pattern=r"^sha256:[0-9a-f]{64}$")]


class AssetRef(Model):
    """Exactly one of `asset` and `file`. The service accepts `asset` only; the command line uploads files for you."""

    asset: Sha256 | None = None
    file: Annotated[str, StringConstraints(min_length=1, max_length=1024)] | None = None
    """A path relative to the scene's own folder, which it must not leave."""

    @model_validator(mode="after")
    def _one_source(self) -> Any:
        if (self.asset is None) == (self.file is None):
            raise ValueError("give exactly one of asset (sha256:...) and file")
        if self.file is not None and (self.file.startswith(("/", "\\")) or ".." in self.file.replace("\\", "/").split("/")):
            raise ValueError("file must stay inside the scene's folder: no absolute path, no '..'")
        return self
