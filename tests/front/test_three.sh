#!/usr/bin/env bash
# "At three in the morning" of docs/operations.md: each row is made to happen, the place to look at says it, and what is to
# be done mends it. A row without a `row` line in a test of this folder is an error, and so is the reverse; rows of systemd
# are in test_unit.sh.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
need openssl openssl
need sqlite3 sqlite3
need nginx nginx-light
row() { echo "-- $1"; }
check 'rows of the page, and rows that tests make happen' is \
    "$(sed -n '/^## At three in the morning/,/^## Exit codes/s/^| \([^|]*[^| ]\) *| .*/\1/p' "$root/docs/operations.md" | grep -vE '^(symptom|---)' | sort)" \
    "$(sed -n "s/^row '\(.*\)'\$/\1/p" "$root"/tests/front/test_*.sh | sort)"

mkdir "$work/stores"
put() { cp "${2:-$work/toy.tiles}" "$work/stores/part" && mv "$work/stores/part" "$work/stores/$1.tiles"; }
begin() { # OPTIONS: server 1 of the folder; $here and $admin are its addresses
    store=$work/stores serve 1 0 --admin 127.0.0.1:0 "$@"
    here=http://127.0.0.1:${ports[1]} admin=http://127.0.0.1:$(sed -n 's/.*operators: port \([0-9]*\).*/\1/p' "$work/1.out" | tail -1)
}
finish() {
    kill "${pids[1]}"
    wait "${pids[1]}" 2>/dev/null
    rm -f "$work/1.log"
}
ready() { curl -s "$admin/readyz" -w '%{http_code}' | tr -d '\n'; } # one line, the status behind it
reload() { status -X POST "$admin/-/reload"; }
logged() { # PATTERN: lines of the log with it
    sleep 0.3
    grep -cE "$1" "$work/1.log"
}
metric() { curl -s "$admin/metrics" | awk -v name="citysplat_$1" '$1 == name { print $2 }'; }
until_ready() { # WANT: readiness has it within thirty seconds
    local k
    for k in $(seq 300); do
        ready | grep -q "$1" && return 0
        sleep 0.1
    done
    ready
    return 1
}
first_tile() { curl -s "$here/d/toy/seed.ndjson?f=${1:-spz}" | sed -n 's|.*"url":"\([^"]*\)".*|/d/toy/\1|p' | head -1; }

row 'it does not start'
echo '{"no_such_option": 1}' >"$work/wrong.jsonc"
"$bin" serve "$work/stores" --config "$work/wrong.jsonc" --check 2>"$work/why"
check 'the code of a wrong file of options' is $? 78
check '--check names it' at_least "$(grep -c 'no_such_option' "$work/why")" 1
begin
timeout 20 "$bin" serve "$work/stores" --port "${ports[1]}" --device none 2>"$work/why" >"$work/null"
check 'the code of a port that is taken' is $? 69
check 'the log names the port' at_least "$(grep -c "${ports[1]}" "$work/why")" 1

row '`/readyz` says `empty`'
check 'it says so, and what to do' at_least "$(ready | grep '"empty"' | grep -c 'NAME.tiles')" 1
put toy
check 'a store is added: the reload answers 200' is "$(reload)" 200
check 'ready' until_ready '"ready"'

row '`/readyz` says `stores`'
head -c 3000 "$work/toy.tiles" >"$work/stores/cut.tiles"
check 'the reload fails visibly' is "$(reload)" 500
check 'readiness names the file, and is 200' is "$(ready | grep -c 'cut.tiles.*200$')" 1
check 'the log names it' at_least "$(logged 'cut\.tiles')" 1
check 'the gauge counts it' is "$(metric stores_degraded)" 1
check 'the others are served' is "$(status "$here/d/toy/tileset.json")" 200
rm "$work/stores/cut.tiles"
check 'removed, and it is ready' is "$(reload; ready | grep -c '"ready"')" "$(printf 2001)"

row '`/readyz` says `failed`'
sqlite3 "$work/stores/toy.tiles" 'UPDATE tiles SET payload = zeroblob(length(payload))' || exit 1
cp "$work/stores/toy.tiles" "$work/damaged.tiles"
check 'the damaged store is served as well as it can' is "$(reload)" 200
check 'a damaged tile is a 500' is "$(status "$here$(first_tile)")" 500
check 'readiness counts it' at_least "$(ready | grep -c '"failed".*"toy": *[1-9]')" 1
check 'verify lists it' at_least "$("$bin" verify "$work/damaged.tiles" 2>&1 | grep -cE '[0-9]+/[0-9]+/[0-9]+')" 1
put toy
check 'the whole store beside it, renamed, and a reload: ready' is "$(reload; ready | grep -c '"ready"')" "$(printf 2001)"
check 'the tile is there' is "$(status "$here$(first_tile)")" 200
finish

