#!/usr/bin/env bash
# A stream of pictures through the shipped configurations of nginx and of Varnish, over two servers: the camera reaches
# the server that draws, each picture comes while the stream is open, and a reader that leaves ends it. And a page of
# pictures through nginx.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
need nginx nginx-light
need varnishd varnish
need_xkey
PATH=$PATH:/usr/sbin
for i in 1 2; do serve $i 0 --device cpu; done
ready() { # the device of server NUMBER draws within 90 seconds
    local k answer
    for k in $(seq 180); do
        answer=$(status --max-time 5 "http://127.0.0.1:${ports[$1]}/d/toy/static/13.4,52.5,90@0,-90/64x48.jpg" -L)
        [ "$answer" != 200 ] || return 0
        grep -q 'pictures are off\|no OpenCL' "$work/$1.log" && return 1
        sleep 0.5
    done
    return 1
}
ready 1 || skip 'there is no OpenCL device'
ready 2 || skip 'there is no OpenCL device'

nginx_port=$(free_port)
mkdir -p "$work/nginx/logs" "$work/nginx/cache"
{
    [ "$(id -u)" != 0 ] || echo 'user root;'
    printf 'daemon off;\nworker_processes 1;\npid %s/nginx/pid;\nerror_log %s/nginx/error.log;\n' "$work" "$work"
    printf 'events { worker_connections 512; }\nhttp {\naccess_log off;\n'
    for d in client_body proxy fastcgi uwsgi scgi; do printf '%s_temp_path %s/nginx/%s;\n' $d "$work" $d; done
    sed -e "s|listen 443 ssl http2\(.*\);|listen 127.0.0.1:$nginx_port\1;|" -e '/ssl_/d' -e 's|server_name.*example.org|& 127.0.0.1|' \
        -e "s|server 127.0.0.1:8080;|server 127.0.0.1:${ports[1]}; server 127.0.0.1:${ports[2]};|" \
        -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" "$root/configs/nginx.conf"
    printf '}\n'
} >"$work/nginx.conf"
nginx -p "$work/nginx" -c "$work/nginx.conf" >"$work/nginx.out" 2>&1 &
pids[4]=$!
varnish_port=$(free_port)
sed -e "s|8081|${ports[1]}|" -e "s|8082|${ports[2]}|" -e "s|8083|${ports[2]}|" "$root/configs/varnish.vcl" >"$work/front.vcl"
jail=()
[ "$(id -u)" != 0 ] || { jail=(-j none); }
varnishd "${jail[@]}" -F -n "$work/varnish" -a "127.0.0.1:$varnish_port" -f "$work/front.vcl" -s malloc,16m >"$work/varnish.out" 2>&1 &
pids[5]=$!

steer() { # URL NUMBER STILL: the status
    status -d "{\"number\": $2, \"still\": $3, \"width\": 320, \"height\": 240,
        \"pose\": {\"lon\": 13.4, \"lat\": 52.5, \"height\": $((90 + $2)), \"heading\": $2, \"pitch\": -60}}" "$1"
}
pictures() { grep -a -c "^Pose: " "$work/stream"; }
came() { # NUMBER: the picture of this camera is there within 20 seconds, although the stream goes on
    local k
    for k in $(seq 400); do
        grep -a -q "^Pose: $1"$'\r' "$work/stream" && return 0
        sleep 0.05
    done
    return 1
}
open_streams() { # of both servers
    for i in 1 2; do curl -s "http://127.0.0.1:${ports[i]}/metrics"; done | awk '$1 == "citysplat_streams" { n += $2 } END { print n + 0 }'
}
closed() { # all of them, within 10 seconds
    local k
    for k in $(seq 100); do
        [ "$(open_streams)" != 0 ] || return 0
        sleep 0.1
    done
    return 1
}

# A page of 24 views at once through nginx: all are drawn, and a reload has all from its cache.
url=http://127.0.0.1:$nginx_port
check 'nginx answers' await "$url/healthz"
rev=$(header "$url/d/toy/static/13.4,52.5,90@0,-90/64x48.jpg" Location | sed -n 's|.*r/\([^/]*\)/static.*|\1|p')
for i in $(seq 24); do
    printf 'url="%s/d/toy/r/%s/static/13.4,52.5,90@%s,-60/320x240.jpg"\noutput="/dev/null"\n' "$url" "$rev" $((15 * i))
done >"$work/page"
page() { # the answers: how many of which status, and of which state of the cache
    curl -s --no-progress-meter --parallel --parallel-immediate --parallel-max 24 --max-time 60 -K "$work/page" \
        -w '%{http_code} %header{x-cache}\n' 2>/dev/null | sort | uniq -c | tr -s ' '
}
check 'a page of 24 views is 24 pictures' is "$(page)" ' 24 200 MISS'
check 'and on reload' is "$(page)" ' 24 200 HIT'

for front in nginx varnish; do
    port=${front}_port
    url=http://127.0.0.1:${!port}
    check "$front answers" await "$url/healthz"
    for name in first-0123456789ab second-0123456789a; do # by their names on one server or the other
        at=$url/d/toy/motion/$front-$name
        : >"$work/stream"
        check "$front: nobody reads it yet" is "$(steer "$at" 1 false)" 404
        curl -s -N --max-time 120 -o "$work/stream" "$at" &
        reader=$!
        for k in $(seq 100); do [ "$(steer "$at" 1 false)" != 204 ] || break; sleep 0.05; done
        for number in 2 3 4; do
            check "$front: camera $number is taken" is "$(steer "$at" $number false)" 204
            check "$front: its picture comes at once" came $number
        done
        check "$front: one at rest" is "$(steer "$at" 5 true)" 204
        check "$front: its picture comes at once" came 5
        check "$front: pictures" at_least "$(pictures)" 4
        check "$front: they are JPEG" at_least "$(LC_ALL=C grep -a -c $'\xff\xd8\xff' "$work/stream")" 4
        kill $reader
        wait $reader 2>/dev/null
        check "$front: a reader that leaves ends it" closed
    done
done
exit $failed
