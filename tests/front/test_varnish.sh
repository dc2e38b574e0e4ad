#!/usr/bin/env bash
# configs/varnish.vcl with the real Varnish: merged requests, Range, revalidation, purging by tag, stale answers when
# no server is left, and a server that is killed under load.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need varnishd varnish
need curl curl
need_xkey
for i in 1 2 3; do serve $i 0 --cache-policy '*=1' --tag-header xkey; done
rev=$(revision)
front=$(free_port) purge=http://127.0.0.1:$(free_port)
sed -e "s|8081|${ports[1]}|" -e "s|8082|${ports[2]}|" -e "s|8083|${ports[3]}|" "$root/configs/varnish.vcl" >"$work/front.vcl"
PATH=$PATH:/usr/sbin
jail=()
[ "$(id -u)" != 0 ] || { jail=(-j none); }
varnishd "${jail[@]}" -F -n "$work/varnish" -a "127.0.0.1:$front" -a "purge=${purge#http://}" -f "$work/front.vcl" -s malloc,64m -p http_gzip_support=off \
    -p thread_pool_min=10 >"$work/varnish.out" 2>&1 &
pids[4]=$!
url=http://127.0.0.1:$front
if ! await "$url/healthz"; then
    cat "$work/varnish.out"
    exit 1
fi

check_first_tile

cold=$(tiles | sed -n 20p)
for i in $(seq 200); do printf 'url="%s"\noutput="/dev/null"\n' "$url$cold"; done >"$work/many"
codes=$(curl -s --no-progress-meter --parallel --parallel-immediate --parallel-max 200 -w '%{http_code}\n' -K "$work/many" 2>/dev/null | sort | uniq -c | tr -s ' ')
check '200 at once are answered' is "$codes" ' 200 200'
check '200 at once are one request' is "$(asked "${cold##*/t/}")" 1

for i in $(seq 30); do printf 'url="%s"\noutput="/dev/null"\n' "$url/version"; done >"$work/many"
from=${EPOCHREALTIME/./}
codes=$(curl -s --no-progress-meter --parallel --parallel-immediate --parallel-max 30 -w '%{http_code}\n' -K "$work/many" 2>/dev/null | sort | uniq -c | tr -s ' ')
ms=$(((${EPOCHREALTIME/./} - from) / 1000))
check 'thirty at once for what is not kept' is "$codes" ' 30 200'
check "they take $ms ms" at_most "$ms" 2000

moving=/d/toy/tileset.json
curl -s -o /dev/null "$url$moving"
sleep 2.2
check 'stale while it revalidates' is "$(status "$url$moving")" 200
sleep 0.3
check 'revalidated by a 304' at_least "$(asked "GET $moving status=304")" 1

check 'from outside nobody purges' is "$(for how in '' 'xkey-purge: ds-toy'; do status -X PURGE -H "$how" "$url$tile"; status -X PURGE -H "$how" -H 'Host: 127.0.0.1' -H 'X-Forwarded-For: 127.0.0.1' "$url/"; done)" 405405405405
check 'nothing was purged' is "$(header "$url$tile" X-Cache)" HIT
check 'the port of purges gives nothing else' is "$(status "$purge$tile")" 405
check 'operators may purge' is "$(status -X PURGE -H 'xkey-purge: rev-000000000000' "$purge/")" 200
check 'another revision: nothing is purged' is "$(header "$url$tile" X-Cache)" HIT
check 'this revision is purged' is "$(status -X PURGE -H "xkey-purge: rev-$rev" "$purge/")" 200
check 'this revision: a miss' is "$(header "$url$tile" X-Cache)" MISS
check 'this dataset is purged' is "$(status -X PURGE -H 'xkey-purge: ds-toy' "$purge/")" 200
check 'this dataset: a miss' is "$(header "$url$moving" X-Cache)" MISS
for pair in 'tileset.json?v=1 tileset.json?' 'tileset.json?sh=1&v=1.2 tileset.json?sh=1' 'tileset.json?v=2&sh=0&preset=spz tileset.json?sh=0&preset=spz'; do
    status "$url/d/toy/${pair% *}" >"$work/null"
    check "$pair: asked for once" is "$(header "$url/d/toy/${pair#* }" X-Cache)" HIT
done
status -H 'X-Forwarded-Host: evil.example' "$url/d/toy/style.json" >"$work/null"
check "a stranger's X-Forwarded-Host goes no further" is "$(curl -s -H 'X-Forwarded-Host: evil.example' "$url/d/toy/style.json" | grep -c evil)" 0

tiles | sed -n '30,$p' | sed "s|^|$url|" >"$work/list"
curl -s -o /dev/null "$url$tile"
(sleep 0.15; kill -9 "${pids[2]}") &
killer=$!
codes=$(xargs -P 8 -n 1 curl -s -o /dev/null -w '%{http_code}\n' <"$work/list" | sort | uniq -c | tr -s ' ')
wait $killer
check 'one of three killed, nobody notices' is "$codes" " $(wc -l <"$work/list") 200"

kill -9 "${pids[1]}" "${pids[3]}"
sleep 2.5
check 'no server left: tiles' is "$(status "$url$tile")" 200
check 'no server left: what moves' is "$(status "$url$moving")" 200
check 'no server left: what nobody had' is "$(status "$url/d/toy/map.json")" 503
exit $failed
