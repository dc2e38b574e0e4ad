# shellcheck shell=bash
# Source this: named stages, each with a log, its times (of the clock, and of all cores) and a line in the table at the
# end.
#
# SPDX-License-Identifier: Apache-2.0
stage_names=()
declare -A stage_what stage_command stage_loud stage_result stage_seconds stage_cpu
logs=build/ci

stage() { # NAME WHAT COMMAND...
    stage_names+=("$1")
    stage_what[$1]=$2
    stage_command[$1]=$(printf '%q ' "${@:3}")
}

loud() { # NAME: its output is also shown while it runs
    stage_loud[$1]=1
}

build_preset() { # PRESET
    command -v cmake >/dev/null || { echo "no cmake: ./bootstrap packages installs what is needed"; return 1; }
    cmake --preset "$1" >/dev/null && cmake --build --preset "$1"
}

# Runs ctest by COMMAND. What fails in it is run once more, alone: tests of clocks and browsers may miss their time beside
# others on a machine that is busy with something else. A test that fails twice has failed, and the log names the others.
twice_at_most() { # PRESET COMMAND...
    local failed=build/$1/Testing/Temporary/LastTestsFailed.log preset=$1
    shift
    rm -f "$failed"
    "$@" && return 0
    [ -s "$failed" ] || return 1 # no test had its turn
    printf '\n== failed, and run once more, alone: %s\n' "$(cut -d: -f2 "$failed" | paste -sd ' ')"
    ctest --preset "$preset" -j 1 --rerun-failed
}

list_stages() {
    local name
    for name in "${stage_names[@]}"; do printf '%-11s %s\n' "$name" "${stage_what[$name]}"; done
}

run_one() { # NAME
    local name=$1 log=$logs/$1.log code TIMEFORMAT='%R %U %S'
    printf '== %-11s %s\n' "$name" "${stage_what[$name]}"
    {
        time if [ "${stage_loud[$name]:-}" ]; then
            (eval "${stage_command[$name]}") 2>&1 </dev/null | tee "$log" >&3
            code=${PIPESTATUS[0]}
        else
            (eval "${stage_command[$name]}") >"$log" 2>&1 </dev/null
            code=$?
        fi
    } 3>&1 2>"$logs/time"
    read -r stage_seconds[$name] stage_cpu[$name] < <(tail -1 "$logs/time" | awk '{ printf "%.1f %.1f\n", $1, $2 + $3 }')
    case $code in
        0) stage_result[$name]=ok ;;
        77) stage_result[$name]="skipped: $(tail -1 "$log")" ;;
        *)
            stage_result[$name]=FAILED
            [ "${stage_loud[$name]:-}" ] || tail -80 "$log" | sed 's/^/  | /' ;;
    esac
    [ "${stage_result[$name]}" != FAILED ]
}

run_stages() { # NAME...; exits with 1 when one failed
    local name failed=0 total=$EPOCHREALTIME
    for name in "$@"; do
        [ -n "${stage_what[$name]:-}" ] || { echo "no stage $name; there are: ${stage_names[*]}" >&2; exit 2; }
    done
    mkdir -p "$logs"
    for name in "$@"; do run_one "$name" || failed=$((failed + 1)); done
    printf '\n%-11s %9s %9s  %s\n' stage seconds 'CPU s' result
    for name in "$@"; do
        printf '%-11s %9s %9s  %s\n' "$name" "${stage_seconds[$name]}" "${stage_cpu[$name]}" "${stage_result[$name]}"
    done
    printf '%-11s %9s %9s  %s\n' total "$(awk -v a="$total" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }')" \
        "$(printf '%s\n' "${stage_cpu[@]}" | awk '{ s += $1 } END { printf "%.1f", s }')" \
        "$([ $failed = 0 ] && echo ok || echo "$failed of $# failed")"
    for name in "$@"; do # last, what ctest said of the whole suite
        [ "$name" != tests ] || { echo; sed -n '/tests passed, /,$p' "$logs/tests.log"; }
        [ "${stage_result[$name]}" = FAILED ] || grep -h '^== failed, and run once more' "$logs/$name.log"
    done
    [ $failed = 0 ] || exit 1
}
