#!/bin/sh
# lab/study.sh: parses, lists its studies, and a dry run of all of them names every row once with a command
# that the program's own options allow. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
cd "$(dirname "$0")/../.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-study-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }

bash -n lab/study.sh || fail "lab/study.sh does not parse"
export CITYSPLAT_BUILD=$(dirname "$bin") STUDY_OUT="$work/out" STUDY_RUNS="$work/runs"
lab/study.sh nosuch >"$work/log" 2>&1 && fail "an unknown study is taken"
grep -q "no study 'nosuch'" "$work/log" || fail "an unknown study is not named"
lab/study.sh --dry-run all >"$work/rows" 2>"$work/log" || fail "dry run: $(tail -1 "$work/log")"
[ ! -e "$work/out" ] || fail "a dry run makes files"
for study in $(lab/study.sh --list); do
    cut -f1 "$work/rows" | grep -qx "$study" || fail "study $study has no row"
done
twice=$(cut -f1,2 "$work/rows" | sort | uniq -d)
[ -z "$twice" ] || fail "rows of the same name: $twice"

# Every option of every row is one that its command knows: --print-config checks names and ranges. Commands that
# differ in numbers and scenes alone are tried once.
cut -f3 "$work/rows" | tr ';' '\n' | sed 's/^ *//; s/ *$//' |
    awk '{ key = $2; for (i = 4; i <= NF; i++) if ($i !~ /^[0-9]/) key = key " " $i } !seen[key]++' >"$work/commands"
[ "$(wc -l <"$work/commands")" -gt 12 ] || fail "the dry run names only $(wc -l <"$work/commands") commands"
while read -r program command options; do
    case $program in
    citysplat) program=$bin ;;
    citysplat-lab) program=$bin-lab ;;
    *) fail "not a command of ours: $program $command" ;;
    esac
    # shellcheck disable=SC2086 # options are words
    "$program" "$command" $options --print-config >/dev/null 2>"$work/log" </dev/null ||
        fail "$command $options: $(cat "$work/log")"
done <"$work/commands"

# A recorded row is not run again, one of another command is. Records of before the laboratory spell commands otherwise.
row=$(head -1 "$work/rows")
study=$(printf '%s' "$row" | cut -f1) name=$(printf '%s' "$row" | cut -f2) command=$(printf '%s' "$row" | cut -f3)
mkdir -p "$work/runs"
"$bin-lab" study-record "$work/runs/$study.jsonl" --study "$study" --row "$name" --command "$command" --set psnr_db=30 || fail record
lab/study.sh --dry-run "$study" 2>/dev/null | cut -f2 | grep -qx "$name" && fail "a recorded row is done again"
"$bin-lab" study-record "$work/runs/$study.jsonl" --study "$study" --row "$name" --command other --set psnr_db=30 || fail record
[ "$(grep -c "\"row\":\"$name\"" "$work/runs/$study.jsonl")" = 1 ] || fail "recording again does not replace"
lab/study.sh --dry-run "$study" 2>/dev/null | cut -f2 | grep -qx "$name" || fail "a changed row is not done again"
older=$(printf '%s' "$command" | sed 's/citysplat-lab eval-photographs/citysplat eval/')
[ "$older" != "$command" ] || fail "the first row is not one that older records spell otherwise: $command"
"$bin-lab" study-record "$work/runs/$study.jsonl" --study "$study" --row "$name" --command "$older" --set psnr_db=30 || fail record
lab/study.sh --dry-run "$study" 2>/dev/null | cut -f2 | grep -qx "$name" && fail "a row recorded in the older spelling is done again"
echo "ok: $(wc -l <"$work/rows") rows"
