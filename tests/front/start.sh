#!/usr/bin/env bash
# How long `serve` takes to open a store of very many tiles, and its memory; the second start has the file in memory. It
# fails where the memory of a tile is more than the index takes.
#
#   start.sh [SIDE]    a pyramid over SIDE x SIDE tiles of one Gaussian; 866: a million
#
# CITYSPLAT_BIN and FRONT_CITY name the program and the one that writes the city, as for the tests here.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
side=${1:-866}
most_bytes=160 # of a tile: 136 of its index entry, 12 of its node, 24 to 128 of each node with children
base_mb=40     # of the server without tiles, with the viewer

"$city" "$work/many.tiles" 1 "$side" || exit 1
tiles=$("$bin" info "$work/many.tiles" | awk '$1 == "tiles_count" { print $2 }')
store=$work/many.tiles
for run in 1 2; do
    from=$(date +%s%3N)
    "$bin" serve "$store" --port 0 --device none >"$work/$run.out" 2>"$work/$run.log" &
    pids[run]=$!
    until grep -q http "$work/$run.out"; do
        kill -0 "${pids[run]}" || { cat "$work/$run.log"; exit 1; }
        sleep 0.005
    done
    ms=$(($(date +%s%3N) - from))
    mb=$(awk '/^VmHWM/ { printf "%.0f", $2 / 1024 }' "/proc/${pids[run]}/status")
    echo "$tiles tiles: ready after $ms ms, $(awk '{ print ($14 + $15) / 100 }' "/proc/${pids[run]}/stat") s of a processor, $mb MB"
    check 'memory by tiles' at_most "$mb" $((base_mb + tiles * most_bytes / 1000000))
    kill "${pids[run]}"
    wait "${pids[run]}"
done
exit $failed
