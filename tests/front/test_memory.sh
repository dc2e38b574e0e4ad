#!/usr/bin/env bash
# test_memory.sh [BODIES [SECONDS]]: what a server holds that is asked for BODIES (150) different bodies: tiles in all
# forms, tiles and tilesets of polygons, and with a device (DEVICE=auto) pictures, map tiles and heights. With SECONDS it goes
# on for so long. The server is in a control group of 512 MB where this machine lets one be made, else it is told
# --memory 256M; both processes are measured five times a second. With RATIO a server without that limit is then asked for the same, and no part of
# the times may be RATIO times longer.
#
# It fails if a process was killed, if an answer was 5xx, or if more was held than the budget and 80 MB.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
bodies=${1:-150} seconds=${2:-0} device=${DEVICE:-none} ratio=${RATIO:-0}
limit_mb=512 slack_mb=80
"$city" "$work/toy.tiles" "${GAUSSIANS:-12000}" || exit 1

trap 'front_end; [ -z "$group" ] || rmdir "$group"' EXIT
group= # of control groups, version 2 or 1
make_group() {
    local v1=/sys/fs/cgroup/memory/citysplat-$$ v2=/sys/fs/cgroup/citysplat-$$
    if [ -e /sys/fs/cgroup/cgroup.controllers ] && mkdir "$v2" 2>/dev/null; then
        group=$v2
        echo ${limit_mb}M 2>/dev/null >"$group/memory.max" && return 0
        rmdir "$group"
    elif [ -d /sys/fs/cgroup/memory ] && mkdir "$v1" 2>/dev/null; then
        group=$v1
        echo ${limit_mb}M 2>/dev/null >"$group/memory.limit_in_bytes" && return 0
        rmdir "$group"
    fi
    group=
    return 1
}
kills() { # that the kernel counts, or, where it does not, ends of the process that draws
    { cat "$group/memory.events" "$group/memory.oom_control" 2>/dev/null | awk '/^oom_kill / { print $2 }'
      curl -s "http://127.0.0.1:${ports[1]}/metrics" | awk '/^citysplat_drawing_crashes_total/ { print $2 } END { print 0 }'; } | head -1
}

