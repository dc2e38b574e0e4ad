#!/usr/bin/env bash
# configs/haproxy.cfg and configs/Caddyfile with the real programs, over three servers: tiles come by TLS, addresses are
# ours and https whatever a stranger says, metrics stay inside, one server killed under load is not noticed, and without a
# server clients learn when to come again.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
need openssl openssl
PATH=$PATH:/usr/sbin
command -v haproxy >/dev/null || command -v caddy >/dev/null || skip "neither haproxy nor caddy: Debian's packages of that name have them"
site=splats.example.org evil=evil.example
front_certificate

addresses() { grep -oE 'https?://[^/"<> ]*' | grep -vE 'www.opengis.net|www.w3.org|schemas.opengis.net' | sort -u; }
look_at() { # NAME: it answers at $url
    local name=$1 n=0 how path got
    check "$name answers" await "$url/healthz" "${known[@]}"
    rev=$(revision) tile=$(tiles | head -1)
    check "$name: a tile" cmp <(curl -s "${known[@]}" "$url$tile") <(curl -s "http://127.0.0.1:${ports[1]}$tile")
    check "$name: HTTP/2" is "$(curl -s "${known[@]}" -o /dev/null -w '%{http_version}' "$url$tile")" 2
    check "$name: metrics are not for the public" is "$(status "${known[@]}" "$url/metrics"; status "${known[@]}" --path-as-is "$url/%6detrics")" 404404
    for how in "target https://$evil" "Host $evil" "X-Forwarded-Host $evil" "X-Forwarded-Proto http"; do
        n=$((n + 1))
        path=/d/toy/style.json?stranger=$n
        case $how in
            target*) got=$(curl -s "${known[@]}" --http1.1 --request-target "${how#target }$path" "$url/") ;;
            *) got=$(curl -s "${known[@]}" -H "${how%% *}: ${how#* }" "$url$path") ;;
        esac
        case $how in
            target* | Host*) check "$name: $how: no document" is "$(echo "$got" | grep -c '"version"')" 0 ;;
            *) check "$name: $how: our addresses alone" is "$(echo "$got" | addresses | sed 's|:[0-9]*$||')" "https://$site" ;;
        esac
    done
    tiles | sed -n '30,$p' | sed "s|^|$url|" >"$work/list"
    (sleep 0.15; kill -9 "${pids[2]}") &
    got=$(xargs -P 8 -n 1 curl -s "${known[@]}" -o /dev/null -w '%{http_code}\n' <"$work/list" | sort | uniq -c | tr -s ' ')
    check "$name: one of three killed, nobody notices" is "$got" " $(wc -l <"$work/list") 200"
    kill -9 "${pids[1]}" "${pids[3]}"
    check "$name: no server: 503" is "$(status "${known[@]}" --max-time 8 "$url$tile")" 503
    check "$name: when to come again" is "$(header "$url$tile" Retry-After "${known[@]}")" 2
    check "$name: pages of others may read it" is "$(header "$url$tile" Access-Control-Allow-Origin "${known[@]}")" '*'
    kill "${pids[4]}"
    wait "${pids[4]}" 2>/dev/null
}
begin() { # three servers, and a free port for what stands in front
    local i
    for i in 1 2 3; do serve $i 0; done
    front=$(free_port) url=https://$site:$front known=(--cacert "$work/splats.pem" --resolve "$site:$front:127.0.0.1")
}

if command -v haproxy >/dev/null; then
    begin
    cat "$work/splats.pem" "$work/splats.key" >"$work/both.pem"
    sed -e "s|bind :443|bind 127.0.0.1:$front|" -e "s|/etc/ssl/splats.pem|$work/both.pem|" -e "s|8081|${ports[1]}|" -e "s|8082|${ports[2]}|" \
        -e "s|8083|${ports[3]}|" "$root/configs/haproxy.cfg" >"$work/haproxy.cfg"
    haproxy -db -f "$work/haproxy.cfg" >"$work/haproxy.out" 2>&1 &
    pids[4]=$!
    look_at haproxy
else
    echo 'not looked at: configs/haproxy.cfg, without haproxy'
fi
if command -v caddy >/dev/null; then
    begin
    # Without its own certificates, which need the name on the Internet, and without its port of administration.
    { printf '{\n\tadmin off\n\tauto_https disable_redirects\n}\n'
      sed -e "s|^$site {|&\n\ttls $work/splats.pem $work/splats.key\n\tbind 127.0.0.1|" -e "s|^$site|$site:$front|" \
          -e "s|127.0.0.1:8080|127.0.0.1:${ports[1]} 127.0.0.1:${ports[2]} 127.0.0.1:${ports[3]}|" "$root/configs/Caddyfile"; } >"$work/Caddyfile"
    HOME=$work XDG_DATA_HOME=$work XDG_CONFIG_HOME=$work caddy run --config "$work/Caddyfile" --adapter caddyfile >"$work/caddy.out" 2>&1 &
    pids[4]=$!
    look_at caddy
else
    echo 'not looked at: configs/Caddyfile, without caddy'
fi
exit $failed