row '`/readyz` says `reload`'
echo '{"public": ["toy"]}' >"$work/auth.jsonc"
chmod 600 "$work/auth.jsonc"
begin --auth "$work/auth.jsonc"
echo '{"public": ' >"$work/auth.jsonc"
check 'a reload with a wrong file fails visibly' is "$(reload)" 500
check 'readiness gives the reason' at_least "$(ready | grep -c '"reload".*auth.jsonc')" 1
check 'the data of before are served' is "$(status "$here/d/toy/tileset.json")" 200
echo '{"public": ["toy"]}' >"$work/auth.jsonc"
check 'repaired, and a reload: ready' is "$(reload; ready | grep -c '"ready"')" "$(printf 2001)"
finish

row '`/readyz` says `pictures`'
begin --device 'no such device'
check 'readiness says that they are off, and why' until_ready '"pictures": *"off: .*no such device'
check 'a picture says when to come again' at_least "$(header "$here/d/toy/static/13.4,52.5,90@0,-90/64x48.jpg" Retry-After -L)" 1
check 'tiles are served' is "$(status "$here$(first_tile)")" 200
finish

row 'the log says `disk cache: not kept`'
# A limit of 24 KiB a file stands for a full disk: the larger tiles cannot be written.
printf '#!/bin/bash\ntrap "" XFSZ\nulimit -f 24\nexec %q "$@"\n' "$bin" >"$work/small"
chmod +x "$work/small"
mkdir "$work/disk"
bin=$work/small begin --cache-dir "$work/disk" --no-access-log
tile=$(first_tile ply)
check 'answers are not affected' cmp <(curl -s "$here$tile") <(curl -s "$here$tile")
check 'the log says so' at_least "$(logged 'disk cache.*not kept')" 1
check 'the counter counts' at_least "$(metric disk_cache_failed_total)" 1
finish

row 'the log says `requests … did not succeed`, and cold tiles get 503'
far_nginx
cp "$work/toy.tiles" "$work/far/far.tiles"
XDG_CACHE_HOME=$work/cache store=$far/far.tiles serve 1 0 --cache-mb 1 --deadline-s 2
here=http://127.0.0.1:${ports[1]}
kept=$(first_tile)
status "$here$kept" >"$work/null"
kill "${pids[8]}"
wait "${pids[8]}" 2>/dev/null
cold=$(curl -s "$here/d/toy/seed.ndjson" | sed -n 's|.*"url":"\([^"]*\)".*|/d/toy/\1|p' | tail -1)
check 'a cold tile is a 503' is "$(status "$here$cold")" 503
check 'the log names the server of the store' at_least "$(logged "did not succeed.*${far##*:}|${far##*:}.*did not succeed")" 1
check 'a kept tile is served' is "$(status "$here$kept")" 200
far_nginx_again() { PATH=$PATH:/usr/sbin nginx -p "$work/far" -c "$work/far.conf" & pids[8]=$!; await "$far/"; }
far_nginx_again
sleep 1.5 # for a second no request is sent there
check 'it answers again, and so does this one' is "$(status --retry 3 --retry-all-errors "$here$cold")" 200
finish

row 'many 429'
begin --client-tiles-s 0.2
codes() { curl -s "$here/d/toy/seed.ndjson?f=drc" | sed -n "s|.*\"url\":\"\([^\"]*\)\".*|$here/d/toy/\1|p" | xargs -n 1 curl -s -o /dev/null -w '%{http_code}\n' "$@" | sort | uniq -c; }
check 'one client asks for more than its share' at_least "$(codes -H 'X-Forwarded-For: 192.0.2.1' | awk '$2 == 429 { print $1 }')" 1
check 'the counter says limited' at_least "$(curl -s "$admin/metrics" | sed -n 's/^citysplat_jobs_total{kind="tile",outcome="limited"} //p')" 1
check 'the log has the client' at_least "$(logged '429.*192\.0\.2\.1|192\.0\.2\.1.*429')" 1
finish
begin --trusted-proxy 192.0.2.9
status -H 'X-Forwarded-For: 192.0.2.1' "$here$(first_tile)" >"$work/null"
check 'a proxy that is not named: the log says so' at_least "$(logged 'trusted-proxy')" 1
finish

row 'many 503'
"$city" "$work/large.tiles" 400000 || exit 1 # a quick machine has a small city within the deadline
put toy "$work/large.tiles"
begin --workers 1 --deadline-s 0.1
check 'a crowd of cold tiles' at_least "$(for f in sog drc compressed.ply; do curl -s "$here/d/toy/seed.ndjson?f=$f"; done | sed -n "s|.*\"url\":\"\([^\"]*\)\".*|$here/d/toy/\1|p" |
    xargs -P 40 -n 1 curl -s -o /dev/null -w '%{http_code} %header{retry-after}\n' | grep -cE '^50[34]')" 1
check 'the counters say shed or timeout' at_least "$(curl -s "$admin/metrics" | awk '/^citysplat_jobs_total.*outcome="(shed|timeout)"/ { n += $2 } END { print n + 0 }')" 1
finish

