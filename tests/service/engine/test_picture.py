"""What a picture's run leaves in its folder, and how often it is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from penumbra_service import picture as pictures
from penumbra_service import results
from penumbra_service.picture import Picture, PictureRunner
from penumbra_service.running import Control


@pytest.mark.parametrize("watched", [True, False])
def test_thumbnail_and_noise_map_of_the_end_are_written_once(
    fake_engine: Any, make_task: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    """Those that whoever watches is shown are the results' own."""
    written: list[Any] = []

    def counting(write: Callable[..., None]) -> Callable[..., None]:
        def count(folder: Path, scene: Any, image: Any) -> None:
            written.append(image)
            write(folder, scene, image)

        return count

    for module in (pictures, results):
        monkeypatch.setattr(module, "write_pictures", counting(results.write_pictures))
    task = make_task()
    task.folder.mkdir()
    shown: list[int] = []
    outcome = PictureRunner(fake_engine(), tmp_path / "assets").run(
        Picture(
            "job",
            "",
            task.scene,
            task.folder,
            Control(),
            lambda *_: None,
            (lambda: shown.append(1)) if watched else None,
        )
    )
    assert outcome.receipt is not None
    assert len({id(image) for image in written}) == len(written) == max(len(shown), 1)
    assert all((task.folder / name).is_file() for name in results.ALL)
