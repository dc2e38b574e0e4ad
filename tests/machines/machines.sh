# shellcheck shell=bash
# Source this: a small city in cells, trained by many processes, and what tests of that share.
#
#   CITYSPLAT_BIN   the program
#   KEEP            a folder that the logs are copied to
#
# SPDX-License-Identifier: Apache-2.0
bin=$(realpath "${CITYSPLAT_BIN:?set it to the citysplat program}")
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-machines-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
# shellcheck source=tests/check.sh
. "$root/tests/check.sh"
# Two levels of tens of steps; a state is saved often, so that a killed job has something to go on from.
short=(--level-count 2 --iterations 40 --budget '300,400' --coarse-iterations-min 20 --coarse-budget 1000 --checkpoint-interval 8)

skip() { echo "skipped: $*"; exit 77; }

need() { # PROGRAM PACKAGE
    command -v "$1" >/dev/null || [ -x "/usr/sbin/$1" ] || skip "no $1: Debian's package $2 has it"
}

city_in_cells() { # PHOTOS EXTENT_M EDGE_M: $work/scene with a plan; its cells in cells[]
    "$bin" synth -o "$work/city" --photos "$1" --width-px 64 --height-px 48 --extent-m "$2" --points $(($1 * 25)) >"$work/log" 2>&1 &&
        "$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/scene" >>"$work/log" 2>&1 &&
        "$bin" plan "$work/scene" --edge-m "$3" --images-few 4 --images-least 3 >>"$work/log" 2>&1 &&
        "$bin" train "$work/scene" "${short[@]}" --list >"$work/list" 2>>"$work/log" || { cat "$work/log"; exit 1; }
    mapfile -t cells < <(cut -f1 "$work/list")
}

revision() { # NAME [OPTIONS]: of the tiles of the scene, whose name counts; they lie in $work/NAME.tiles
    local out=$work/$1.tiles
    [ -e "$out" ] || "$bin" tile "$work/scene" -o "$out" --name city "${@:2}" >"$work/log.tile" 2>&1 || return 1
    "$bin" info "$out" | sed -n 's/^revision *//p'
}

same_levels() { # DIR-A DIR-B: the levels of all cells and of the coarse model, byte by byte
    local f n=0
    for f in "$1"/cells/*/level?.ckpt; do
        cmp "$f" "$2/${f#"$1"/}" || return 1
        n=$((n + 1))
    done
    [ $n = $((2 * ${#cells[@]} + 1)) ] || { echo "$n files of levels"; return 1; }
}
