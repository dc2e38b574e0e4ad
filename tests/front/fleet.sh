#!/usr/bin/env bash
# Three servers without data of their own, behind nginx with consistent hashing; their store lies at another nginx. One is
# killed under load, and comes back warm. Another revision of the store rolls out: no answer has bytes of another revision
# than its address says, and in the end all have the new one.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need nginx nginx-light
need curl curl
far_nginx
cp "$work/toy.tiles" "$work/far/toy.tiles"
"$city" "$work/next.tiles" 2100 || exit 1

# What is right: the tiles of both revisions, as a server of the file gives them.
wanted() { # FILE: lines "path sum" of a view's tiles, and of others
    store=$1 serve 1 0
    rev=$(revision)
    tiles | awk 'NR % 4 == 1' >"$work/paths"
    fetch_all "$work/bodies" <"$work/paths"
    paste -d ' ' "$work/paths" <(sums "$work/bodies" "$(wc -l <"$work/paths")")
    kill "${pids[1]}"
    wait "${pids[1]}" 2>/dev/null
}
wanted "$work/next.tiles" >"$work/want.new"
new=$rev
wanted "$work/toy.tiles" >"$work/want.old"
old=$rev
cat "$work"/want.* >"$work/want"
check 'two revisions' test "$old" != "$new"

store=$far/toy.tiles
for i in 1 2 3; do serve $i 0 --cache-dir "$work/cache$i" --cache-policy '*=1' --remote-refresh-s 0.5; done
servers=$(for i in 1 2 3; do echo "server 127.0.0.1:${ports[i]};"; done | tr '\n' ' ')
# A server that has not noticed the new revision yet does not know its tiles: the next one is asked.
front_nginx nginx.conf 1 -e "s|server 127.0.0.1:8080;|$servers|" -e "s|/var/cache/nginx/citysplat|$work/nginx/cache|" \
    -e '1i access_log off;' -e 's|proxy_cache citysplat;|&\n    proxy_next_upstream error timeout http_404 http_503;|'

# shellcheck disable=SC2016 # of the inner shell
got() { # FILE-OF-PATHS: lines "path status sum"
    nl -ba -w1 -s' ' "$1" | xargs -P 4 -n 2 sh -c 'code=$(curl -s -o "$1.$2" -w "%{http_code}" "$0$3")
        echo "$3 $code $(sha256sum <"$1.$2" | cut -d" " -f1)"; rm -f "$1.$2"' "$url" "$work/body"
}
wrong() { # lines of got: how many are 200 with other bytes than the revision has
    awk 'NR == FNR { want[$1] = $2; next } $2 == 200 && want[$1] != $3 { n++ } END { print n + 0 }' "$work/want" -
}

cut -d' ' -f1 "$work/want.old" >"$work/old"
cut -d' ' -f1 "$work/want.new" >"$work/new"
(sleep 0.2; kill -9 "${pids[2]}") &
killer=$!
got "$work/old" >"$work/got"
wait $killer
check 'one of three is killed, nobody notices' is "$(cut -d' ' -f2 "$work/got" | sort | uniq -c | tr -s ' ')" " $(wc -l <"$work/old") 200"
check 'every tile is that of the file' is "$(wrong <"$work/got")" 0
parts() { grep -c '" 206 ' "$work/far/log"; } # the others ask only whether the store is the same
before=$(parts)
serve 2 "${ports[2]}" --cache-dir "$work/cache2" --cache-policy '*=1' --remote-refresh-s 0
check 'it is back with one request' is $(($(parts) - before)) 1
kill "${pids[2]}"
wait "${pids[2]}" 2>/dev/null
serve 2 "${ports[2]}" --cache-dir "$work/cache2" --cache-policy '*=1' --remote-refresh-s 0.5

# Views are asked for all the time while the new revision comes.
cp "$work/next.tiles" "$work/far/part"
mv "$work/far/part" "$work/far/toy.tiles"
all=0 views=0 bad=0
for _ in $(seq 40); do
    now=$(curl -s "$url/d/toy/tileset.json" | grep -o "$old\|$new" | sort -u)
    case $now in "$old") paths=$work/old ;; "$new") paths=$work/new ;; *) bad=$((bad + 1)); continue ;; esac
    awk 'NR % 3 == 1' "$paths" >"$work/view"
    bad=$((bad + $(got "$work/view" | tee "$work/got" | wrong)))
    views=$((views + 1))
    all=0
    for i in 1 2 3; do curl -s "http://127.0.0.1:${ports[i]}/version" | grep -q "$new" && all=$((all + 1)); done
    [ "$all" = 3 ] && [ "$now" = "$new" ] && break
    sleep 0.2
done
check 'all have the new revision' is "$all" 3
check "no view of $views has two, or other bytes than it should" is "$bad" 0
check 'a view of the new revision is whole' is "$(cut -d' ' -f2 "$work/got" | sort -u)" 200
exit $failed
