#!/usr/bin/env bash
# check.sh 'PROGRAM ARGUMENTS' [OPTIONS]: starts a robot on a free port and runs `downbeat conformance OPTIONS` against it.
# SCHEME=tls or hmac uses this scheme, with DOWNBEAT_IDENTITY as the identity.
# The program takes --listen HOST:PORT and prints `listening on HOST:PORT`, or `listens on`. DOWNBEAT names another downbeat than the
# built one.
set -euo pipefail
downbeat=${DOWNBEAT:-$(cd "$(dirname "$0")/../.." && pwd)/target/release/downbeat}
read -ra program <<<"$1"
said=$(mktemp)
PYTHONDONTWRITEBYTECODE=1 "${program[@]}" --listen 127.0.0.1:0 >"$said" &
robot=$!
trap 'kill "$robot" 2>/dev/null || true; rm -f "$said"' EXIT

address=
for _ in $(seq 100); do
  address=$(sed -n 's/^.*listen[ings]* on //p' "$said")
  if [ -n "$address" ] || ! kill -0 "$robot" 2>/dev/null; then break; fi
  sleep 0.1
done
if [ -z "$address" ]; then
  echo "$1 does not listen" >&2
  exit 1
fi

timeout 300 "$downbeat" conformance "${SCHEME:-tcp}://$address" "${@:2}"
if ! kill -0 "$robot" 2>/dev/null; then
  echo "$1 ended meanwhile" >&2
  exit 1
fi
