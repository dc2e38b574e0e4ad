#!/usr/bin/env bash
# hour.sh [SECONDS]: an hour (3600) of everything on one server: tiles of every form, pictures, map tiles, questions, streams,
# documents, nonsense, a reload every five seconds. Its store is replaced each minute, and the process that draws is killed
# each five; where it takes less than that, a tenth and a fifth of the time lie between them.
#
# No answer is 5xx but those of a picture or question while that process starts again; the others are what was asked for,
# or a refusal of what was asked for wrongly. Memory and descriptors are as in the middle third in the last.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need curl curl
seconds=${1:-3600}
replace_s=$((seconds >= 600 ? 60 : seconds / 10)) kill_s=$((seconds >= 1500 ? 300 : seconds / 5))
again_s=15 # of a process that draws, on a machine that is busy
mkdir "$work/stores" "$work/disk" "$work/state"
cp "$work/toy.tiles" "$work/stores/"
store=$work/stores serve 1 0 --device auto --memory 512M --cache-mb 16 --cache-dir "$work/disk" --cache-dir-mb 64 --state-dir "$work/state" \
    --client-tiles-s 0 --client-views-s 0 --admin 127.0.0.1:0 --no-access-log
pid=${pids[1]} url=http://127.0.0.1:${ports[1]}
admin=http://127.0.0.1:$(sed -n 's/.*operators: port \([0-9]*\).*/\1/p' "$work/1.out")
for _ in $(seq 240); do # the device draws, its kernels are compiled
    drawn=$(status -L --max-time 60 "$url/d/toy/static/13.4,52.5,90@0,-90/64x48.jpg")
    [ "$drawn" != 200 ] || break
    sleep 0.5
done
[ "$drawn" = 200 ] || skip 'there is no OpenCL device'
replace() { "$city" "$work/next.tiles" "$1" && mv "$work/next.tiles" "$work/stores/toy.tiles"; } # each NUMBER is another revision
# As many revisions as a server keeps: descriptors and memory are those of a server that runs for long.
for n in $(seq 9); do
    replace $((3000 + n))
    status -X POST "$admin/-/reload" >"$work/null"
done
end=$((SECONDS + seconds))

# ---- what is asked for

# ask KIND [CURL OPTIONS]: the addresses on stdin over one connection; a line "KIND STATUS BEGUN ENDED" each
ask() {
    local kind=$1 from=$EPOCHREALTIME
    shift
    sed 's|.*|url = "&"\noutput = "/dev/null"|' | curl -s -g --max-time 60 -K - -w '%{http_code}\n' "$@" >"$work/codes.$kind"
    sed "s|.*|$kind & $from $EPOCHREALTIME|" "$work/codes.$kind" >>"$work/answers.$kind"
}
places() { curl -s "$url/d/toy/seed.ndjson?f=$1" | sed -n 's|.*"url":"\([^"]*\)".*|\1|p'; } # with the revision of now
near() { awk -v n="$1" -v seed="$RANDOM" 'BEGIN { srand(seed); for (i = 0; i < n; i++) printf "%.5f %.5f %d %d\n", 13.4 + (rand() - 0.5) / 500, 52.5 + (rand() - 0.5) / 500, 80 + rand() * 300, rand() * 360 }'; }
ways() { # of asking
    case $1 in
        tiles)
            for f in glb spz drc sog ply; do places $f | shuf -n 4 | sed "s|^|$url/d/toy/|"; done | ask tiles ;;
        maps)
            places glb | shuf -n 4 | sed -n "s|.*/t/\(.*\)\.glb|$url/d/toy/map/\1.jpg\n$url/d/toy/terrain/\1.png|p" | ask maps -L ;;
        pictures)
            near 4 | awk -v at="$url/d/toy/static" '{ printf "%s/%s,%s,%s@%s,-50/320x240.%s\n", at, $1, $2, $3, $4, NR % 2 ? "jpg" : "webp" }' | ask pictures -L ;;
        questions)
            near 6 | awk -v at="$url/d/toy/height" '{ printf "%s?lon=%s&lat=%s\n", at, $1, $2 }' | ask questions
            echo "$url/d/toy/measure" | ask questions -d '{"polygon": [[13.3998, 52.4999], [13.4002, 52.4999], [13.4, 52.5002]], "base": 30}' ;;
        documents)
            printf "$url%s\n" / /collections /collections/toy /version /readyz /api /d/toy/tileset.json /d/toy/style.json /d/toy/wmts.xml /d/toy/map.json |
                ask documents --compressed ;;
        nonsense)
            printf "$url%s\n" /d/nobody/tileset.json /d/toy/t/99/1/1.glb /%00 '/collections?bbox=1' /d/toy/static/x | ask nonsense
            curl -s -X PUT -o "$work/null" "$url/d/toy/appearances/x" -d '{' ;;
        streams)
            local at=$url/d/toy/motion/hour-0123456789abcdef-$RANDOM reader k
            curl -s -N --max-time 20 -o "$work/null" "$at" &
            reader=$!
            sleep 0.5
            for k in $(seq 12); do
                echo "$at" | ask streams -d "{\"number\": $k, \"still\": false, \"width\": 160, \"height\": 120, \"pose\": {\"lon\": 13.4, \"lat\": 52.5, \"height\": $((90 + k)), \"heading\": $k, \"pitch\": -60}}"
                sleep 0.2
            done
            kill $reader
            wait $reader 2>/dev/null ;;
    esac
}
client() { while [ $SECONDS -lt $end ]; do ways "$1"; sleep "${2:-0.2}"; done; }

