#!/bin/sh
# A driver whose compiler ends the process that it runs in: with another method it compiles, and says so; without one
# there is an error that names driver, version and what to do; and what was compiled once needs no compiler again.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
driver=${DYING_DRIVER:?set it to the library of tests/core/dying_driver.c}
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-compiler-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
. "$(dirname "$0")/../check.sh"
unset POCL_WORK_GROUP_METHOD

device() { # NAME PROGRAM... : its output in log.NAME
    name=$1
    shift
    env POCL_CACHE_DIR="$work/$name" "$@" info --device cpu >"$work/log.$name" 2>&1
}
dies() { # CODE COMMAND...
    want=$1
    shift
    "$@"
    [ $? = "$want" ]
}
check 'a folder for kernels' mkdir "$work/usual" "$work/none" "$work/here" "$work/alone"

check 'the usual method dies, and the program does not' device usual env LD_PRELOAD="$driver" DYING=usual "$bin"
check 'it says what happened' grep -q 'ended while it compiled .*signal 6, Aborted: LLVM ERROR: a stand-in did not reach a fixpoint' "$work/log.usual"
check 'and with what it works' grep -q 'POCL_WORK_GROUP_METHOD=cbs' "$work/log.usual"
check 'once, not for each program' [ "$(grep -c 'ended while it compiled' "$work/log.usual")" = 1 ]
check 'the device is told' grep -q '^work_groups  *cbs' "$work/log.usual"
check 'compiled' [ "$(grep -c ' compiled ' "$work/log.usual")" -ge 5 ]
check 'what is kept needs no compiler' device usual env LD_PRELOAD="$driver" DYING=all "$bin"
check 'kept' [ "$(grep -c ' kept ' "$work/log.usual")" -ge 5 ]
check 'and nothing was compiled' [ "$(grep -c ' compiled ' "$work/log.usual")" = 0 ]

check 'every method dies: an error' dies 1 device none env LD_PRELOAD="$driver" DYING=all "$bin"
check 'with driver and version' grep -q 'error: .*version .* ended by itself in every way that it has .*LLVM ERROR: a stand-in' "$work/log.none"
check 'and what to do' grep -q 'update the package of the driver (pocl-opencl-icd' "$work/log.none"

# Not installed whole: compiled by the program itself, whose end is told.
cp "$bin" "$work/alone/citysplat"
by_itself() { # a driver of today may die of it in earnest, with a word
    device here "$work/alone/citysplat" || grep -q 'the compiler of the OpenCL driver .* ends the program while it compiles' "$work/log.here"
}
check 'without the other program it compiles by itself' by_itself
rm -rf "$work/here" && mkdir "$work/here"
check 'and dies of the driver' dies 134 device here env LD_PRELOAD="$driver" DYING=all "$work/alone/citysplat"
check 'with a word' grep -q 'the compiler of the OpenCL driver .* ends the program while it compiles' "$work/log.here"

exit $((failed > 0))