row '`/readyz` says `memory`'
# of the large city of the row before
begin --memory 4G
vast=$(first_tile ply)
prlimit --pid "${pids[1]}" --as="$(($(awk '/^VmSize/ { print $2 }' "/proc/${pids[1]}/status") * 1024 + 4000000)):"
check 'what does not fit is a 503' is "$(status "$here$vast")" 503
check 'readiness says memory' at_least "$(ready | grep -c '"memory"')" 1
check 'the log says so' at_least "$(logged 'out of memory')" 1
prlimit --pid "${pids[1]}" --as=unlimited:
check 'with more it is there' is "$(status --retry 3 --retry-all-errors "$here$vast")" 200
check 'held and budget are there to compare' at_least "$(awk -v a="$(metric memory_held_bytes)" -v b="$(metric memory_budget_bytes)" 'BEGIN { print (a > 0 && b > a) }')" 1
finish
put toy

row 'one request failed'
begin
curl -s -D "$work/head" -o "$work/problem" "$here/d/nobody/tileset.json"
id=$(sed -n 's/.*"request_id": *"\([^"]*\)".*/\1/p' "$work/problem")
check 'the problem has an id' test -n "$id"
check 'the head has it' at_least "$(grep -ci "x-request-id: $id" "$work/head")" 1
check 'the log has it' at_least "$(logged "$id")" 1

row 'clients get `no server answers`'
front_nginx nginx.conf 1 -e "s|127.0.0.1:8080|127.0.0.1:${ports[1]}|" -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" -e '1i access_log off;'
status "$url/d/toy/style.json" >"$work/null"
check 'the log of nginx says nothing yet' is "$(grep -c 'connect() failed' "$work/nginx/error.log")" 0
port=${ports[1]}
finish
check 'they get it' at_least "$(curl -s "$url/d/toy/map.json" | grep -c 'no server answers')" 1
check 'the log of nginx names the server' at_least "$(grep -c "connect() failed.*127.0.0.1:$port" "$work/nginx/error.log")" 1
store=$work/stores serve 1 "$port"
here=http://127.0.0.1:$port
check 'started again, all is there' is "$(status --retry 3 --retry-all-errors "$url/d/toy/map.json")" 200

row 'a name gets no answer at all'
check 'another name than the one in the configuration' is "$(status -H 'Host: www.splats.example.org' "$url/healthz")" 000
check 'its own name' is "$(status -H 'Host: splats.example.org' "$url/healthz")" 200

row 'maps or styles name `http://`, or another host'
check 'behind something that says neither' at_least "$(curl -s -H 'Host: inside' "$here/d/toy/style.json" | grep -c 'http://inside')" 1
kill "${pids[1]}"
wait "${pids[1]}" 2>/dev/null
store=$work/stores serve 1 "$port" --public-url https://splats.example.org
check 'with --public-url it is the name that clients see' is "$(curl -s -H 'Host: inside' "$here/d/toy/style.json" | grep -oE 'https?://(inside|splats[^/"]*)' | sort -u)" https://splats.example.org

row 'a new city is not seen'
old=$(curl -s "$url/d/toy/tileset.json?seen" | grep -oE '[0-9a-f]{12}-[0-9a-f]{8}' | head -1)
"$city" "$work/next.tiles" 2100 || exit 1
put toy "$work/next.tiles"
check 'without a reload it is the old one' is "$(revision)" "${old%-*}"
kill -HUP "${pids[1]}"
for _ in $(seq 100); do [ "$(revision)" = "${old%-*}" ] || break; sleep 0.05; done
check '/version has the new one' test "$(revision)" != "${old%-*}"
check 'a cache may have the old document for a minute' is "$(curl -s "$url/d/toy/tileset.json?seen" | grep -c "$old")" 1
check 'and the old tiles are served' is "$(status "$here/d/toy/r/$old/tileset.json")" 200
finish

row 'browsers say that the certificate is not valid'
short() { openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days "$1" -subj /CN=localhost -keyout "$work/tls.key" -out "$work/tls.pem" 2>"$work/null"; }
short 3
begin --tls-cert "$work/tls.pem" --tls-key "$work/tls.key"
check 'the log warns two weeks before' at_least "$(logged 'expires')" 1
check 'the gauge has the days' at_most "$(metric certificate_days_left | cut -d. -f1)" 3
check '--check prints the date' at_least "$("$bin" serve "$work/stores" --tls-cert "$work/tls.pem" --tls-key "$work/tls.key" --check 2>&1 | grep -c "$(date -d '+3 days' +%Y-%m-%d)\|$(date -u -d '+3 days' +%Y-%m-%d)")" 1
short 90
check 'renewed, and a reload: new connections have it' is "$(reload; openssl s_client -connect "127.0.0.1:${ports[1]}" </dev/null 2>"$work/null" | openssl x509 -noout -checkend 2592000)" "$(printf '200Certificate will not expire')"
check 'the gauge has it' at_least "$(metric certificate_days_left | cut -d. -f1)" 88
finish
exit $failed
