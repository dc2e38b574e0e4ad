#!/usr/bin/env bash
# cores.sh: what more cores give. Every kernel of a training iteration (citysplat-lab kernels), three times:
#
#   one     a process with one thread on core 0
#   two     a process with two threads on cores 0 and 1
#   beside  as `one`, while a second such process works on core 1
#
#   lab/cores.sh [--runs N] [--quick]
#
# A table on stdout, a case after the other, longest kernel first, with these columns:
#
#   one, two   ms, median
#   gain       one / two: 2 is all that a second core can give
#   beside     how much longer a process takes beside another one on another core: 1 means that they share nothing
#              that is short, so that a third core would help as the second does
#   room       cores that the bandwidth of memory has room for: that of all cores (triad) over what the kernel
#              moved on one core. The least bytes that it must move count, so this is an upper limit
#
# It needs two cores with nothing else to do. CITYSPLAT_BUILD: where citysplat-lab is, build/release by default.
# Exit 0: it ran; 1: not; 2: arguments.
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1

readonly BENCH=${CITYSPLAT_BUILD:-build/release}/citysplat-lab
RUNS=20 QUICK=
die() { printf 'cores: error: %s\n' "$*" >&2; exit "${2:-2}"; }
while [ $# -gt 0 ]; do
    case $1 in
        --runs) RUNS=${2:?--runs N}; shift ;;
        --quick) QUICK=--quick ;;
        -h | --help) sed -n '2,25s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) die "unknown argument: $1 (--help)" ;;
    esac
    shift
done
[ -x "$BENCH" ] || die "$BENCH is missing: ./bootstrap build, or CITYSPLAT_BUILD=FOLDER" 1
[ "$(nproc)" -ge 2 ] || die "this machine has one core" 1

scratch=$(mktemp -d) || exit 1
other=
trap '[ -z "$other" ] || kill "$other" 2>/dev/null || true; rm -rf "$scratch"' EXIT

# on CORES THREADS: the kernels' lines.
on() {
    POCL_MAX_PTHREAD_COUNT=$2 POCL_CPU_MAX_CU_COUNT=$2 taskset -c "$1" "$BENCH" kernels --runs "$RUNS" $QUICK
}
printf '== %s\n' "one core" >&2
on 0 1 >"$scratch/one" 2>"$scratch/log" || die "$(tail -n 3 "$scratch/log")" 1
printf '== %s\n' "two cores" >&2
on 0,1 2 >"$scratch/two" 2>"$scratch/log" || die "$(tail -n 3 "$scratch/log")" 1
printf '== %s\n' "a core beside another" >&2
while :; do on 1 1 >/dev/null 2>&1 || exit; done &
other=$!
on 0 1 >"$scratch/beside" 2>"$scratch/log" || die "$(tail -n 3 "$scratch/log")" 1
pkill -P "$other" 2>/dev/null || true
kill "$other" 2>/dev/null || true
wait "$other" 2>/dev/null || true
other=

awk '
function field(name,   at, rest) {
    at = index($0, "\"" name "\":")
    if (!at) return ""
    rest = substr($0, at + length(name) + 3)
    sub(/^"/, "", rest)
    sub(/(",|,"|[}]).*/, "", rest)
    return rest
}
FNR == 1 { file++ }
/"case":"triad"/ && file == 2 { triad = field("value") }
/"took_ms"/ {
    key = field("case")
    took[file, key] = field("value")
    bytes[key] = field("bytes")
    if (file == 1) order[++n] = key
}
END {
    printf "%-64s %9s %9s %6s %7s %6s\n", "kernel", "one", "two", "gain", "beside", "room"
    for (i = 1; i <= n; i++) {
        k = order[i]
        if (!took[2, k] || !took[3, k]) continue
        room = bytes[k] > 0 ? triad * 1e9 / (bytes[k] / (took[1, k] * 1e-3)) : 0
        printf "%-64s %9.3f %9.3f %6.2f %7.2f %6.1f\n", k, took[1, k], took[2, k], took[1, k] / took[2, k], took[3, k] / took[1, k], room
    }
}' "$scratch/one" "$scratch/two" "$scratch/beside"