start() { # OPTIONS: a server in the group, if there is one
    : >"$work/1.out"
    (
        [ -z "$group" ] || echo "$BASHPID" >"$group/cgroup.procs"
        exec "$bin" serve "$work/toy.tiles" --port 0 --device "$device" --client-tiles-s 0 --client-views-s 0 \
            --no-access-log --deadline-s 120 "$@"
    ) >"$work/1.out" 2>"$work/1.log" &
    pids[1]=$!
    for _ in $(seq 600); do
        ports[1]=$(sed -n 's|.*http://[^:]*:\([0-9]*\)/.*|\1|p' "$work/1.out")
        [ -z "${ports[1]}" ] || return 0
        kill -0 "${pids[1]}" 2>/dev/null || break
        sleep 0.05
    done
    cat "$work/1.log"
    exit 1
}
held_kb() { # of both processes
    local p
    for p in "${pids[1]}" $(cat "/proc/${pids[1]}/task/${pids[1]}/children" 2>/dev/null) \
        $(cat /proc/"${pids[1]}"/task/*/children 2>/dev/null | tr ' ' '\n' | sort -u); do
        echo "$p $(awk '/^RssAnon|^RssShmem/ { n += $2 } END { print n + 0 }' "/proc/$p/status" 2>/dev/null)"
    done | sort -u | awk '{ n += $2 } END { print n + 0 }'
}
watch_held() {
    local most=0 now
    while kill -0 "${pids[1]}" 2>/dev/null; do
        now=$(held_kb)
        [ "$now" -le "$most" ] || { most=$now; echo "$most" >"$work/most"; }
        sleep 0.2
    done
}

paths() { # COUNT SEED: different addresses
    local places
    places=$(curl -s "http://127.0.0.1:${ports[1]}/d/toy/seed.ndjson" | sed -n 's|.*/t/\([0-9/]*\)\..*|\1|p')
    awk -v n="$1" -v seed="$2" -v places="$places" -v rev="$rev" -v draws="$([ "$device" = none ] || echo 1)" '
        function pick(list,  a) { return a[1 + int(rand() * split(list, a, " "))] }
        function near(at, by) { return sprintf("%.7f", at + (rand() - 0.5) * by) }
        function clip(  x, y) {
            x = 13.4 + (rand() - 0.5) * 0.002; y = 52.5 + (rand() - 0.5) * 0.002
            return sprintf("clip=%.7f,%.7f,%.7f,%.7f,%.7f,%.7f", x - 0.004, y - 0.003, x + 0.004, y - 0.003, x, y + 0.004)
        }
        function tile(  ext, q) {
            ext = pick("glb spz drc sog ply plain.glb compressed.ply")
            q = "?" clip()
            if (ext ~ /^(glb|spz|drc)$/) q = q "&preset=" pick("spz preview balanced near-lossless") "&sh=" int(rand() * 2)
            return "/d/toy/r/" rev "/t/" pick(places) "." ext q
        }
        BEGIN {
            srand(seed)
            gsub("\n", " ", places)
            for (i = 0; i < n; i++) {
                what = rand()
                if (what < 0.08) print "/d/toy/r/" rev "/tileset.json?" clip()
                else if (!draws || what < 0.7) print tile()
                else if (what < 0.9)
                    print "/d/toy/static/" near(13.4, 0.004) "," near(52.5, 0.003) "," int(150 + rand() * 500) "@" int(rand() * 360) ",-" int(20 + rand() * 60) "/" pick("320x240 640x360 800x600 1280x720") "." pick("jpg png webp")
                else print "/d/toy/height?lon=" near(13.4, 0.003) "&lat=" near(52.5, 0.002)
            }
        }'
}
ask_all() { # TO: the paths on stdin over two connections, a line of status, seconds and bytes each
    awk -v url="http://127.0.0.1:${ports[1]}" -v to="$work/asked" '{ printf "url = \"%s%s\"\noutput = \"/dev/null\"\n", url, $1 > (to "." NR % 2) }'
    local i workers=()
    for i in 0 1; do
        [ -e "$work/asked.$i" ] || continue
        curl -s -L -g --max-time 60 -w '%{http_code} %{time_total} %{size_download}\n' -K "$work/asked.$i" >"$1.$i" & workers+=($!)
    done
    wait "${workers[@]}"
    cat "$1".? >"$1"
    rm -f "$work"/asked.? "$1".?
}
time_of() { sort -n -k2,2 "$1" | awk -v part="$2" '{ t[NR] = $2 } END { printf "%.1f\n", 1000 * t[int((NR - 1) * part) + 1] }'; }

make_group || echo "no control group can be made here: --memory $((limit_mb / 2))M, and memory is measured"
start $([ -n "$group" ] || echo --memory $((limit_mb / 2))M)
rev=$(revision)
budget_mb=$(sed -n 's/.*memory budget_mb=\([0-9]*\).*/\1/p' "$work/1.log")
check 'the budget is half of the limit' is "$budget_mb" $((limit_mb / 2))
sed -n 's/.*\(memory budget_mb.*\)/\1/p; s/.*\(--memory holds.*\)/\1/p' "$work/1.log"
watch_held &
watcher=$!
paths 40 1 >"$work/first"
ask_all "$work/warm" <"$work/first" # kernels are compiled
end=$((SECONDS + seconds)) round=2
paths "$bodies" $round >"$work/paths"
ask_all "$work/limited" <"$work/paths"
cp "$work/limited" "$work/limited.all"
while [ $SECONDS -lt $end ]; do
    round=$((round + 1))
    paths "$bodies" $round | ask_all "$work/more"
    cat "$work/more" >>"$work/limited.all"
done
most_mb=$(($(cat "$work/most") / 1024))
echo "asked $(wc -l <"$work/limited.all") bodies of $(awk '{ n += $3 } END { printf "%d", n / 1048576 }' "$work/limited.all") MB in all; held at most $most_mb MB of $budget_mb"
cut -d' ' -f1 "$work/limited.all" | sort | uniq -c | tr '\n' ';'
echo
[ -z "$group" ] || echo "the group's peak: $(($(cat "$group/memory.peak" "$group/memory.max_usage_in_bytes" 2>/dev/null | head -1) / 1048576)) MB with files, killed: $(kills)"
curl -s "http://127.0.0.1:${ports[1]}/metrics" | grep -E '^citysplat_(cache_(bytes|evictions_total)|memory_short_total|drawing_(starts|renewals|crashes)_total) '
check 'answers came' at_least "$(grep -c '^200' "$work/limited.all")" $((bodies / 2))
check 'none was 5xx' is "$(grep -c '^5' "$work/limited.all")" 0
check 'held at most the budget and 80 MB' at_most "$most_mb" $((budget_mb + slack_mb))
[ -z "$group" ] || check 'nothing was killed' is "$(kills)" 0
check 'nothing is degraded' is "$(curl -s "http://127.0.0.1:${ports[1]}/readyz" | grep -c ready)" 1
kill "${pids[1]}"
wait "${pids[1]}"
check 'it stops in order' is $? 0
wait "$watcher" 2>/dev/null
[ "$ratio" != 0 ] || exit $failed
[ -z "$group" ] || rmdir "$group"
group=
start --memory 8G
ask_all "$work/warm" <"$work/first"
ask_all "$work/unlimited" <"$work/paths"
for part in 0.5 0.9 0.99; do
    a=$(time_of "$work/limited" $part) b=$(time_of "$work/unlimited" $part)
    echo "ms of $part: $a limited, $b unlimited"
    [ "$ratio" = 0 ] || [ $part = 0.99 ] || check "times of $part" awk -v a="$a" -v b="$b" -v r="$ratio" 'BEGIN { exit !(a <= b * r + 1) }'
done
exit $failed
