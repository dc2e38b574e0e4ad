#!/usr/bin/env bash
# names.sh [NAMES [ROUND-TRIP-MS]]: three servers without data of their own share named appearances (--state-url) by way
# of an object at a plain server that takes PUT. What is kept at one is asked for at once at the two others. One is killed
# under load. The server of the object is away for a while. Clients ask for names that there are not.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
names=${1:-60} round_ms=${2:-30}
need nginx nginx-light
need curl curl
need node nodejs
"$city" "$work/lit.tiles" lit || exit 1
store=$work/lit.tiles
mkdir -p "$work/bucket"
bucket_port=$(free_port)
bucket() {
    node "$(dirname "$0")/bucket.mjs" "$work/bucket" "$work/bucket.log" "$bucket_port" "$round_ms" &
    pids[7]=$!
    await "http://127.0.0.1:$bucket_port/"
}
node_up() { # NUMBER PORT
    serve "$1" "$2" --admin 127.0.0.1:0 --cache-policy '*=1' --state-url "http://127.0.0.1:$bucket_port/names.json" --state-refresh-s 1
    operators "$1"
}
admin=()
check 'the server of the object answers' bucket
for i in 1 2 3; do node_up $i 0; done
servers=$(for i in 1 2 3; do echo "server 127.0.0.1:${ports[i]};"; done | tr '\n' ' ')
front_nginx nginx.conf 1 -e "s|server 127.0.0.1:8080;|$servers|" -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" -e '1i access_log off;'
keep() { # NODE NAME
    status -X PUT "http://127.0.0.1:${admin[$1]}/d/toy/appearances/$2" -d '{"weights":{"p1.jpg":1,"p2.jpg":3}}'
}

kept=0 found=0
for k in $(seq "$names"); do
    i=$((k % 3 + 1))
    [ "$(keep $i "n$k")" = 201 ] && kept=$((kept + 1))
    for j in $((i % 3 + 1)) $(((i + 1) % 3 + 1)); do
        curl -s -o /dev/null -w '%{http_code} %{time_total}\n' "http://127.0.0.1:${ports[j]}/d/toy/tileset.json?appearance=n$k"
    done
done >"$work/asked"
found=$(grep -c '^200 ' "$work/asked")
times=$(cut -d' ' -f2 "$work/asked" | sort -n | awk '{ t[NR] = $1 * 1000 } END { printf "%d %d %d", t[int(NR * .5) + 1], t[int(NR * .9) + 1], t[NR] }')
echo "names: a name of another server, at $round_ms ms: $times ms (p50, p90, most), $found found"
check 'what is kept at one' is "$kept" "$names"
check 'is found at the others at once' is "$found" $((names * 2))

(sleep 0.3; kill -9 "${pids[2]}") &
killer=$!
for k in $(seq "$names"); do echo "$url/d/toy/tileset.json?appearance=n$k"; done | xargs -P 4 -n 1 curl -s -o /dev/null -w '%{http_code}\n' >"$work/codes"
wait $killer
check 'one of three is killed, nobody notices' is "$(sort "$work/codes" | uniq -c | tr -s ' ')" " $names 200"
node_up 2 "${ports[2]}"
check 'it is back with all names' is "$(curl -s "http://127.0.0.1:${ports[2]}/d/toy/appearances?kept=true&limit=1000" | grep -o '"n[0-9]*"' | sort -u | wc -l)" "$names"

# Unknown names: all that a client can cause is a read four times a second at each server.
before=$(wc -l <"$work/bucket.log")
start=${EPOCHREALTIME/./}
for k in $(seq 300); do echo "http://127.0.0.1:${ports[k % 3 + 1]}/d/toy/tileset.json?appearance=not$k"; done |
    xargs -P 48 -n 1 curl -s -o /dev/null -w '%{http_code}\n' >"$work/codes"
ms=$(((${EPOCHREALTIME/./} - start) / 1000))
reads=$(($(wc -l <"$work/bucket.log") - before))
echo "names: 300 unknown ones in $ms ms took $reads reads"
check 'unknown names are 404' is "$(sort -u "$work/codes")" 404
check 'and cause few reads' at_most "$reads" $((3 * (ms / 250 + ms / 900 + 3)))

kill "${pids[7]}"
wait "${pids[7]}" 2>/dev/null
check 'without that server what is known is answered' is "$(status "$url/d/toy/tileset.json?appearance=n1")" 200
check 'of others it is not known whether they are' is "$(status "http://127.0.0.1:${ports[1]}/d/toy/tileset.json?appearance=later")" 503
check 'with Retry-After' is "$(header "http://127.0.0.1:${ports[1]}/d/toy/tileset.json?appearance=later" Retry-After)" 1
check 'and none is kept' is "$(keep 3 later)" 503
kill "${pids[2]}"
wait "${pids[2]}" 2>/dev/null
start=${EPOCHREALTIME/./}
"$bin" serve "$store" --check >/dev/null # what the machine needs for this just now
base=$(((${EPOCHREALTIME/./} - start) / 1000))
start=${EPOCHREALTIME/./}
node_up 2 "${ports[2]}"
check 'a server starts without it' at_most $(((${EPOCHREALTIME/./} - start) / 1000)) $((3 * base + 2000))
bucket
again() { for _ in $(seq 60); do [ "$(status "http://127.0.0.1:${ports[2]}/d/toy/tileset.json?appearance=n1")" = 200 ] && return 0; sleep 0.1; done; return 1; }
check 'when it is back all is as before' again
check 'and more can be kept' is "$(keep 3 later)" 201
check 'which the others know' is "$(status --retry 3 "http://127.0.0.1:${ports[1]}/d/toy/tileset.json?appearance=later")" 200
exit $failed
