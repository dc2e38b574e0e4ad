#!/usr/bin/env bash
# soak.sh [SECONDS]: mixed load for SECONDS (3600): tiles that are hot and cold, all with their bytes checked, documents,
# clients that leave, that are slow, that send nonsense; a reload every ten seconds. Descriptors and memory must be
# flat after the first third, and nothing but what was asked for wrongly may fail.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
seconds=${1:-3600}
serve 1 0 --cache-mb 8 --client-tiles-s 0 --no-access-log
port=${ports[1]} pid=${pids[1]}
rev=$(revision)
url=http://127.0.0.1:$port
tiles >"$work/paths"
while read -r path; do printf '%s %s\n' "$(curl -s "$url$path" | sha256sum | cut -d' ' -f1)" "$path"; done <"$work/paths" >"$work/want"
end=$((SECONDS + seconds))

checked() { # asks for tiles in an order of its own, and looks at every byte
    local sum path got n=0 bad=0
    while [ $SECONDS -lt $end ]; do
        while read -r sum path; do
            [ $SECONDS -lt $end ] || break
            got=$(curl -s --compressed --max-time 20 "$url$path" | sha256sum | cut -d' ' -f1)
            n=$((n + 1))
            [ "$got" = "$sum" ] || { bad=$((bad + 1)); echo "wrong: $path" >&2; }
        done < <(shuf "$work/want")
    done
    echo "$n $bad" >"$work/checked.$1"
}
leaves() { while [ $SECONDS -lt $end ]; do curl -s -o /dev/null --max-time 0.01 "$url$(shuf -n 1 "$work/paths")"; sleep 0.05; done; }
slow() { while [ $SECONDS -lt $end ]; do curl -s -o /dev/null --limit-rate 60k --max-time 20 "$url$(shuf -n 1 "$work/paths")"; done; }
nonsense() {
    while [ $SECONDS -lt $end ]; do
        { head -c $((RANDOM % 400)) /dev/urandom; printf '\r\n\r\n'; } | timeout 1 bash -c "cat >/dev/tcp/127.0.0.1/$port" 2>/dev/null
        curl -s --max-time 5 "$url/d/toy/t/99/1/1.glb" "$url/%00" "$url/collections?bbox=1" >/dev/null
        sleep 0.2
    done
}
reloads() { while [ $SECONDS -lt $end ]; do sleep 10; kill -HUP "$pid"; done; }
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
check 'tiles were asked for' at_least "$asked_for" "$seconds"
check 'every byte is right' is "$bad" 0
check 'descriptors are flat' at_most "$fds" "$((fds_then + 8))"
check 'memory is flat' at_most "$rss" "$((rss_then * 115 / 100 + 4000))"
kill "$pid"
wait "$pid"
check 'it stops in order' is $? 0
check 'and said nothing of an error' is "$(grep -c ' error ' "$work/1.log")" 0
exit $failed
