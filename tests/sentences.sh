#!/bin/sh
# Sentences drawn at random, to be read by a person: FILE:LINE and the sentence. A page is plain enough when at most two
# of sixty need a second reading.
#
#   tests/sentences.sh [SEED [docs|headers|both [COUNT]]]     1, both and 60 when nothing is said
#
# docs: paragraphs, list items and longer cells of tables of all pages; code and tables made of records are left out.
# headers: comments of every header. The same seed and texts draw the same sentences.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
seed=${1:-1} from=${2:-both} count=${3:-60}
case $seed$count in *[!0-9]*) echo "sentences.sh: SEED and COUNT are whole numbers, not '$seed' and '$count'" >&2; exit 2 ;; esac
case $from in
    docs) set -- '*.md' ;;
    headers) set -- '*.h' ;;
    both) set -- '*.md' '*.h' ;;
    *) echo "sentences.sh: '$from' is neither docs nor headers nor both" >&2; exit 2 ;;
esac
git ls-files -- "$@" | grep -v '^docs/commands\.md$' | xargs awk -v least_words=5 -v least_cell_words=8 '
function cut(    text, at, k, rest) { # the block that was gathered, a sentence a line
    text = block; block = ""
    while (match(text, /[.!?:;][)"]? +[A-Z`*(\[]/)) {
        rest = substr(text, RSTART + RLENGTH - 1)
        say(substr(text, 1, RSTART + RLENGTH - 2)); text = rest
    }
    say(text)
}
function say(sentence, least,    words) {
    gsub(/^[ \t]+|[ \t]+$/, "", sentence)
    if (split(sentence, words, /[ \t]+/) >= (least ? least : least_words)) print name ":" line ": " sentence
}
function add(text) { if (block == "") { line = FNR; name = FILENAME } gsub(/^[ \t]+/, "", text); block = block (block == "" ? "" : " ") text }
FNR == 1 { if (block != "") cut(); fence = made = comment = 0 }
FILENAME ~ /\.h$/ {
    if (comment || match($0, /\/\*/)) {
        text = $0
        if (!comment) { sub(/^.*\/\*+</, "", text); sub(/^.*\/\*+/, "", text); comment = 1; if (block != "") cut() }
        done = match(text, /\*\//)
        sub(/\*\/.*/, "", text); sub(/^ *\*+ ?/, "", text)
        if (text ~ /^[ \t]*$/ || text ~ /SPDX/) { if (block != "") cut() } else add(text)
        if (done) { comment = 0; if (block != "") cut() }
    } else if (match($0, /\/\/ /)) {
        if ($0 !~ /^[ \t]*\/\// && block != "") cut()
        add(substr($0, RSTART + 3))
        if ($0 !~ /^[ \t]*\/\//) cut()
    } else if (block != "") cut()
    next
}
/^ *```/ { if (block != "") cut(); fence = !fence; next }
fence { next }
/^<!-- end/ { made = 0; next }
/^<!-- (table|figures)/ { made = 1 }
made || /^    / && block == "" || /^<|^!\[|^#/ { if (block != "") cut(); next }
/^ *\|/ {
    if (block != "") cut()
    n = split($0, cell, /\|/); name = FILENAME; line = FNR
    for (c = 1; c <= n; c++) say(cell[c], least_cell_words)
    next
}
/^[ \t]*$/ { if (block != "") cut(); next }
/^ *([-*]|[0-9]+\.) / { if (block != "") cut(); sub(/^ *([-*]|[0-9]+\.) /, "") }
{ add($0) }
END { if (block != "") cut() }' | awk -v seed="$seed" -v count="$count" '
function random() { x = x * 16807 % 2147483647; return x / 2147483647 } # Park and Miller 1988
{ all[NR] = $0 }
END {
    x = seed % 2147483646 + 1
    for (k = 0; k < 8; k++) random()
    if (count > NR) count = NR
    for (k = 1; k <= count; k++) { # the first steps of a shuffle
        j = k + int(random() * (NR - k + 1))
        drawn = all[j]; all[j] = all[k]; print drawn
    }
    print count " of " NR " sentences, seed " seed
}'
