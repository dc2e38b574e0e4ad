# shellcheck shell=sh
# Source this: a small city, ingested, trained for a moment and tiled, in a folder that is the current one from then on:
# city/, scene/ and t.tiles. What a command says lies in log.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?the program under test}
dir=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-trained-XXXXXX") || exit 1
trap 'rm -rf "$dir"' EXIT
cd "$dir" || exit 1
fail() { echo "FAILED: $1"; cat log; exit 1; }
lab() { "$bin-lab" "$@" >log 2>&1 || fail "lab $*"; }
run() { "$bin" "$@" >log 2>&1 || fail "$*"; }
run synth --extent-m 60 --photos 24 --width-px 96 --height-px 72 --points 3000 -o city -q
lab map-views city --count 8 -q
run ingest city/images city/sparse -o scene -q
run train scene --level-count 2 --iterations 120 --budget 3000,4000 -q
run tile scene --name t -o t.tiles -q
