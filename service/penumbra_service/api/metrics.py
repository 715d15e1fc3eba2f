"""Prometheus metrics: requests as they come, jobs and devices as they stand when asked."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Final

from penumbra_scene.job import DeviceState, JobState
from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily
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

    def collect(self) -> Iterable[GaugeMetricFamily]:
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
        return jobs, states, speed, crashes


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
