# shellcheck shell=bash
# Source this: named stages, each with a log, its times (of the clock, and of all cores) and a line in the table at the
# end. Stages run one after the other; one may run beside another, with the time that it leaves over.
#
# SPDX-License-Identifier: Apache-2.0
stage_names=()
declare -A stage_what stage_command stage_loud stage_beside stage_pid
logs=build/ci

stage() { # NAME WHAT COMMAND...
    stage_names+=("$1")
    stage_what[$1]=$2
    stage_command[$1]=$(printf '%q ' "${@:3}")
}

loud() { # NAME: its output is also shown while it runs
    stage_loud[$1]=1
}

beside() { # NAME OTHER: NAME takes what OTHER leaves over of the processor, and is stopped when OTHER ends; by itself if OTHER is not run
    stage_beside[$2]=$1
}

build_preset() { # PRESET [TARGET]
    command -v cmake >/dev/null || { echo "no cmake: ./bootstrap packages installs what is needed"; return 1; }
    cmake --preset "$1" -DCITYSPLAT_WERROR=ON >/dev/null && cmake --build --preset "$1" --target "${2:-all}"
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

run_one() { # NAME: what came of it lies in NAME.result, because it may run in a process of its own
    local name=$1 log=$logs/$1.log code result TIMEFORMAT='%R %U %S'
    printf '== %-11s %s\n' "$name" "${stage_what[$name]}"
    {
        time if [ "${stage_loud[$name]:-}" ]; then
            (eval "${stage_command[$name]}") 2>&1 </dev/null | tee "$log" >&3
            code=${PIPESTATUS[0]}
        else
            (eval "${stage_command[$name]}") >"$log" 2>&1 </dev/null
            code=$?
        fi
    } 3>&1 2>"$logs/$name.time"
    case $code in
        0) result=ok ;;
        77) result="skipped: $(tail -1 "$log")" ;;
        143) result='ok, stopped' ;; # by run_stages
        *)
            result=FAILED
            [ "${stage_loud[$name]:-}" ] || tail -80 "$log" | sed 's/^/  | /' ;;
    esac
    printf '%s %s\n' "$(tail -1 "$logs/$name.time" | awk '{ printf "%.1f %.1f", $1, $2 + $3 }')" "$result" >"$logs/$name.result"
}

stop_beside() { # PID: its whole group; what it builds is not touched any more when this returns
    kill -TERM -- "-$1" 2>/dev/null
    wait "$1"
    while kill -0 -- "-$1" 2>/dev/null; do sleep 0.1; done
}

run_stages() { # NAME...; exits with 1 when one failed
    local name other failed=0 total=$EPOCHREALTIME seconds cpu result
    for name in "$@"; do
        [ -n "${stage_what[$name]:-}" ] || { echo "no stage $name; there are: ${stage_names[*]}" >&2; exit 2; }
    done
    mkdir -p "$logs"
    for name in "$@"; do
        other=${stage_beside[$name]:-}
        case " $* " in
            *" ${other:-none} "*)
                set -m # a group of its own
                (renice -n 19 $BASHPID >/dev/null; trap : TERM; run_one "$other") &
                stage_pid[$other]=$!
                set +m ;;
        esac
        [ "${stage_pid[$name]:-}" ] || run_one "$name"
        [ -z "${stage_pid[${other:-none}]:-}" ] || stop_beside "${stage_pid[$other]}"
    done
    printf '\n%-11s %9s %9s  %s\n' stage seconds 'CPU s' result
    for name in "$@"; do
        read -r seconds cpu result <"$logs/$name.result"
        [ "$result" != FAILED ] || failed=$((failed + 1))
        printf '%-11s %9s %9s  %s\n' "$name" "$seconds" "$cpu" "$result${stage_pid[$name]:+ (beside another)}"
    done
    printf '%-11s %9s %9s  %s\n' total "$(awk -v a="$total" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }')" \
        "$(for name in "$@"; do cat "$logs/$name.result"; done | awk '{ s += $2 } END { printf "%.1f", s }')" \
        "$([ $failed = 0 ] && echo ok || echo "$failed of $# failed")"
    for name in "$@"; do # last, what ctest said of the whole suite
        [ "$name" != tests ] || { echo; sed -n '/tests passed, /,$p' "$logs/tests.log"; }
        grep -q FAILED "$logs/$name.result" || grep -h '^== failed, and run once more' "$logs/$name.log"
    done
    [ $failed = 0 ] || exit 1
}
