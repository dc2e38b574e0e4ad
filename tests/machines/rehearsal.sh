#!/usr/bin/env bash
# rehearsal.sh [SEED]: the jobs of a city of about forty cells on one machine, with tiny budgets. Half of all processes,
# drawn at random, are killed with SIGKILL at random moments, and so is the runner itself. The same command follows with
# --resume until all is complete. No complete cell is trained again, and the result is that of one undisturbed process.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/machines/machines.sh
. "$(dirname "$0")/machines.sh"
need pgrep procps
trap 'machines_end' EXIT
machines_end() { [ -z "${runner:-}" ] || kill -9 "$runner" 2>/dev/null; wait; rm -rf "$work"; }
RANDOM=${1:-1}
readonly ROUNDS=20 JOBS=${JOBS:-4}
city_in_cells 240 300 45
n=${#cells[@]}
check 'the city has about forty cells' [ "$n" -ge 36 ]

stamp() { # FILE: of each complete cell, the identity of its done-file
    (cd "$work/killed/cells" && stat -c '%n %i %.9Y' -- */done.json 2>/dev/null | sort) >"$1"
}
cell_of() { tr '\0' '\n' <"/proc/$1/cmdline" 2>/dev/null | sed -n '/^--cell$/{n;p;}'; }
end_one() { # PID FILE DELAY_S: waits until the cell has FILE, and a moment longer
    local id dir
    id=$(cell_of "$1")
    until [ "$id" ] || ! [ -d "/proc/$1" ]; do sleep 0.02; id=$(cell_of "$1"); done # it has not become a cell's process yet
    dir=$work/killed/cells/$id
    [ ! -e "$dir/done.json" ] || return # it only says so
    until [ -e "$dir/$2" ] || ! [ -d "/proc/$1" ]; do sleep 0.02; done
    sleep "$3"
    # Only a process that is this cell's now.
    [ "$id" ] && [ "$(cell_of "$1")" = "$id" ] && kill -9 "$1" && echo "$id" >>"$work/deaths"
}
# Half of the children of RUNNER die at the moment that is drawn for each; in the first round RUNNER dies as well.
readonly MOMENTS=(. lock metrics.jsonl resume.ckpt level1.ckpt level2.ckpt)
hunt() { # RUNNER ROUND
    local pid met=' ' ends=()
    while kill -0 "$1" 2>/dev/null; do
        for pid in $(pgrep -P "$1"); do
            case $met in *" $pid "*) continue ;; esac
            met+="$pid "
            echo "$pid" >>"$work/starts"
            local moment=${MOMENTS[RANDOM % ${#MOMENTS[@]}]} delay=0.$((RANDOM % 5))
            [ $((RANDOM % 2)) = 0 ] || { end_one "$pid" "$moment" "$delay" & ends+=($!); }
        done
        [ "$2" != 1 ] || [ "$(wc -l <"$work/starts")" -lt $((n / 4)) ] || kill -9 "$1"
        sleep 0.05
    done
    [ ${#ends[@]} = 0 ] || wait "${ends[@]}"
}

check 'one process, undisturbed' "$bin" train "$work/scene" "${short[@]}" -o "$work/whole"
want=$(revision whole --trained "$work/whole")
: >"$work/starts"
: >"$work/deaths"
: >"$work/complete"
again=0 code=1
for round in $(seq $ROUNDS); do
    "$bin" train "$work/scene" "${short[@]}" -o "$work/killed" --jobs "$JOBS" --threads "$JOBS" --resume >"$work/log" 2>&1 &
    runner=$!
    hunt $runner "$round" 2>/dev/null
    wait $runner 2>/dev/null
    code=$?
    runner=
    # A complete cell keeps its done-file.
    stamp "$work/now"
    again=$((again + $(comm -23 "$work/complete" "$work/now" | wc -l)))
    cp "$work/now" "$work/complete"
    [ $code != 0 ] || break
done
deaths=$(wc -l <"$work/deaths")
echo "rehearsal: $n cells, $(wc -l <"$work/starts") processes in $round rounds, $deaths of them and one runner killed;" \
    "$(sort -u "$work/deaths" | wc -l) cells were hit, $(sort "$work/deaths" | uniq -d | wc -l) more than once"
check 'it ends' [ $code = 0 ]
check 'a third of the cells or more was hit' [ "$(sort -u "$work/deaths" | wc -l)" -ge $((n / 3)) ]
check 'every cell is complete' [ "$(wc -l <"$work/complete")" = $((n + 1)) ] # and the coarse model
check 'no complete cell was trained again' [ $again = 0 ]
check 'every level has the bytes of the undisturbed run' same_levels "$work/whole" "$work/killed"
check 'and the tiles its revision' [ "${want:-none}" = "$(revision killed --trained "$work/killed")" ]
check 'nothing is left unfinished' [ -z "$(find "$work/killed" -name "resume.ckpt*" -o -name "*.part-*")" ]
[ $failed = 0 ] || { echo "$failed checks failed"; exit 1; }
