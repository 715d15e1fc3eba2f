# Service, scheduler and workers in one image: `docker compose up` (docs/containers.md). CPUs by PoCL; nothing runs as root.

FROM debian:bookworm-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY requirements.lock requirements-service.lock ./
RUN python3 -m venv /build && /build/bin/pip install --quiet --require-hashes -r requirements.lock
RUN python3 -m venv /penumbra && /penumbra/bin/pip install --quiet --require-hashes -r requirements-service.lock
COPY pyproject.toml README.md LICENSE ./
COPY scene scene
COPY kernels kernels
COPY service service
COPY client client
RUN /build/bin/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir /wheels . \
    && /penumbra/bin/pip install --quiet --no-deps /wheels/*.whl

FROM debian:bookworm-slim
# PoCL links every kernel with the system's ld, libc and libgcc.
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 binutils libc6-dev libgcc-12-dev \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --home-dir /data --shell /usr/sbin/nologin penumbra \
    && install -d -o penumbra -g penumbra /data /artifacts
COPY --from=build /penumbra /penumbra
ENV PATH=/penumbra/bin:$PATH \
    HOME=/data \
    XDG_CACHE_HOME=/data/cache \
    PENUMBRA_DATA=/data \
    PENUMBRA_HOST=0.0.0.0 \
    PENUMBRA_PORT=8484
USER penumbra
VOLUME /data
EXPOSE 8484
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s \
    CMD ["python3", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8484/health/live', timeout=4)"]
ENTRYPOINT ["penumbra"]
CMD ["serve"]
