#!/bin/sh
# The reference is what the program prints: docs/commands.md by `citysplat help --markdown`. The manual pages and the
# completions that cli/reference.sh makes are sound: every page passes `mandoc -Tlint`, bash completes for real, zsh and
# fish read theirs where they are installed. `help COMMAND` shows few options and `--help=all` all. The rules between
# options are kept. With --write docs/commands.md is made anew. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
cd "$(dirname "$0")/.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-reference-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }

"$bin" help --markdown >"$work/commands.md" || fail "citysplat help --markdown"
cli/reference.sh "$bin" "$work" || fail "cli/reference.sh"
commands=$(sed -n -e 's/^COMMAND(\([a-z]*\),.*/\1/p' -e 's/^COMMAND_AS([a-z_]*, "\([a-z-]*\)",.*/\1/p' cli/base/commands.def)
[ -n "$commands" ] || fail "cli/base/commands.def names no command"
[ "$1" != --write ] || cp "$work/commands.md" docs/commands.md || fail "not written"
again='CITYSPLAT_BIN=PROGRAM tests/test_reference.sh --write makes it anew'
diff -u docs/commands.md "$work/commands.md" || fail "docs/commands.md is not what the program prints: $again"

# A format that is none, and a command that is none, are errors of the command line.
for words in "train --help=html" "help --man nosuch" "completion ksh" "completion"; do
    # shellcheck disable=SC2086
    "$bin" $words >/dev/null 2>&1
    [ $? = 2 ] || fail "$words is taken"
done

if command -v mandoc >/dev/null; then
    # It looks for our own pages among those that are installed.
    mandoc -Tlint "$work/man1/"*.1 | grep -v 'referenced manual not found: Xr citysplat' >"$work/lint"
    [ ! -s "$work/lint" ] || { cat "$work/lint"; fail "mandoc -Tlint"; }
else
    echo "mandoc is not installed: the pages are not checked by it"
fi

# ---- two tiers, counted as they are seen: a line an option, with those of every command ----
shown() { grep -c '^  -'; } # options of a help text
total=0
for c in $commands; do
    everyday=$("$bin" help "$c" | shown)
    all=$("$bin" "$c" --help=all | shown)
    more=$("$bin" help "$c" | sed -n 's/^\([0-9]*\) more: .*/\1/p')
    case $c in train) most=25 ;; serve) most=20 ;; *) most=12 ;; esac
    [ "$everyday" -le $most ] || fail "help $c shows $everyday options, and $most is the most"
    [ $((everyday + ${more:-0})) = "$all" ] || fail "help $c shows $everyday, speaks of ${more:-0} more, and there are $all"
    total=$((total + all))
done

# ---- rules between options: both are refused or warned of, whichever is named first ----
refuses() { # WORDS COMMAND LINE...: exit 2 with these words
    words=$1
    shift
    "$bin" "$@" >"$work/out" 2>"$work/err"
    [ $? != 0 ] || fail "$* is taken"
    grep -q -- "$words" "$work/err" || { cat "$work/err"; fail "$*: lacks '$words'"; }
}
warns() {
    words=$1
    shift
    "$bin" "$@" >"$work/out" 2>"$work/err"
    grep -q -- "warn.*$words\|WARN.*$words\|$words" "$work/err" || { cat "$work/err"; fail "$*: lacks '$words'"; }
}
# Every row of the table is tried: a value that is not the default for "set", nothing for "unset".
tried=0
sample() { # COMMAND KEY STATE: the flag, from the table of the reference
    flag=$(printf '%s' "$2" | tr _ -)
    case $3 in
    unset) return ;;
    true) printf -- '--%s' "$flag"; return ;;
    false) printf -- '--no-%s' "$flag"; return ;;
    set) ;;
    *) printf -- '--%s=%s' "$flag" "$3"; return ;;
    esac
    case $flag in
    lpips-range) value=unit ;;
    depth-pass) value=soft ;;
    test-block) value=0.25 ;;
    cache-dir-mb) value=100 ;;
    *) value=7 ;;
    esac
    case $flag in gcp-scale) value=0.7 ;; esac
    printf -- '--%s=%s' "$flag" "$value"
}
sed -n 's/^RULE("\([^"]*\)", "\([^"]*\)", "\([^"]*\)", "\([^"]*\)", "\([^"]*\)", \([A-Z]*\), "\([^"]*\)")$/\1|\2|\3|\4|\5|\6|\7/p' \
    core/options/options_rules.def >"$work/rules"
