"""How long the service takes to list jobs that wait: `python bench/job_list.py [DATABASE_URL]`.

Makes 1,000 jobs in an empty database (SQLite in a temporary folder by default), asks GET /v1/jobs for them in this
process, and prints milliseconds from request to answer, the median and the best of 21, and the median of the processor's time.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final
from unittest.mock import Mock

from fastapi.testclient import TestClient
from penumbra_scene.job import JobRequest
from penumbra_service.app import create_app
from penumbra_service.settings import Settings
from penumbra_service.status import initial_progress
from penumbra_service.store.jobs import NewJob

JOBS: Final = 1000
REPEATS: Final = 21
SCENE: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {"type": "perspective"},
    "shapes": [{"type": "sphere", "emission": {"radiance": 1}}],
}


def main(database_url: str = "") -> None:
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(data=Path(folder), database_url=database_url), Mock())
        text = json.dumps({"scene": SCENE})
        progress = initial_progress(JobRequest.model_validate({"scene": SCENE}))
        for number in range(JOBS):
            app.state.service.jobs.create(NewJob(text, "d" * 64, f"job {number}", progress=progress))
        client = TestClient(app, base_url="http://127.0.0.1")  # without its lifespan the runner is not asked
        for limit in (50, JOBS):
            seconds, spent = [], []
            for _ in range(REPEATS):
                began, before = time.perf_counter(), time.process_time()
                answer = client.get("/v1/jobs", params={"state": "queued", "limit": limit})
                seconds.append(time.perf_counter() - began)
                spent.append(time.process_time() - before)
                assert len(answer.json()["items"]) == limit
            median, best = 1e3 * statistics.median(seconds), 1e3 * min(seconds)
            cpu = 1e3 * statistics.median(spent)
            print(
                f"{limit} of {JOBS} queued jobs: median {median:.1f} ms, best {best:.1f} ms, CPU {cpu:.1f} ms"
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
