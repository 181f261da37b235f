#!/usr/bin/env bash
# check.sh 'PROGRAM ARGUMENTS' [OPTIONS]: starts a robot on a free port and runs `downbeat conformance OPTIONS` against it.
# SCHEME=tls or hmac uses this scheme, with DOWNBEAT_IDENTITY as the identity. DOWNBEAT names another downbeat than the built one.
# REVOKE='KEYS LIST ANNA BERT' then checks that the robot obeys its list of revoked keys. KEYS is the folder of the authority, LIST the
# file that ARGUMENTS names after --revoked, and ANNA and BERT are operators who may drive. The check moves the device `shoulder` and
# revokes ANNA.
# The program takes --listen HOST:PORT and prints `listening on HOST:PORT`, or `listens on`.
set -euo pipefail
downbeat=${DOWNBEAT:-$(cd "$(dirname "$0")/../.." && pwd)/target/release/downbeat}
read -ra program <<<"$1"
work=$(mktemp -d)
PYTHONDONTWRITEBYTECODE=1 "${program[@]}" --listen 127.0.0.1:0 >"$work/said" &
robot=$!
trap 'kill "$robot" 2>/dev/null || true; rm -rf "$work"' EXIT

address=
for _ in $(seq 100); do
  address=$(sed -n 's/^.*listen[ings]* on //p' "$work/said")
  if [ -n "$address" ] || ! kill -0 "$robot" 2>/dev/null; then break; fi
  sleep 0.1
done
if [ -z "$address" ]; then
  echo "$1 does not listen" >&2
  exit 1
fi
address=${SCHEME:-tcp}://$address

timeout 300 "$downbeat" conformance "$address" "${@:2}"

by() { DOWNBEAT_IDENTITY=$1 DOWNBEAT_STATE=$work/$(basename "$1").state "$downbeat" "${@:2}" >"$work/out" 2>&1; }
not() { ! "$@"; }
must() {
  if ! "${@:2}"; then
    cat "$work/out" "$work/report" >&2
    echo "failed: $1" >&2
    exit 1
  fi
  echo "ok: $1"
}
# Waits for at most $1 seconds until the report of the mission matches $2.
reports() { timeout "$1" sh -c 'until grep -qs "$1" "$2"; do sleep 0.05; done' - "$2" "$work/report"; }
# Replaces the list of the robot.
gives() { cp "$1" "$list.next" && mv "$list.next" "$list"; }
claims() { by "$1" preflight "$work/long.yaml" --fleet "$work/fleet.yaml" --patience 2s; }

if [ -n "${REVOKE:-}" ]; then
  read -r keys list anna bert <<<"$REVOKE"
  case ${SCHEME:-} in hmac) revoked=$keys/revoked.serials ;; *) revoked=$keys/revoked.pem ;; esac
  cp -p "$keys/operators/$anna".* "$work/" # `keys revoke` deletes the passes
  cp "$list" "$work/older"
  head -c 20 "$list" >"$work/damaged"
  must "an operator is admitted" by "$keys/operators/$bert.pem" fleet describe "$address"
  cp "$work/out" "$work/robot.yaml"
  id=$(sed -n 's/^id: //p' "$work/robot.yaml")
  echo "robots: {$id: {init: robot.yaml, address: '$address'}}" >"$work/fleet.yaml"
  echo "scenario: long
start_tolerance: 1s
cues: [{robots: $id, tracks: {shoulder: [{at: 100ms, to: 45}, {at: 60s, to: 0}]}}]" >"$work/long.yaml"

  gives "$work/damaged"
  sleep 2
  DOWNBEAT_IDENTITY=$work/$anna.pem DOWNBEAT_STATE=$work/state "$downbeat" run "$work/long.yaml" --fleet "$work/fleet.yaml" \
    >"$work/report" 2>&1 &
  must "a damaged list shuts nobody out" reports 20 "^starting"
  "$downbeat" keys revoke --operator "$anna" --keys "$keys" >/dev/null
  gives "$revoked"
  must "the commands of a revoked operator end within 2 s" reports 2 "forbidden"
  must "another operator can claim the robot" claims "$keys/operators/$bert.pem"
  must "the revoked operator cannot" not claims "$work/$anna.pem"
  gives "$work/older"
  sleep 2
  must "nor with an older list" not claims "$work/$anna.pem"
  must "the other operator still can" claims "$keys/operators/$bert.pem"
fi

if ! kill -0 "$robot" 2>/dev/null; then
  echo "$1 ended meanwhile" >&2
  exit 1
fi
