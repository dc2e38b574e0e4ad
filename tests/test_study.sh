#!/bin/sh
# studies/study.sh: parses, lists its studies, and a dry run of all of them names every row once with a command
# that the program's own options allow. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
cd "$(dirname "$0")/.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-study-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }

bash -n studies/study.sh || fail "studies/study.sh does not parse"
export CITYSPLAT_BUILD=$(dirname "$bin") STUDY_OUT="$work/out" STUDY_RUNS="$work/runs"
studies/study.sh nosuch >"$work/log" 2>&1 && fail "an unknown study is taken"
grep -q "no study 'nosuch'" "$work/log" || fail "an unknown study is not named"
studies/study.sh --dry-run all >"$work/rows" 2>"$work/log" || fail "dry run: $(tail -1 "$work/log")"
[ ! -e "$work/out" ] || fail "a dry run makes files"
for study in $(studies/study.sh --list); do
    cut -f1 "$work/rows" | grep -qx "$study" || fail "study $study has no row"
done
twice=$(cut -f1,2 "$work/rows" | sort | uniq -d)
[ -z "$twice" ] || fail "rows of the same name: $twice"

# Every option of every row is one that its command knows: --print-config checks names and ranges. Commands that
# differ in numbers and scenes alone are tried once.
cut -f3 "$work/rows" | tr ';' '\n' | sed 's/^ *//; s/ *$//' |
    awk '{ key = $2; for (i = 4; i <= NF; i++) if ($i !~ /^[0-9]/) key = key " " $i } !seen[key]++' >"$work/commands"
[ "$(wc -l <"$work/commands")" -gt 12 ] || fail "the dry run names only $(wc -l <"$work/commands") commands"
while read -r program command scene options; do
    [ "$program" = citysplat-bench ] && continue
    [ "$program" = citysplat ] || fail "not a citysplat command: $program $command"
    # shellcheck disable=SC2086 # options are words
    "$bin" "$command" "$scene" $options --print-config >/dev/null 2>"$work/log" </dev/null ||
        fail "$command $options: $(cat "$work/log")"
done <"$work/commands"

# A recorded row is not run again, one of another command is.
row=$(head -1 "$work/rows")
study=$(printf '%s' "$row" | cut -f1) name=$(printf '%s' "$row" | cut -f2) command=$(printf '%s' "$row" | cut -f3)
mkdir -p "$work/runs"
"$(dirname "$bin")/citysplat-study" record "$work/runs/$study.jsonl" --study "$study" --row "$name" --command "$command" --set psnr_db=30 || fail record
studies/study.sh --dry-run "$study" 2>/dev/null | cut -f2 | grep -qx "$name" && fail "a recorded row is done again"
"$(dirname "$bin")/citysplat-study" record "$work/runs/$study.jsonl" --study "$study" --row "$name" --command other --set psnr_db=30 || fail record
[ "$(grep -c "\"row\":\"$name\"" "$work/runs/$study.jsonl")" = 1 ] || fail "recording again does not replace"
studies/study.sh --dry-run "$study" 2>/dev/null | cut -f2 | grep -qx "$name" || fail "a changed row is not done again"
echo "ok: $(wc -l <"$work/rows") rows"
