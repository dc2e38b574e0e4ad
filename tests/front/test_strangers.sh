#!/usr/bin/env bash
# configs/nginx.conf as it is shipped, with TLS and HTTP/2, against those who ask for another name, send headers of proxies,
# or come in crowds: no visitor gets an address of a stranger's or one by http, nobody waits for what is another's, and no
# document outlives its revision. Then a cache that ignores Vary, in front of a server with configs/serve.jsonc.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need nginx nginx-light
need curl curl
need openssl openssl
curl --version | grep -q HTTP2 || skip 'this curl has no HTTP/2'
site=splats.example.org evil=evil.example
"$city" "$work/next.tiles" 2100 || exit 1
cp "$work/toy.tiles" "$work/live.tiles"
sed 's|127.0.0.1:8078|127.0.0.1:0|' "$root/configs/serve.jsonc" >"$work/serve.jsonc"
store=$work/live.tiles serve 1 0 --config "$work/serve.jsonc" --keep-s 0
rev=$(revision)
front_nginx nginx.conf 2 -e "s|127.0.0.1:8080|127.0.0.1:${ports[1]}|" -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" -e '1i access_log off;'
visitor() { curl -s "${known[@]}" "$@"; }
code() { visitor -o /dev/null -w '%{http_code}' "$@"; }
field() { visitor -o /dev/null -D - "${@:2}" | tr -d '\r' | sed -n "s/^$1: //Ip" | tail -1; }

# ---- other names

addresses() { grep -oE 'https?://[^/"<> ]*' | grep -vE 'www.opengis.net|www.w3.org|schemas.opengis.net' | sort -u; }
n=0
for document in style.json map.json terrain.json wmts.xml; do
    for how in "target http://$evil" "target https://$evil" "Host $evil" "X-Forwarded-Host $evil" "X-Forwarded-Proto http" "Forwarded host=$evil;proto=http"; do
        n=$((n + 1))
        path="/d/toy/$document?stranger=$n" # nobody has it yet, so what the stranger gets is what the cache has
        case $how in
            target*) got=$(visitor --http1.1 --request-target "${how#target }$path" -w '%{http_code}' "$url/") ;;
            *) got=$(visitor -w '%{http_code}' -H "${how%% *}: ${how#* }" "$url$path") ;;
        esac
        case $how in
            target* | Host*) check "$how: nothing, for $document" is "${got: -3}" 000 ;;
            *) check "$how: $document all the same" is "${got: -3}" 200 ;;
        esac
        check "then $document has our addresses alone" is "$(visitor "$url$path" | addresses)" "https://$site"
    done
done
check 'a name of TLS that is not ours' is "$(curl -sk -o /dev/null -w '%{http_code}' --resolve "$evil:$front:127.0.0.1" "https://$evil:$front/healthz")" 000
check 'our name in the request line, another in Host' is "$(visitor --http1.1 --request-target "https://$site/d/toy/style.json?stranger=mine" -H "Host: $evil" "$url/" | addresses)" "https://$site"
check 'metrics are not for the public' is "$(code "$url/metrics")" 404

# ---- ?v=