# ---- what happens meanwhile

every() { # SECONDS: waits so long; false at the end of all
    local k
    for k in $(seq "$1"); do
        [ $SECONDS -lt $end ] || return 1
        sleep 1
    done
}
reloads() {
    while every 5; do
        echo "reload $(status -X POST "$admin/-/reload") $EPOCHREALTIME $EPOCHREALTIME" >>"$work/answers.reloads"
    done
}
replaces() {
    local n=0
    while every "$replace_s"; do
        n=$((n + 1))
        replace $((2000 + n)) && echo $n >"$work/replaced"
    done
}
drawing() { cat "/proc/$pid"/task/*/children 2>/dev/null | tr ' ' '\n' | sort -u | while read -r p; do grep -aqs draw-for-serve "/proc/$p/cmdline" && echo "$p"; done; }
kills() {
    local p
    while every "$kill_s"; do
        for p in $(drawing); do kill -9 "$p" && echo "$EPOCHREALTIME" >>"$work/killed"; done
    done
}
# Each second: descriptors, and memory of both processes in kB.
watches() {
    local p
    while [ $SECONDS -lt $end ]; do
        for p in $pid $(drawing); do awk '/^RssAnon|^RssShmem/ { n += $2 } END { print n + 0 }' "/proc/$p/status" 2>/dev/null; done |
            awk -v fds="$(find "/proc/$pid/fd" -mindepth 1 2>/dev/null | wc -l)" '{ n += $1 } END { print fds, n }' >>"$work/state.log"
        sleep 1
    done
}

workers=()
for job in 'client tiles' 'client maps' 'client pictures' 'client questions' 'client documents' 'client nonsense 1' 'client streams' reloads replaces kills watches; do
    $job & workers+=($!)
done
for w in "${workers[@]}"; do wait "$w"; done 2>/dev/null

# ---- what came of it

sort "$work"/answers.* | awk '{ n[$1 " " $2]++ } END { for (k in n) print k, n[k] }' | sort | paste -sd ';'
most() { # COLUMN of the state in the THIRD
    awk -v c="$1" -v third="$2" '{ v[NR] = $c } END { for (i = int(NR * (third - 1) / 3) + 1; i <= int(NR * third / 3); i++) if (v[i] > m) m = v[i]; print m + 0 }' "$work/state.log"
}
fds_then=$(most 1 2) fds=$(most 1 3) kb_then=$(most 2 2) kb=$(most 2 3)
echo "$seconds s: replaced $(cat "$work/replaced") times, killed $(wc -l <"$work/killed") times; descriptors $fds_then -> $fds, memory $kb_then -> $kb kB"
# A 5xx is asked for by a kill if its request was under way then, or began before the next process was there.
touch "$work/killed"
unasked=$(cat "$work"/answers.* | awk -v again="$again_s" 'NR == FNR { at[NR] = $1; next }
    $2 >= 500 || $2 == 0 { for (k in at) if ($1 ~ /^(pictures|maps|questions|streams)$/ && $4 >= at[k] && $3 <= at[k] + again) next; print }' "$work/killed" - | tee "$work/unasked" | wc -l)
head -5 "$work/unasked"
refused=$(cat "$work"/answers.* | awk '$2 >= 400 && $2 < 500 && $1 != "nonsense" && !($1 == "streams" && $2 == 404)' | wc -l)
for kind in tiles maps pictures questions documents nonsense streams reloads; do check "answers of $kind" at_least "$(cat "$work/answers.$kind" | wc -l)" 5; done
check 'no 5xx but those of a kill' is "$unasked" 0
check 'nothing that is there was refused' is "$refused" 0
check 'nonsense was refused' is "$(awk '$2 < 400' "$work/answers.nonsense" | wc -l)" 0
check 'reloads went well' is "$(awk '$2 != 200' "$work/answers.reloads" | wc -l)" 0
check 'stores were replaced' at_least "$(cat "$work/replaced")" 3
check 'the process that draws was killed' at_least "$(wc -l <"$work/killed")" 2
check 'descriptors are flat' at_most "$fds" "$((fds_then + 8))"
check 'memory is flat' at_most "$kb" "$((kb_then * 110 / 100 + 8000))"
for _ in $(seq 150); do curl -s "$admin/readyz" | grep -q '"ready"' && break; sleep 0.2; done
check 'it is ready' is "$(curl -s "$admin/readyz" | grep -c '"ready"')" 1
kill "$pid"
wait "$pid"
check 'it stops in order' is $? 0
exit $failed
