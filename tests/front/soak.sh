#!/usr/bin/env bash
# soak.sh [SECONDS [RATE]]: mixed load for SECONDS (3600): tiles that are hot and cold, all with their bytes checked,
# clients that leave, that are slow, that send nonsense; a reload every ten seconds. Descriptors and memory must be
# flat after the first third, and nothing but what was asked for wrongly may fail. RATE: each of the two clients that
# check asks for at most so many tiles a second (0: as many as there are answers); the others are then calmer as well.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
seconds=${1:-3600} rate=${2:-0}
serve 1 0 --cache-mb 8 --client-tiles-s 0 --no-access-log
port=${ports[1]} pid=${pids[1]}
rev=$(revision)
url=http://127.0.0.1:$port
tiles >"$work/paths"
fetch_all "$work/first" <"$work/paths"
sums "$work/first" "$(wc -l <"$work/paths")" | paste -d' ' - "$work/paths" >"$work/want"
check 'every tile is there' is "$(find "$work/first" -size -2 -exec grep -l '^none$' {} + | wc -l)" 0
batch=40 # tiles over one connection
pause=$(awk -v n=$batch -v rate="$rate" 'BEGIN { print (rate > 0 ? n / rate : 0) }')
leave_s=$([ "$rate" = 0 ] && echo 0.05 || echo 0.5)
end=$((SECONDS + seconds))

checked() { # NAME: asks for tiles in an order of its own, and looks at every byte
    local to=$work/checked-$1 n=0 bad=0
    while [ $SECONDS -lt $end ]; do
        shuf -n $batch "$work/want" >"$to.list"
        cut -d' ' -f2 "$to.list" | fetch_all "$to"
        sums "$to" $batch | paste -d' ' - "$to.list" | awk '$1 != $2 { print "wrong:", $3, $1 }' >"$to.wrong"
        cat "$to.wrong" >&2
        n=$((n + batch)) bad=$((bad + $(wc -l <"$to.wrong")))
        echo "$n $bad" >"$work/checked.$1"
        sleep "$pause"
    done
}
leaves() { # asks for twenty tiles at once and hangs up
    while [ $SECONDS -lt $end ]; do
        shuf -n 20 "$work/paths" | awk '{ printf "GET %s HTTP/1.1\r\nHost: a\r\n\r\n", $1 }' | timeout 1 bash -c "cat >/dev/tcp/127.0.0.1/$port" 2>/dev/null
        sleep "$leave_s"
    done
}
slow() { while [ $SECONDS -lt $end ]; do curl -s -o /dev/null --limit-rate 60k --max-time 20 "$url$(shuf -n 1 "$work/paths")"; done; }
nonsense() {
    while [ $SECONDS -lt $end ]; do
        { head -c $((RANDOM % 400)) /dev/urandom; printf '\r\n\r\n'; } | timeout 1 bash -c "cat >/dev/tcp/127.0.0.1/$port" 2>/dev/null
        curl -s --max-time 5 "$url/d/toy/t/99/1/1.glb" "$url/%00" "$url/collections?bbox=1" >/dev/null
        sleep 0.2
    done
}
reloads() { while [ $SECONDS -lt $end ]; do sleep 10; kill -HUP "$pid"; done; }
counted() { curl -s "$url/metrics" | awk -v name="citysplat_$1" '$1 == name || index($1, name "{") == 1 { n += $2 } END { print n + 0 }'; }
state() { printf '%s %s\n' "$(find "/proc/$pid/fd" -mindepth 1 | wc -l)" "$(awk '/^VmRSS/ { print $2 }' "/proc/$pid/status")"; }

workers=()
for job in 'checked 1' 'checked 2' leaves slow nonsense reloads; do $job & workers+=($!); done
sleep $((seconds / 3))
read -r fds_then rss_then < <(state)
while [ $SECONDS -lt $end ]; do sleep 1; done
for w in "${workers[@]}"; do wait "$w"; done
sleep 1
read -r fds rss < <(state)
read -r asked_for bad < <(cat "$work"/checked.* | awk '{ n += $1; bad += $2 } END { print n, bad }')
echo "$seconds s: $asked_for tiles checked, $bad wrong; descriptors $fds_then -> $fds, memory $rss_then -> $rss kB"
echo "requests $(counted http_requests_total), clients that left $(counted client_aborts_total), cut $(counted reaped_connections_total), malformed $(counted http_rejected_total), reloads that failed $(counted reload_failed_total)"
check 'tiles were asked for' at_least "$asked_for" "$seconds"
check 'every byte is right' is "$bad" 0
check 'descriptors are flat' at_most "$fds" "$((fds_then + 8))"
check 'memory is flat' at_most "$rss" "$((rss_then * 115 / 100 + 4000))"
kill "$pid"
wait "$pid"
check 'it stops in order' is $? 0
check 'and said nothing of an error' is "$(grep -c ' error ' "$work/1.log")" 0
exit $failed
