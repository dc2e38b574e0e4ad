#!/usr/bin/env bash
# Measures a server whose store is far away: the time of a start, cold and warm, of cold tiles, their range requests, and
# memory. nginx has the store; delay.mjs is the network.
#
#   remote.sh [SIDE [GAUSSIANS [ROUND-TRIP-MS [TILES]]]]    a city of SIDE x SIDE tiles of so many Gaussians each
#
# CITYSPLAT_BIN and FRONT_CITY name the program and the one that writes the city, as for the tests here.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
side=${1:-40} gaussians=${2:-2000} round_ms=${3:-30} tiles=${4:-300}
export XDG_CACHE_HOME=$work/cache

need nginx nginx-light
far_nginx
"$city" "$work/far/far.tiles" "$gaussians" "$side" || exit 1
node "$root/tests/front/delay.mjs" "$work/delay.port" "${far##*:}" "$round_ms" &
pids[9]=$!
for _ in $(seq 100); do [ -s "$work/delay.port" ] && break; sleep 0.05; done
url=http://127.0.0.1:$(cat "$work/delay.port")/far.tiles
await "$url"

now_ms() { date +%s%3N; }
requests() { grep -c far.tiles "$work/far/log"; }
memory_mb() { awk '/^(RssAnon|VmHWM)/ { printf "%s %.0f MB ", $1, $2 / 1024 }' "/proc/${pids[$1]}/status"; }
cpu_s() { awk '{ print ($14 + $15) / 100 }' "/proc/${pids[$1]}/stat"; }

begin() { # NUMBER WHAT: starts a server; how long until it answers, in how many requests, and what it took
    local from before
    before=$(requests)
    from=$(now_ms)
    "$bin" serve "$url" --port 0 --device none --cache-mb 16 >"$work/$1.out" 2>"$work/$1.log" &
    pids[$1]=$!
    until grep -q http "$work/$1.out" 2>/dev/null; do
        kill -0 "${pids[$1]}" || { cat "$work/$1.log"; exit 1; }
        sleep 0.005
    done
    ports[$1]=$(sed -n 's|.*http://[^:]*:\([0-9]*\)/.*|\1|p' "$work/$1.out")
    echo "$2 start: $(($(now_ms) - from)) ms, $(($(requests) - before)) requests, $(cpu_s "$1") s of a processor; $(memory_mb "$1")"
}

printf 'store: %s tiles of %s Gaussians, %.1f MB; round trip %s ms\n' "$("$bin" info "$work/far/far.tiles" | awk '$1 == "tiles_count" { print $2 }')" "$gaussians" \
    "$(stat -c %s "$work/far/far.tiles" | awk '{ print $1 / 1e6 }')" "$round_ms"
begin 1 cold
here=http://127.0.0.1:${ports[1]}
curl -s "$here/d/toy/seed.ndjson?f=spz" | sed -n "s|.*\"url\":\"\([^\"]*\)\".*|\1|p" | sed 's|^\(\.\./\)*|/|' >"$work/all"
grep -q '^/d/' "$work/all" || sed -i "s|^/*|/d/toy/|" "$work/all"
shuf --random-source=<(yes) -n "$tiles" "$work/all" >"$work/some"
before=$(requests)
while read -r path; do
    curl -s -o /dev/null -w '%{http_code} %{time_total}\n' "$here$path"
done <"$work/some" >"$work/times"
awk '$1 != 200 { bad++ } END { if (bad) print bad, "answers were not 200" }' "$work/times"
awk '{ print $2 * 1000 }' "$work/times" | sort -n | awk -v n="$(($(requests) - before))" '{ t[NR] = $1 }
END { printf "cold tiles: %d, p50 %.0f ms, p90 %.0f ms, p99 %.0f ms, %.2f requests a tile\n", NR, t[int(NR * .5) + 1],
    t[int(NR * .9) + 1], t[int(NR * .99) + 1], n / NR }'
echo "then: $(memory_mb 1)"
kill "${pids[1]}"
wait "${pids[1]}"
begin 2 warm
kill "${pids[2]}"
wait "${pids[2]}"
url=$work/far/far.tiles
begin 3 'from a file,'