for pair in 'tileset.json?v=1 tileset.json' 'tileset.json?sh=1&v=1.2 tileset.json?sh=1' 'tileset.json?v=2&sh=0 tileset.json?sh=0' \
    'tileset.json?preset=spz&v=&sh=0 tileset.json?preset=spz&sh=0'; do
    check "$pair: asked for once" is "$(field X-Cache "$url/d/toy/${pair% *}"; field X-Cache "$url/d/toy/${pair#* }")" "$(printf 'MISS\nHIT')"
done
check 'another key that ends in v is kept' is "$(field X-Cache "$url/d/toy/tileset.json?rev=1"; field X-Cache "$url/d/toy/tileset.json?rev=2")" "$(printf 'MISS\nMISS')"

# ---- 128 streams of one connection

if command -v h2load >/dev/null; then
    tiles | head -16 | sed "s|^|https://$site:$front|" >"$work/streams"
    h2load -n 128 -c 1 -m 128 --connect-to="127.0.0.1:$front" -i "$work/streams" >"$work/h2load" 2>&1
    check 'it has no more connections, and HTTP/2' is "$(grep -cE '^starting benchmark|1 total client|Application protocol: h2' "$work/h2load")" 3
    check '128 streams of a connection are answered' is "$(sed -n 's/^status codes: //p' "$work/h2load")" '128 2xx, 0 3xx, 0 4xx, 0 5xx'
else
    echo "not looked at: 128 streams of one connection, without h2load of Debian's package nghttp2-client"
fi

# ---- a dropped revision

moving=/d/toy/tileset.json?visit
check 'a visitor has the document' is "$(visitor "$url$moving" | grep -o "$rev" | sort -u)" "$rev"
cp "$work/next.tiles" "$work/part.tiles"
mv "$work/part.tiles" "$work/live.tiles"
kill -HUP "${pids[1]}"
for _ in $(seq 100); do [ "$(revision)" = "$rev" ] || break; sleep 0.05; done
check 'another revision is served' test "$(revision)" != "$rev"
clock=$(find /usr/lib -name libfaketime.so.1 2>/dev/null | head -1)
if [ -n "$clock" ]; then
    kill "${pids[4]}"
    wait "${pids[4]}" 2>/dev/null
    under=(env LD_PRELOAD="$clock" FAKETIME=+15m) # the document may be stale for ten minutes beyond its one
    front_nginx_start
    check 'after fifteen minutes nobody gets the revision that is gone' is "$(visitor "$url$moving" | grep -c "$rev")" 0
    kill "${pids[4]}"
    wait "${pids[4]}" 2>/dev/null
    under=()
    front_nginx_start
else
    echo 'not looked at: a document after fifteen minutes, without faketime'
fi

# ---- what is somebody's

own=a-token-of-somebody
printf '{"keys": {"k": "a key of this test alone, 32 characters"}, "tokens": [{"sha256": "%s", "scope": ["read:toy"]}]}' \
    "$(printf %s $own | sha256sum | cut -d' ' -f1)" >"$work/auth.jsonc"
chmod 600 "$work/auth.jsonc"
kill "${pids[1]}"
wait "${pids[1]}" 2>/dev/null
store=$work/live.tiles serve 1 "${ports[1]}" --auth "$work/auth.jsonc" --config "$work/serve.jsonc"
tile=$(curl -s -H "Authorization: Bearer $own" "http://127.0.0.1:${ports[1]}/d/toy/seed.ndjson" | sed -n 's|.*"url":"\(r/[^"]*\)".*|/d/toy/\1|p' | head -1)
session=$(field Set-Cookie -d "token=$own" "$url/session")
check 'a session is for https alone' is "$(echo "$session" | grep -c '; *Secure')" 1
signed=$("$bin" sign toy --auth "$work/auth.jsonc" --url "$url") || exit 1
once=$("$bin" sign "$tile?thirty=1" --auth "$work/auth.jsonc" --url "$url" 2>/dev/null || "$bin" sign "$tile" --auth "$work/auth.jsonc" --url "$url") || exit 1
crowd() { # WHAT URL [CURL OPTIONS]: thirty at once in less than two seconds; in turn, at half a second each, they take fourteen
    local what=$1 at=$2 from ms
    shift 2
    for _ in $(seq 30); do printf 'url="%s"\noutput="/dev/null"\n' "$at"; done >"$work/many"
    from=${EPOCHREALTIME/./}
    got=$(visitor --http1.1 --no-progress-meter --parallel --parallel-immediate --parallel-max 30 -K "$work/many" -w '%{http_code}\n' "$@" 2>/dev/null | sort | uniq -c | tr -s ' ')
    ms=$(((${EPOCHREALTIME/./} - from) / 1000))
    check "thirty at $what" is "$got" ' 30 200'
    check "thirty at $what take $ms ms" at_most "$ms" 2000
}
crowd 'a tile, with a token' "$url$tile?a" -H "Authorization: Bearer $own"
crowd 'a tile, with a session' "$url$tile?b" -H "Cookie: ${session%%;*}"
crowd 'a tile below a signature' "$signed${tile#/}"
crowd 'a tile with a signature in the query' "$once"
for path in /version /readyz /collections; do crowd "$path" "$url$path"; done
check 'the next one without a token gets nothing' is "$(code "$url$tile?a"; code "$url$tile?b"; code "$url$tile")" 401401401
check 'nothing of it is in the cache' is "$(grep -rhaE '^KEY: ' "$work/nginx/cache" | grep -cE '(\?a|\?b)$|sig=|/signed/|/(version|readyz|collections)$')" 0
check 'what is public is' at_least "$(grep -rhaE '^KEY: ' "$work/nginx/cache" | grep -c toy)" 20

# ---- nginx's own answer

kill "${pids[1]}"
wait "${pids[1]}" 2>/dev/null
check 'no server: 503' is "$(code "$url/d/toy/map.json?away")" 503
check 'no server: when to come again' is "$(field Retry-After "$url/d/toy/map.json?away")" 2
check 'no server: pages of others may read it' is "$(field Access-Control-Allow-Origin "$url/d/toy/r/x/away")" '*'

# ---- a cache that ignores Vary

careless() { # of the server NUMBER: all that is wrong with it is that Host is no part of its key, and Vary is ignored
    local port
    port=$(free_port) url=http://127.0.0.1:$port
    mkdir -p "$work/cdn/$1"
    {
        [ "$(id -u)" != 0 ] || echo 'user root;'
        printf 'daemon off;\nworker_processes 1;\npid %s/cdn/pid%s;\nerror_log %s/cdn/error;\nevents { }\nhttp {\naccess_log off;\n' "$work" "$1" "$work"
        for d in client_body proxy fastcgi uwsgi scgi; do printf '%s_temp_path %s/cdn/%s;\n' $d "$work" $d; done
        printf 'proxy_cache_path %s/cdn/%s keys_zone=cdn:1m;\nserver {\nlisten 127.0.0.1:%s;\nlocation / {\n' "$work" "$1" "$port"
        printf 'proxy_pass http://127.0.0.1:%s;\nproxy_set_header Host $http_host;\nproxy_cache cdn;\nproxy_cache_key $uri;\n' "${ports[$1]}"
        printf 'proxy_ignore_headers Vary;\nproxy_hide_header Vary;\n}\n}\n}\n'
    } >"$work/cdn/$1.conf"
    nginx -p "$work/cdn" -c "$work/cdn/$1.conf" &
    pids[4 + $1]=$!
    await "$url/healthz"
}
sed 's|// "public_url"|"public_url"|' "$work/serve.jsonc" >"$work/public.jsonc"
serve 2 0 --config "$work/serve.jsonc"
careless 2
curl -s -H "Host: $evil" -o /dev/null "$url/d/toy/style.json"
check 'without public_url such a cache gives everybody the addresses of whoever came first' is "$(curl -s "$url/d/toy/style.json" | addresses)" "http://$evil"
serve 3 0 --config "$work/public.jsonc"
careless 3
for document in style.json map.json terrain.json wmts.xml; do
    curl -s -H "Host: $evil" -H "X-Forwarded-Host: $evil" -H 'X-Forwarded-Proto: http' -o /dev/null "$url/d/toy/$document"
    check "with public_url $document has our addresses alone" is "$(curl -s "$url/d/toy/$document" | addresses)" "https://$site"
done
exit $failed
