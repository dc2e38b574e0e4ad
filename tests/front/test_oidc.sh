#!/usr/bin/env bash
# configs/nginx_oidc.conf with the real nginx: people whose JSON Web Token an identity service accepts see a private
# city, nobody else does, and signed addresses and sessions work behind the proxy.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need nginx nginx-light
need curl curl
need node nodejs
own=a-token-of-nginx-alone
sha=$(printf %s $own | sha256sum | cut -d' ' -f1)
echo "{\"keys\": {\"k\": \"a key of this test alone, 32 characters\"}, \"tokens\": [{\"sha256\": \"$sha\", \"scope\": [\"read:toy\", \"render:toy\"]}]}" >"$work/auth.jsonc"
chmod 600 "$work/auth.jsonc"
serve 1 0 --auth "$work/auth.jsonc"
mkdir -p "$work/id"
node "$(dirname "$0")/identity.mjs" "$work/id" &
pids[3]=$!
for _ in $(seq 200); do [ -e "$work/id/port" ] && break; sleep 0.05; done
front_nginx nginx_oidc.conf 1 -e "s|127.0.0.1:8080|127.0.0.1:${ports[1]}|" \
    -e "s|127.0.0.1:4180|127.0.0.1:$(cat "$work/id/port")|" -e "s|TOKEN-OF-VIEWERS|$own|" -e "s|/var/log/nginx|$work/nginx|" \
    -e 's|X-Forwarded-Proto $scheme|X-Forwarded-Proto https|'
there=/d/toy/tileset.json
bearer() { cat "$work/id/$1"; }

check 'a token that holds' is "$(status -H "Authorization: Bearer $(bearer good)" "$url$there")" 200
check 'what moves is private' is "$(header "$url$there" Cache-Control -H "Authorization: Bearer $(bearer good)" | cut -d, -f1)" private
for wrong in late elsewhere none hmac; do
    check "a token that does not: $wrong" is "$(status -H "Authorization: Bearer $(bearer $wrong)" "$url$there")" 401
done
check 'another group' is "$(status -H "Authorization: Bearer $(bearer other)" "$url$there")" 401
check 'the token of nginx from outside' is "$(status -H "Authorization: Bearer $own" "$url$there")" 401
check 'a header of groups from outside' is "$(status -H 'X-Auth-Request-Groups: VIEWERS' "$url$there")" 401
check 'nobody' is "$(status "$url$there")" 401
check 'a person is sent to sign in' is "$(header "$url/" Location -H 'Accept: text/html' | sed 's|.*\(/oauth2/.*\)|\1|')" '/oauth2/start?rd=/'
check 'the page to sign in' is "$(curl -s "$url/oauth2/start")" 'sign in here'

signed=$("$bin" sign toy --auth "$work/auth.jsonc" --url "$url") || exit 1
check 'a signed address needs no token' is "$(status "$signed${there#/}")" 200
check 'its maps lie below it, by https' is "$(curl -s "${signed}d/toy/map.json" -H 'Host: splats.example.org' | grep -c "\"https://splats.example.org/signed/k")" 1
check 'seed' "$bin" seed "${signed}d/toy" --rate 1000
check 'another signature' is "$(status "${signed%/}x/d/toy/tileset.json")" 403
sleep 0.3
check 'another name gets nothing' is "$(status -H 'Host: evil.example' "$signed${there#/}"; status --request-target "http://evil.example/signed/${signed##*/signed/}${there#/}" "$url/")" 000000
check "a client's X-Forwarded-Host goes no further" is "$(curl -s "${signed}d/toy/map.json" -H 'X-Forwarded-Host: evil.example' | grep -c evil)" 0
check 'logs of nginx have no signature' is "$(grep -c "${signed##*.}" "$work/nginx/citysplat.log")" 0
check 'they have the requests' at_least "$(grep -c 'GET /signed/-' "$work/nginx/citysplat.log")" 3
check 'a cookie goes by TLS alone' is "$(curl -s -D - -o /dev/null -d "token=$own" -H 'X-Forwarded-Proto: https' "http://127.0.0.1:${ports[1]}/session" | grep -ci '^set-cookie: citysplat=.*; Secure')" 1
exit $failed
