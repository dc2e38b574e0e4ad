#!/usr/bin/env bash
# test_openapi.sh [REQUESTS [SEED]]: every operation that /api describes, with generated parameters and bodies; the answers
# are as described, and none is 500 (openapi.mjs).
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
need node nodejs
mkdir "$work/state"
serve 1 0 --client-tiles-s 0 --client-views-s 0 --no-access-log --state-dir "$work/state"
check 'answers are as described' node "$(dirname "$0")/openapi.mjs" "http://127.0.0.1:${ports[1]}" "${1:-1200}" "${2:-1}"
check 'the server lives' is "$(status "http://127.0.0.1:${ports[1]}/healthz")" 200
exit $failed
