"""Removes what nobody needs any more: files that a killed process left, and, as old as the settings say, jobs that have
ended, assets that no job names, decoded copies and contents of the farm that nobody used. Once at the start and every hour."""

from __future__ import annotations

import contextlib
import logging
import shutil
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from penumbra_scene.job import JobState

from penumbra_service.images.assets import decoded_entries
from penumbra_service.job_queue import OPEN
from penumbra_service.settings import Settings
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.assets import AssetStore
from penumbra_service.store.contents import ContentStore, contents_url
from penumbra_service.store.jobs import JobStore

log = logging.getLogger(__name__)

EVERY_SECONDS: Final = 3600.0
ENDED: Final = tuple(state for state in JobState if state.ended)
UPLOAD_DAYS: Final = 1.0
"""An upload that was not finished after so long never will be."""

QUOTE_PREFIX: Final = "quote-"
"""Of the names of folders that quotes are made in."""
QUOTE_SECONDS: Final = 3600.0
"""Where services share their folders, a quote's is left alone for so long: another service may be making it."""


class Housekeeper:
    """All methods but `start` and `stop` may be called at any time, by several services at once."""

    def __init__(self, settings: Settings, jobs: JobStore, artifacts: Artifacts, assets: AssetStore) -> None:
        self._settings = settings
        self._jobs = jobs
        self._artifacts = artifacts
        self._assets = assets
        self._contents = ContentStore(contents_url(settings.artifacts))
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin; what was left behind is gone when this returns."""
        self.sweep_leftovers()
        self._thread = threading.Thread(target=self._run, name="penumbra-housekeeping", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(self._settings.shutdown_seconds)

    def _run(self) -> None:
        while True:
            try:
                self.tidy(datetime.now(UTC))
            except Exception:
                log.exception("housekeeping cannot go on; it tries again in an hour")
            if self._stopping.wait(EVERY_SECONDS):
                return

    def tidy(self, now: datetime) -> None:
        """All of it, as of `now`."""
        self.remove_jobs(now)
        self.remove_assets(now)
        self.remove_decoded(now)
        self.remove_contents(now)

    def sweep_leftovers(self) -> None:
        """Folders of jobs that have ended, uploads that never did."""
        # A service beside this one may be busy: what is new to the ledger is not yet in the list of folders.
        folder = self._settings.work_folder
        found = list(folder.iterdir()) if folder.is_dir() else []
        kept = {row.id for row in self._jobs.waiting(OPEN)}
        for path in found:
            if path.name not in kept and not self._may_be_quoting(path):
                shutil.rmtree(path, ignore_errors=True)
        self._assets.sweep(UPLOAD_DAYS * 86400 if self._settings.shared else 0.0)

    def _may_be_quoting(self, path: Path) -> bool:
        quoting = self._settings.shared and path.name.startswith(QUOTE_PREFIX)
        return quoting and time.time() - _used(path) < QUOTE_SECONDS

    def remove_jobs(self, now: datetime) -> int:
        """Jobs that ended long ago, with all their files; how many those were."""
        if not self._settings.keep_days:
            return 0
        removed = 0
        while not self._stopping.is_set():
            rows = self._jobs.ended_before(ENDED, now - timedelta(days=self._settings.keep_days))
            for row in rows:
                self._artifacts.remove(row.id)
                self._jobs.remove(row.id)
                log.info("job %s: removed, %g days after its end", row.id, self._settings.keep_days)
            removed += len(rows)
            if not rows:
                break
        return removed

    def remove_assets(self, now: datetime) -> int:
        """Assets that no job names, long after they came; how many those were."""
        if not self._settings.keep_assets_days:
            return 0
        removed = 0
        for asset in self._assets.before(now - timedelta(days=self._settings.keep_assets_days)):
            if self._stopping.is_set():
                break
            if not self._jobs.names_asset(asset.sha256):
                self._assets.remove(asset.sha256)
                log.info("asset %s: removed, no job names it", asset.sha256)
                removed += 1
        return removed

    def remove_decoded(self, now: datetime) -> int:
        """Decoded copies that nobody used for long; how many those were. They are made anew when they are asked for."""
        if not self._settings.keep_decoded_days:
            return 0
        oldest = now.timestamp() - self._settings.keep_decoded_days * 86400
        old = [path for path in decoded_entries(self._settings.assets_folder) if _used(path) < oldest]
        for path in old:
            # Aside first: a reader finds all of it or nothing.
            with contextlib.suppress(OSError):
                aside = path.with_name(f".removing-{path.name}")
                path.rename(aside)
                shutil.rmtree(aside, ignore_errors=True)
        return len(old)

    def remove_contents(self, now: datetime) -> int:
        """Scenes and assets in the artifact store that no service has had a worker fetch for long; how many those were."""
        if not self._settings.keep_contents_days:
            return 0
        removed = self._contents.remove_unused(now - timedelta(days=self._settings.keep_contents_days))
        if removed:
            log.info("%d files that workers fetched long ago: removed", removed)
        return removed


def _used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return time.time()
