#!/usr/bin/env bash
# Makes what docker-compose.yml must not hold: an API key, a database password, the farm's certificates, in secrets/.
#
# The folder is closed to everybody else. The files in it are readable, since Compose shows them to containers with the
# permissions that they have here, and containers run as users whom this machine does not know.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

penumbra=${VENV:-.venv}/bin/penumbra
if [ -e secrets ]; then
  echo "penumbra: secrets/ is there already; remove it to make new ones (the database keeps its old password)" >&2
  exit 1
fi

secret() { python3 -c 'import secrets; print(secrets.token_urlsafe(32))'; }

umask 077
mkdir secrets
password=$(secret)
printf 'pnb_%s\n' "$(secret)" >secrets/api-key
printf '%s\n' "$password" >secrets/database-password
printf 'postgresql+psycopg://penumbra:%s@database/penumbra\n' "$password" >secrets/database-url
"$penumbra" certs secrets/certs >/dev/null
chmod 755 secrets/certs
find secrets -type f -not -name ca-key.pem -exec chmod 644 {} +
echo "penumbra: secrets/ is made; the API key is in secrets/api-key"
