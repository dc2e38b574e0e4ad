#!/usr/bin/env bash
# test_differ.sh [REQUESTS [SEED]]: generated requests to `citysplat serve` and to nginx with the same bytes as files; both
# answers are compared (differ.mjs), and each difference must be argued in differ_table.mjs.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need nginx nginx-light
need curl curl
need node nodejs
need pkg-config pkg-config
serve 1 0 --client-tiles-s 0 --header-timeout-s 2 --body-timeout-s 2 --idle-timeout-s 3 --no-access-log
rev=$(revision)
place=$(curl -s "http://127.0.0.1:${ports[1]}/d/toy/seed.ndjson" | sed -n '1s|.*/t/\([0-9/]*\)\..*|\1|p')
tile=/d/toy/r/$rev/t/$place.glb document=/d/toy/r/$rev/tileset.json
for path in "$tile" "$document"; do
    mkdir -p "$work/files${path%/*}"
    curl -s "http://127.0.0.1:${ports[1]}$path" -o "$work/files$path"
done
front=$(free_port)
{
    [ "$(id -u)" != 0 ] || echo 'user root;'
    printf 'daemon off;\nworker_processes 1;\npid %s/pid;\nerror_log %s/error.log;\nevents { worker_connections 512; }\nhttp {\n' "$work" "$work"
    for d in client_body proxy fastcgi uwsgi scgi; do printf '%s_temp_path %s/%s;\n' $d "$work" $d; done
    printf 'access_log off;\nclient_header_timeout 2s;\nclient_body_timeout 2s;\nkeepalive_timeout 3s;\n'
    printf 'types { application/json json; model/gltf-binary glb; }\n'
    printf 'gzip on;\ngzip_types application/json;\ngzip_min_length 0;\ngzip_http_version 1.0;\ngzip_vary on;\n'
    printf 'server { listen 127.0.0.1:%s; root %s/files; }\n}\n' "$front" "$work"
} >"$work/nginx.conf"
PATH=$PATH:/usr/sbin nginx -p "$work" -c "$work/nginx.conf" &
pids[4]=$!
check 'nginx answers' await "http://127.0.0.1:$front/"
check 'both answer alike, or differ for a reason' node "$(dirname "$0")/differ.mjs" "${ports[1]}" "$front" "$tile" "$document" "$(pkg-config --modversion libmicrohttpd)" "${1:-1500}" "${2:-1}"
exit $failed
