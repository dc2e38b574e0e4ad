#!/bin/sh
# Several processes share one cache of compiled kernels: all begin at once with an empty one, one is killed while
# it compiles, one finds a cache cut short; every picture is the same bytes, and a warm start compiles nothing.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-cache-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
. "$(dirname "$0")/../check.sh"

# Two Gaussians of antimatter15's .splat: mean and size as 6 floats, RGBA, rotation.
record() { printf '%b' "$1\0000\0000\0000\0000\0000\0000\0200\0100\0315\0314\0314\0075\0315\0314\0314\0075\0315\0314\0314\0075\0377\0200\0100\0377\0377\0200\0200\0200"; }
{ record '\0000\0000\0000\0000'; record '\0315\0314\0314\0076'; } >"$work/two.splat"
cat >"$work/camera.json" <<'JSON'
{"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24,
 "world_to_camera": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}
JSON
draw() { # CACHE NAME
    mkdir -p "$1" && env POCL_CACHE_DIR="$1" "$bin" render "$work/two.splat" --camera "$work/camera.json" \
        --device cpu -o "$work/$2.npy" >"$work/log.$2" 2>&1
}
compiled() { find "$1" -name '*.so' | wc -l; }

check 'alone' draw "$work/alone" alone
check "the picture is not black" [ "$(od -An -tf4 -j128 -v "$work/alone.npy" | tr -s " " "\n" | sort -u | wc -l)" -gt 20 ]
n=$(compiled "$work/alone")
check 'compiled kernels are kept' [ "$n" -gt 0 ]
find "$work/alone" -name '*.so' -exec md5sum {} + | sort >"$work/before"
check 'a warm start' draw "$work/alone" warm
find "$work/alone" -name '*.so' -exec md5sum {} + | sort >"$work/after"
check 'compiles nothing' cmp "$work/before" "$work/after"
check 'draws the same' cmp "$work/alone.npy" "$work/warm.npy"
kept=$(ls "$work"/alone/citysplat/*.program)
check 'a compiled program is kept' [ -s "$kept" ]
check 'who waits for the compiler is told' grep -q 'compiling kernels' "$work/log.alone"
check 'and who does not wait is not' [ "$(grep -c 'compiling kernels' "$work/log.warm")" = 0 ]

# Its kernels are in the program's file as well: without those of PoCL nothing is compiled. Damaged, it is made anew.
mkdir "$work/moved" && cp -a "$work/alone/citysplat" "$work/moved/"
check 'a start from the kept program alone' draw "$work/moved" moved
check 'draws the same' cmp "$work/alone.npy" "$work/moved.npy"
check 'and compiles nothing' cmp "$kept" "$work"/moved/citysplat/*.program
printf 'damaged' | dd of="$work/moved/citysplat/${kept##*/}" bs=1 seek=1000 conv=notrunc 2>/dev/null
check 'with a damaged program' draw "$work/moved" damaged
check 'draws the same' cmp "$work/alone.npy" "$work/damaged.npy"
check 'and the program is whole again' cmp -n 2000 "$kept" "$work"/moved/citysplat/*.program

pids=
for i in 1 2 3; do
    draw "$work/shared" "shared$i" &
    pids="$pids $!"
done
for pid in $pids; do check 'three at once' wait "$pid"; done
for i in 1 2 3; do check 'draw the same' cmp "$work/alone.npy" "$work/shared$i.npy"; done
check 'nothing half done is left' [ "$(compiled "$work/shared")" = "$n" ]

# Killed at four moments of the way, then another process goes on with what is there.
for after in 0.2 0.5 1 2; do
    timeout -s KILL "$after" env POCL_CACHE_DIR="$work/killed" "$bin" render "$work/two.splat" --camera "$work/camera.json" \
        --device cpu -o "$work/killed.npy" -q >"$work/log.killed" 2>&1
done
check 'after a kill' draw "$work/killed" next
check 'the picture is the same' cmp "$work/alone.npy" "$work/next.npy"

exit $((failed > 0))
