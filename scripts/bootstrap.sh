#!/usr/bin/env bash
# Makes the virtual environment that every make target runs in: .venv, or the folder that VENV names.
#
# 1. checks what pip and PoCL need from the system, installs it with apt-get where that may be done (root on
#    Debian), and otherwise prints the one line that does it;
# 2. installs the pinned packages of requirements.lock, whose hashes pip verifies, then this checkout, editable.
#
# A stamp in the environment makes a second run instant until the lock file, pyproject.toml or Python changes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

venv=${VENV:-.venv}
python=${PYTHON:-python3}
stamp=$venv/.penumbra-stamp
min_minor=11

say() { printf 'penumbra: %s\n' "$*"; }
fail() {
  say "$*" >&2
  exit 1
}

# Everything that an installed environment depends on, in one line.
fingerprint() {
  { cat requirements.lock pyproject.toml; "$python" -VV; pwd; } 2>/dev/null | sha256sum | cut -d ' ' -f 1
}

python_is_new_enough() {
  "$python" -c "import sys; sys.exit(sys.version_info < (3, $min_minor))" >/dev/null 2>&1
}

python_has_venv() {
  "$python" -c 'import ensurepip, venv' >/dev/null 2>&1
}

# PoCL's compiler calls `ld` on the host's libc and libgcc for every kernel, and ends the whole process where that
# fails. So do here what it will do: link an empty shared object with the same libraries.
linker_works() {
  command -v ld >/dev/null || return 1
  local object status=0 libgcc search=()
  for libgcc in /usr/lib/gcc/*/*/libgcc.a; do
    if [ -e "$libgcc" ]; then search+=("-L${libgcc%/*}"); fi
  done
  object=$(mktemp)
  ld -shared -o "$object" "${search[@]}" -L/usr/lib/"$(uname -m)"-linux-gnu -L/usr/lib64 -L/usr/lib \
    -lgcc --as-needed -lgcc_s --no-as-needed -lc -lm >/dev/null 2>&1 || status=1
  rm -f "$object"
  return $status
}

# The Debian packages that this machine still lacks, one a line.
missing_packages() {
  command -v "$python" >/dev/null || echo python3
  python_has_venv || echo python3-venv
  linker_works || printf '%s\n' binutils gcc libc6-dev
}

provide_system_packages() {
  local packages
  packages=$(missing_packages | tr '\n' ' ')
  packages=${packages% }
  if [ -z "$packages" ]; then return; fi
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    say "this machine lacks what Penumbra's kernels are linked with, or Python's venv. Install it, then run make again:" >&2
    say "    sudo apt-get install -y $packages" >&2
    exit 1
  fi
  say "installing $packages with apt-get"
  # shellcheck disable=SC2086 # a list of names
  { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $packages; } \
    >"${TMPDIR:-/tmp}/penumbra-apt.log" 2>&1 || fail "apt-get failed; its log is ${TMPDIR:-/tmp}/penumbra-apt.log"
}

check_system() {
  if [ "$(uname -s)" != Linux ]; then fail "Penumbra's pinned packages are for Linux; this is $(uname -s)"; fi
  if command -v "$python" >/dev/null && ! python_is_new_enough; then
    fail "needs Python 3.$min_minor or newer, but $python is $("$python" -V 2>&1); name another with PYTHON=python3.12 make ..."
  fi
  provide_system_packages
  linker_works ||
    fail "'ld' still cannot link with libc and libgcc, which PoCL needs for every kernel; try: ld -shared -o /tmp/x -lc -lm"
}

install_packages() {
  local pip=("$venv/bin/python" -m pip --disable-pip-version-check)
  if ! "${pip[@]}" --version >/dev/null 2>&1; then
    say "making the virtual environment $venv"
    "$python" -m venv --clear "$venv"
  fi
  say "installing pinned packages (a minute or two the first time)"
  "${pip[@]}" install --quiet --require-hashes --requirement requirements.lock ||
    fail "pip could not install requirements.lock; is a package index reachable (pip config list)?"
  "${pip[@]}" install --quiet --no-deps --no-build-isolation --editable . ||
    fail "pip could not install this checkout"
}

now=$(fingerprint)
if [ -x "$venv/bin/penumbra" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$now" ]; then exit 0; fi
check_system
rm -f "$stamp"
install_packages
fingerprint >"$stamp"
say "ready: $venv"
