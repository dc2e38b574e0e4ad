#!/bin/sh
# docs/loss.md is made of train/terms/terms.def: what training minimises, in the order of execution. Every row of the list has an
# option with its weight, a reference in double precision, and a test of finite differences that is run; every pass has its
# file. With --write docs/loss.md is made anew.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-loss-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }
tab=$(printf '\t')

sed -n 's/^PASS(\([a-z]*\), \([A-Z]*\))$/\1\t\2/p' train/terms/terms.def >"$work/passes"
sed -n 's/^TERM(\([a-z]*\), \([a-z0-9]*\), \([a-z_]*\), \([a-z_]*\), \([a-z_.\/]*\), \([a-z_]*\), "\(.*\)", "\(.*\)")$/\1\t\2\t\3\t\4\t\5\t\6\t\7\t\8/p' \
    train/terms/terms.def >"$work/terms"
[ "$(wc -l <"$work/passes")" = "$(grep -c '^PASS(' train/terms/terms.def)" ] || fail "a PASS of train/terms/terms.def is not read"
[ "$(wc -l <"$work/terms")" = "$(grep -c '^TERM(' train/terms/terms.def)" ] || fail "a TERM of train/terms/terms.def is not read"

while IFS=$tab read -r pass place; do
    [ -f "train/terms/term_$pass.c" ] || fail "pass $pass: there is no train/terms/term_$pass.c"
    grep -q "^const struct term_pass term_${pass}_pass" "train/terms/term_$pass.c" || fail "pass $pass: train/terms/term_$pass.c does not define it"
    grep -q "\.place = TERM_$place," "train/terms/term_$pass.c" || fail "pass $pass: its file has another place than $place"
    cut -f1 "$work/terms" | grep -qx "$pass" || fail "pass $pass: it has no term"
done <"$work/passes"
while IFS=$tab read -r pass name weight reference test check equation what; do
    cut -f1 "$work/passes" | grep -qx "$pass" || fail "term $name: there is no pass $pass"
    grep -q "^OPT([A-Z]*, [A-Z]*, $weight," train/base/options.def || fail "term $name: there is no option $weight"
    grep -Eq "^[a-z].*[ *]$reference\(" train/loss/*.h render/*.h || fail "term $name: no header declares $reference"
    grep -q "cmocka_unit_test($check)" "$test" || fail "term $name: $test does not run $check"
done <"$work/terms"

place_of() { # PASS: in words
    case $(sed -n "s/^$1$tab//p" "$work/passes") in
        EMBEDDINGS) echo "appearance embeddings" ;;
        GAUSSIANS) echo "Gaussians" ;;
        PIXELS) echo "pixels of the frame" ;;
        RAYS) echo "sums along the frame's rays" ;;
        BACKWARD) echo "Gaussians, in the backward pass" ;;
        *) fail "pass $1: its place has no words" ;;
    esac
}
{
    cat <<'TEXT'
# What is minimised

Made of `train/terms/terms.def` by `tests/test_loss.sh --write`; do not edit.

A step of training minimises the weighted sum of these terms, for one photograph. The table has the order of execution. Terms of one
pass share a file, `train/terms/term_PASS.c`, and a launch of a kernel. x is the frame, y the photograph. A is the opacity of a pixel, T = 1 - A
its transmittance. n is the number of values that are summed: pixels or Gaussians. Sources and measurements are in
[training](training.md). Each reference is in double precision; the test named in the last column compares it with finite
differences, and others compare the kernels with it.

| pass | term | what for | acts on | weight | default | term without its weight | reference, check |
|---|---|---|---|---|---:|---|---|
TEXT
    while IFS=$tab read -r pass name weight reference test check equation what; do
        default=$(sed -n "s/^OPT([A-Z]*, [A-Z]*, $weight, \"\([^\"]*\)\".*/\1/p" train/base/options.def)
        flag=$(echo "$weight" | tr _ -)
        echo "| $pass | $name | $what | $(place_of "$pass") | \`--$flag\` | $default | $equation | \`$reference\`, \`$test\` |" |
            sed 's/|x - y|/\\|x - y\\|/'
    done <"$work/terms"
} >"$work/loss.md"
[ "$1" != --write ] || cp "$work/loss.md" docs/loss.md || fail "not written"
diff -u docs/loss.md "$work/loss.md" || fail "docs/loss.md is not what train/terms/terms.def says: tests/test_loss.sh --write makes it anew"
