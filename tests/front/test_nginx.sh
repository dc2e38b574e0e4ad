#!/usr/bin/env bash
# configs/nginx.conf with the real nginx: revalidation, merged requests, Range, stale answers when no server is left,
# and a server that is killed under load.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need nginx nginx-light
need curl curl
for i in 1 2 3; do serve $i 0 --cache-policy '*=1'; done
rev=$(revision)
servers=$(for i in 1 2 3; do echo "server 127.0.0.1:${ports[i]};"; done | tr '\n' ' ')

# The shipped file, with ports and folders of this test and without TLS.
front_nginx nginx.conf 2 -e "s|server 127.0.0.1:8080;|$servers|" -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" \
    -e '1i access_log off;'

check_first_tile
check 'a range beyond its end is 416' is "$(status -r 99999999- "$url$tile")" 416

# Ninety at once (the configuration allows a client a hundred) for a tile that nobody has: one request comes through.
cold=$(tiles | sed -n 20p)
before=$(asked "${cold##*/t/}")
for i in $(seq 90); do printf 'url="%s"\noutput="/dev/null"\n' "$url$cold"; done >"$work/many"
codes=$(curl -s --no-progress-meter --parallel --parallel-immediate --parallel-max 90 -w '%{http_code}\n' -K "$work/many" 2>/dev/null | sort | uniq -c | tr -s ' ')
check 'ninety at once are answered' is "$codes" ' 90 200'
check 'ninety at once are one request' is $(($(asked "${cold##*/t/}") - before)) 1

# What moves may be kept for a second here: behind it, nginx answers at once and asks with If-None-Match.
moving=/d/toy/tileset.json
check 'what moves is kept' is "$(header "$url$moving" X-Cache; header "$url$moving" X-Cache)" "$(printf 'MISS\nHIT')"
sleep 2.2
check 'stale while it revalidates' is "$(header "$url$moving" X-Cache)" STALE
fresh() { # within five seconds; what was revalidated is fresh for one
    for _ in $(seq 50); do
        [ "$(header "$url$moving" X-Cache)" = HIT ] && return
        sleep 0.1
    done
    return 1
}
check 'then fresh again' fresh
check 'revalidated by a 304' at_least "$(asked "GET $moving status=304")" 1

# One of three is killed while tiles that nobody has are asked for by eight clients.
tiles | sed -n '30,$p' | sed "s|^|$url|" >"$work/list"
(sleep 0.15; kill -9 "${pids[2]}") &
killer=$!
codes=$(xargs -P 8 -n 1 curl -s -o /dev/null -w '%{http_code}\n' <"$work/list" | sort | uniq -c | tr -s ' ')
wait $killer
check 'one of three killed, nobody notices' is "$codes" " $(wc -l <"$work/list") 200"
check 'it is gone' is "$(status --max-time 2 "http://127.0.0.1:${ports[2]}/healthz")" 000

# No server is left: what is in the cache is answered, old or not.
kill -9 "${pids[1]}" "${pids[3]}"
sleep 2.2
check 'no server left: tiles' is "$(status "$url$tile")" 200
check 'no server left: what moves' is "$(status "$url$moving")" 200
check 'no server left: it is stale' is "$(header "$url$moving" X-Cache)" STALE
check 'no server left: what nobody had' is "$(status "$url/d/toy/map.json")" 503
exit $failed
