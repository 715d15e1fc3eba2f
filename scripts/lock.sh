#!/usr/bin/env bash
# Pins every package with hashes, naming no host: requirements.lock has all that developing and testing need,
# requirements-service.lock the same versions of what the service alone needs, bench/peers/requirements.lock the renderers that
# bench/ compares with and that cannot live beside Penumbra.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=${VENV:-.venv}/bin/python
"$python" -m uv --version >/dev/null 2>&1 || "$python" -m pip install --quiet uv

# pin OUTPUT EXTRA...
pin() {
  local output=$1 extras=() extra
  shift
  for extra in "$@"; do extras+=(--extra "$extra"); done
  "$python" -m uv pip compile pyproject.toml "${extras[@]}" --python-version 3.11 --universal \
    --generate-hashes --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
    --output-file "$output" "${upgrade[@]}" >/dev/null
}

upgrade=("$@")
pin requirements.lock service cpu plots farm dev
"$python" -m uv pip compile bench/peers/requirements.in --python-version 3.11 --universal --generate-hashes \
  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
  --output-file bench/peers/requirements.lock "${upgrade[@]}" >/dev/null
upgrade=(--constraint requirements.lock)
pin requirements-service.lock service cpu plots farm
