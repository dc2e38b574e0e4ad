#!/usr/bin/env bash
# kill.sh [ROUNDS]: a server under load is killed with SIGKILL at random moments, ROUNDS times (200). Each time it must
# be there again at once and give every tile with the bytes that it had before, and the store is sound.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
rounds=${1:-200}
serve 1 0
port=${ports[1]}
rev=$(revision)
url=http://127.0.0.1:$port
tiles | awk 'NR % 9 == 1' >"$work/paths"
n=$(wc -l <"$work/paths")
fetch() { # FILE: sums of all tiles, in their order
    fetch_all "$work/bodies" <"$work/paths"
    sums "$work/bodies" "$n" >"$1"
}
fetch "$work/want"
check 'every tile is there' is "$(find "$work/bodies" -size -2 -exec grep -l '^none$' {} + | wc -l)" 0
slowest=0 slowest_base=0 wrong=0 late=0
for round in $(seq "$rounds"); do
    xargs -a <(sed "s|^|$url|" "$work/paths") -P 4 -n 1 curl -s -o /dev/null --max-time 2 2>/dev/null &
    load=$!
    [ $((round % 5)) != 0 ] || kill -HUP "${pids[1]}"
    sleep "0.$((RANDOM % 30 + 10))"
    kill -9 "${pids[1]}"
    wait "${pids[1]}" 2>/dev/null
    wait $load
    start=${EPOCHREALTIME/./}
    serve 1 "$port"
    await "$url/healthz" || late=$((late + 1))
    ms=$(((${EPOCHREALTIME/./} - start) / 1000))
    base=${EPOCHREALTIME/./}
    "$bin" serve "$work/toy.tiles" --check >/dev/null # what the machine needs for this just now
    base=$(((${EPOCHREALTIME/./} - base) / 1000))
    [ "$base" -le $slowest_base ] || slowest_base=$base
    [ "$ms" -le $slowest ] || slowest=$ms
    fetch "$work/got"
    cmp -s "$work/want" "$work/got" || { wrong=$((wrong + 1)); diff "$work/want" "$work/got" | head -3; }
done 2>/dev/null
echo "$rounds times killed: back after $slowest ms at most (--check takes $slowest_base), $n tiles each time, $wrong times a wrong byte"
check 'it came back each time' is "$late" 0
check 'within a second more than --check takes' at_most "$slowest" $((slowest_base * 2 + 1000))
check 'every byte as before' is "$wrong" 0
check 'the store is sound' "$bin" verify "$work/toy.tiles"
check 'nothing is left beside it' is "$(find "$work" -name 'toy.tiles*' | wc -l)" 1
exit $failed
