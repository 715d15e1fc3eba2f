"""The contract as JSON Schema 2020-12: `python -m penumbra_scene.schema [folder]` writes docs/schema/."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

from penumbra_scene.base import Model
from penumbra_scene.job import JobChange, JobRequest
from penumbra_scene.quote import Quote
from penumbra_scene.receipt import Receipt
from penumbra_scene.scene import Scene

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
PUBLISHED: Final[dict[str, type[Model]]] = {
    "scene": Scene,
    "job": JobRequest,
    "receipt": Receipt,
    "quote": Quote,
}
_ANSWERS: Final = (Receipt, Quote)
"""What Penumbra writes, and nobody sends."""
_FOLDER: Final = Path(__file__).resolve().parents[2] / "docs" / "schema"


def input_schema(title: str) -> dict[str, Any]:
    """The schema of what the model of that name takes; {} for one that users do not send."""
    sent: dict[str, type[Model]] = {"Scene": Scene, "JobRequest": JobRequest, "JobChange": JobChange}
    return sent[title].model_json_schema() if title in sent else {}


def published(name: str) -> dict[str, Any]:
    """The schema under its published name: scene, job, receipt or quote."""
    model = PUBLISHED[name]
    schema = model.model_json_schema(mode="serialization" if model in _ANSWERS else "validation")
    return {"$schema": DIALECT, "$id": f"urn:penumbra:schema:{name}:1", **schema}


def text(name: str) -> str:
    """The file's text."""
    return json.dumps(published(name), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write every schema into the folder given, or into docs/schema."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else _FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name in PUBLISHED:
        (folder / f"{name}.schema.json").write_text(text(name), encoding="utf-8")


if __name__ == "__main__":
    main()
