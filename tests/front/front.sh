# shellcheck shell=bash
# Source this: three servers over one small city, and what tests of programs in front of them share.
#
#   CITYSPLAT_BIN, FRONT_CITY   the program, and the one that writes the city
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?run this test through ctest} city=${FRONT_CITY:?run this test through ctest}
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-front-XXXXXX") || exit 1
pids=() ports=() failed=0
trap 'front_end' EXIT

front_end() {
    local p
    for p in "${pids[@]}"; do kill "$p" 2>/dev/null; done
    wait
    rm -rf "$work"
}

skip() { echo "skipped: $*"; exit 77; }

need() { # PROGRAM PACKAGE
    command -v "$1" >/dev/null || [ -x "/usr/sbin/$1" ] || skip "no $1: Debian's package $2 has it"
}

need_xkey() { # configs/varnish.vcl asks for it
    [ -n "$(find /usr/lib -name libvmod_xkey.so -print -quit 2>/dev/null)" ] || skip "no vmod xkey: Debian's package varnish-modules has it"
}

check() { # WHAT COMMAND...: says what failed
    local what=$1
    shift
    if "$@"; then echo "ok: $what"; else echo "FAILED: $what"; failed=1; fi
}

is() { [ "$1" = "$2" ] || { echo "  is '$1', want '$2'"; return 1; }; }
at_least() { [ "${1:-0}" -ge "$2" ] || { echo "  is '$1', want at least $2"; return 1; }; }
at_most() { [ "${1:-0}" -le "$2" ] || { echo "  is '$1', want at most $2"; return 1; }; }

serve() { # NUMBER PORT [OPTIONS]: starts a server of $store, else of $work/toy.tiles; its port (0: any) in ports[NUMBER], its log in NUMBER.log
    local i=$1 port=$2 k
    shift 2
    : >"$work/$i.out"
    "$bin" serve "${store:-$work/toy.tiles}" --port "$port" --device none --trusted-proxy 127.0.0.1 "$@" \
        >"$work/$i.out" 2>>"$work/$i.log" &
    pids[i]=$!
    for k in $(seq 100); do
        ports[i]=$(sed -n 's|.*https*://[^:]*:\([0-9]*\)/.*|\1|p' "$work/$i.out")
        [ -z "${ports[i]}" ] || return 0
        kill -0 "${pids[i]}" 2>/dev/null || break
        sleep 0.05
    done
    cat "$work/$i.log"
    exit 1
}
free_port() { # a port that is free now
    perl -MIO::Socket::INET -e 'print IO::Socket::INET->new(Listen => 1, LocalAddr => "127.0.0.1")->sockport'
}

await() { # URL [CURL OPTIONS]: answers at all, within five seconds
    local k
    for k in $(seq 100); do
        curl -s -o /dev/null --max-time 1 "$@" && return 0
        sleep 0.05
    done
    return 1
}

header() { # URL NAME [CURL OPTIONS]
    local url=$1 name=$2
    shift 2
    curl -s -o /dev/null -D - "$@" "$url" | tr -d '\r' | sed -n "s/^$name: //Ip" | tail -1
}

status() { curl -s -o /dev/null -w '%{http_code}' "$@"; }