[ "$(wc -l <"$work/rules")" = "$(grep -c '^RULE' core/options/options_rules.def)" ] || fail "a row of core/options/options_rules.def is not read"
while IFS='|' read -r c a a_is b b_is verdict words; do
    one=$(sample "$c" "$a" "$a_is")
    two=$(sample "$c" "$b" "$b_is")
    kind=refuses
    [ "$verdict" = REFUSE ] || kind=warns
    set -- "$c" "$work/none"
    [ "$c" != ingest ] || set -- ingest "$work/none" "$work/none"
    $kind "$words" "$@" ${one:+"$one"} ${two:+"$two"} </dev/null
    $kind "$words" "$@" ${two:+"$two"} ${one:+"$one"} </dev/null
    tried=$((tried + 1))
done <"$work/rules"

# ---- lists, suffixes and the names of older versions ----
printed() { "$bin" train x --print-config "$@" | tr -d ' \n'; }
case $(printed --budget 100k,200k,0.4M) in *'"budget":[100000,200000,400000]'*) ;; *) fail "a list with suffixes" ;; esac
case $(printed --iterations 600) in *'"iterations":600,'*) ;; *) fail "one value of a list" ;; esac
case $(printed --cache-mib 4G) in *'"cache_mib":4096,'*) ;; *) fail "4G of MiB" ;; esac
printf '{"budget": ["100k", 200000, "0.4M"], "iterations": "600"}' >"$work/c.jsonc"
case $(printed --config "$work/c.jsonc") in *'"iterations":600,'*'"budget":[100000,200000,400000]'*) ;; *) fail "a list of a file" ;; esac
printed --iterations 200,300 >"$work/again.jsonc"
[ "$(printed --config "$work/again.jsonc")" = "$(cat "$work/again.jsonc")" ] || fail "a printed configuration is not read back"
refuses 'budget A,B,C' train x --budget-3 5
refuses 'densify-until A,B,C' train x --densify-until-1 0.5
"$bin-lab" eval-photographs x --distance-1-m 5 2>&1 | grep -q 'distance-m A,B' || fail "the older name of --distance-m"
printf '{"budget_2": 5}' >"$work/c.jsonc"
refuses '"budget": .A, B, C' train x --config "$work/c.jsonc"
refuses 'budget-rule' train x --budget fit
refuses 'at most 3 values' train x --iterations 1,2,3,4
refuses 'is not a whole number' train x --iterations 1x
refuses 'is not a whole number' train x --iterations 1.0005k1
refuses 'is not a whole number' train x --iterations ''
refuses 'is not a whole number' train x --budget 1,,2

# ---- completions ----
bash --norc --noprofile -c '
    . "$1" || exit 1
    completes() { # LINE WORD...: each word is offered
        read -ra COMP_WORDS <<<"$1"
        case $1 in *" ") COMP_WORDS+=("") ;; esac
        COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMPREPLY=()
        _citysplat
        for word in "${@:2}"; do
            case " ${COMPREPLY[*]} " in *" $word "*) ;; *) echo "FAIL bash: \"$1\" lacks $word: ${COMPREPLY[*]}"; exit 1 ;; esac
        done
    }
    completes "citysplat tr" train
    completes "citysplat " train serve help completion
    completes "citysplat help se" serve seed
    completes "citysplat train x --it" --iterations
    completes "citysplat train --no-m" --no-masks
    completes "citysplat train x --aa " none 2d
    completes "citysplat completion " bash zsh fish
    cd "$2" && completes "citysplat serve cit" citysplat && completes "citysplat train x -o ma" man1
    completes "citysplat train x --seed "
    [ ${#COMPREPLY[@]} = 0 ] || { echo "FAIL bash: a number is completed"; exit 1; }
' bash "$work/citysplat" "$work" || exit 1
shells=bash
if command -v zsh >/dev/null; then
    zsh -n "$work/_citysplat" || fail "zsh -n"
    shells="$shells zsh"
fi
if command -v fish >/dev/null; then
    fish -c "source $work/citysplat.fish; complete -C 'citysplat train --iter'" | grep -q -- --iterations || fail "fish"
    shells="$shells fish"
fi
echo "docs/commands.md is what the program prints; $(ls "$work/man1" | wc -l) manual pages; $total options; $tried rules; completion of $shells"
