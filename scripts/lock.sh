#!/usr/bin/env bash
# Writes requirements.lock: every package that the extras need, pinned with hashes, naming no host.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bin=${VENV:-.venv}/bin
"$bin/python" -m uv --version >/dev/null 2>&1 || "$bin/python" -m pip install --quiet uv
"$bin/python" -m uv pip compile pyproject.toml --extra service --extra cpu --extra dev \
  --python-version 3.11 --universal --generate-hashes \
  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
  --output-file requirements.lock "$@" >/dev/null
