"""Prometheus metrics: requests as they come, jobs and devices as they stand when asked."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

from penumbra_scene.job import DeviceState, DeviceStatus, JobState
from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from penumbra_service.service import RenderService

_BUCKETS: Final = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
"""Seconds."""


class Metrics:
    """The registry of one application."""

    def __init__(self, service: RenderService) -> None:
        self.registry = CollectorRegistry()
        self.registry.register(_Standing(service))
        self.requests = Counter(
            "penumbra_http_requests",
            "Requests by route",
            ("method", "route", "status"),
            registry=self.registry,
        )
        self.seconds = Histogram(
            "penumbra_http_request_seconds",
            "Time until the answer began",
            ("method", "route"),
            registry=self.registry,
            buckets=_BUCKETS,
        )


class _Standing(Collector):
    """Jobs by state, devices by state and their speed."""

    def __init__(self, service: RenderService) -> None:
        self._service = service

    def collect(self) -> Iterable[Metric]:
        counts = self._service.jobs.counts()
        jobs = GaugeMetricFamily("penumbra_jobs", "Jobs by state", labels=("state",))
        for state in JobState:
            jobs.add_metric((state.value,), counts.get(state.value, 0))
        devices = self._service.runner.devices()
        states = GaugeMetricFamily("penumbra_devices", "Devices by state", labels=("state",))
        for device_state in DeviceState:
            states.add_metric((device_state.value,), sum(d.state == device_state for d in devices))
        speed = GaugeMetricFamily("penumbra_device_samples_per_second", "Speed by device", labels=("device",))
        crashes = GaugeMetricFamily("penumbra_device_crashes", "Crashes by device", labels=("device",))
        for device in devices:
            speed.add_metric((device.id,), device.samples_per_second or 0.0)
            crashes.add_metric((device.id,), device.crashes)
        return jobs, states, speed, crashes, _leases(devices), *_work(self._service)


def _leases(devices: list[DeviceStatus]) -> Metric:
    leases = CounterMetricFamily("penumbra_leases", "Leases that devices have done", labels=("device",))
    for device in devices:
        leases.add_metric((device.id,), device.leases_done)
    return leases


def _work(service: RenderService) -> Iterable[Metric]:
    """What the running jobs are doing. Labels name running jobs only, so that they stay few."""
    spent = CounterMetricFamily("penumbra_device_seconds", "Seconds of devices that jobs have used")
    spent.add_metric((), service.device_seconds)
    error = GaugeMetricFamily("penumbra_job_relative_error", "Relative error by running job", labels=("job",))
    fall = GaugeMetricFamily(
        "penumbra_job_error_fall_per_second",
        "How fast relMSE falls, by running job: theta relMSE / seconds of tracing",
        labels=("job",),
    )
    frames = GaugeMetricFamily("penumbra_frames", "Frames of running jobs", labels=("state",))
    counts = dict.fromkeys(("done", "failed", "open"), 0)
    for row in service.queue.running:
        progress = service.jobs.get(row.id).progress
        _add_error(progress, row.id, error, fall)
        several = progress.get("frames")
        if several:
            done, failed = several.get("done", 0), several.get("failed", 0)
            counts["done"] += done
            counts["failed"] += failed
            counts["open"] += several["total"] - done - failed
    for state, count in counts.items():
        frames.add_metric((state,), count)
    return spent, error, fall, frames


def _add_error(
    progress: Mapping[str, Any], job: str, error: GaugeMetricFamily, fall: GaugeMetricFamily
) -> None:
    relmse, seconds = progress.get("relmse"), progress.get("seconds", 0.0)
    if relmse is None:
        return
    error.add_metric((job,), math.sqrt(relmse))
    if seconds > 0:
        theta = progress.get("theta")
        fall.add_metric((job,), (1.0 if theta is None else theta) * relmse / seconds)


class CountRequests:
    """ASGI middleware that fills Metrics. Routes are counted by their pattern, so labels stay few."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()

        async def watch(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._count(scope, message["status"], time.perf_counter() - began)
            await send(message)

        await self._app(scope, receive, watch)

    def _count(self, scope: Scope, status: int, seconds: float) -> None:
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in _METHODS else "other"
        self._metrics.requests.labels(method, route, str(status)).inc()
        self._metrics.seconds.labels(method, route).observe(seconds)


_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