asked() { # PATTERN: how often the servers logged a request like it
    sleep 0.3 # lines are written ten times a second
    cat "$work"/*.log | grep -c -- "$1"
}

fetch_all() { # FOLDER: bodies of the paths on stdin into FOLDER/1, FOLDER/2 ... over one connection; nothing where it is not 200
    mkdir -p "$1"
    rm -f "$1"/*
    awk -v url="http://127.0.0.1:${ports[1]}" -v to="$1" '{ printf "url = \"%s%s\"\noutput = \"%s/%d\"\n", url, $1, to, NR }' |
        curl -sf --compressed --max-time 60 -K -
}

sums() { # FOLDER COUNT: of what fetch_all has written, a line a body; "none" where it is missing
    local k
    for k in $(seq "$2"); do [ -e "$1/$k" ] || echo none >"$1/$k"; done
    (cd "$1" && seq "$2" | xargs sha256sum | cut -d' ' -f1)
}

revision() { curl -s "http://127.0.0.1:${ports[1]}/version" | sed -n 's/.*"toy": *"\([0-9a-f]*\)".*/\1/p'; }

tiles() { # paths of tiles, one a line: the same places in many formats
    local place preset sh ext
    for place in $(curl -s "http://127.0.0.1:${ports[1]}/d/toy/seed.ndjson" | sed -n 's|.*/t/\([0-9/]*\)\..*|\1|p'); do
        for ext in glb spz drc; do
            for preset in spz preview balanced near-lossless; do
                for sh in 0 1; do echo "/d/toy/r/$rev/t/$place.$ext?preset=$preset&sh=$sh"; done
            done
        done
    done
}

check_first_tile() { # through the cache at $url; leaves its path in $tile
    tile=$(tiles | head -1)
    check 'a cold tile is a miss' is "$(header "$url$tile" X-Cache)" MISS
    check 'then it is a hit' is "$(header "$url$tile" X-Cache)" HIT
    header "$url${tile%%\?*}" X-Cache >/dev/null
    check 'the ?v= that CesiumJS adds is no other file' is "$(header "$url${tile%%\?*}?v=0123456789ab" X-Cache)" HIT
    check 'its bytes are those of a server' cmp <(curl -s "$url$tile") <(curl -s "http://127.0.0.1:${ports[1]}$tile")
    check 'a range of it' cmp <(curl -s -r 100-299 "$url$tile") <(curl -s "$url$tile" | tail -c +101 | head -c 200)
    check 'a range is 206' is "$(status -r 100-299 "$url$tile")" 206
    check 'If-None-Match is 304' is "$(status -H "If-None-Match: $(header "$url$tile" ETag)" "$url$tile")" 304
}

"$city" "$work/toy.tiles" || exit 1

# nginx on 127.0.0.1:$front with a file of configs/, its ports and folders changed by options of sed. $url is its address,
# pids[4] its process. With $site the file keeps TLS, and $url is https://$site:$front, for curl with "${known[@]}"; else it
# speaks HTTP, and answers to 127.0.0.1 as well. $under: a command that runs it.
site= known=() under=()
front_nginx() { # FILE WORKERS SED-OPTION...
    local file=$1 workers=$2 d
    shift 2
    front=$(free_port) url=http://127.0.0.1:$front
    mkdir -p "$work/nginx/logs" "$work/nginx/cache"
    if [ -n "$site" ]; then
        front_certificate
        set -- -e "s|listen 443 |listen 127.0.0.1:$front |" -e "s|/etc/ssl|$work|" "$@"
        url=https://$site:$front known=(--cacert "$work/splats.pem" --resolve "$site:$front:127.0.0.1")
    else
        set -- -e "s|listen 443 ssl http2\(.*\);|listen 127.0.0.1:$front\1;|" -e '/ssl_/d' -e 's|server_name.*example.org|& 127.0.0.1|' "$@"
    fi
    {
        [ "$(id -u)" != 0 ] || echo 'user root;' # the folder is its own alone
        printf 'daemon off;\nworker_processes %s;\npid %s/nginx/pid;\nerror_log %s/nginx/error.log;\n' "$workers" "$work" "$work"
        printf 'events { worker_connections 512; }\nhttp {\n'
        for d in client_body proxy fastcgi uwsgi scgi; do printf '%s_temp_path %s/nginx/%s;\n' $d "$work" $d; done
        sed "$@" "$root/configs/$file"
        printf '}\n'
    } >"$work/nginx.conf"
    PATH=$PATH:/usr/sbin
    if ! nginx -t -p "$work/nginx" -c "$work/nginx.conf" >"$work/nginx/test" 2>&1; then
        cat "$work/nginx/test"
        exit 1
    fi
    front_nginx_start
}
front_nginx_start() {
    "${under[@]}" nginx -p "$work/nginx" -c "$work/nginx.conf" &
    pids[4]=$!
    check 'nginx answers' await "$url/healthz" "${known[@]}"
}
front_certificate() { # of $site, in splats.pem and splats.key
    [ -e "$work/splats.pem" ] || openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj "/CN=$site" \
        -addext "subjectAltName=DNS:$site" -keyout "$work/splats.key" -out "$work/splats.pem" 2>"$work/openssl.log" ||
        { cat "$work/openssl.log"; exit 1; }
}

# nginx with the files of $work/far, as a store at an address is read. $far is its address, pids[8] its process, far/log its log.
far_nginx() {
    local d far_port
    far_port=$(free_port) far=http://127.0.0.1:$far_port
    mkdir -p "$work/far"
    {
        [ "$(id -u)" != 0 ] || echo 'user root;'
        printf 'daemon off;\nworker_processes 1;\npid %s/far/pid;\nerror_log %s/far/error;\nevents { }\n' "$work" "$work"
        printf 'http {\naccess_log %s/far/log;\nkeepalive_requests 1000000;\n' "$work"
        for d in client_body proxy fastcgi uwsgi scgi; do printf '%s_temp_path %s/far/%s;\n' $d "$work" $d; done
        printf 'server { listen 127.0.0.1:%s; root %s/far; }\n}\n' "$far_port" "$work"
    } >"$work/far.conf"
    PATH=$PATH:/usr/sbin nginx -p "$work/far" -c "$work/far.conf" &
    pids[8]=$!
    check 'the server of the store answers' await "$far/"
}
