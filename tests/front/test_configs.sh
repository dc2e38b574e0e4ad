#!/usr/bin/env bash
# Files of configs/ that other programs read: the unit is as closed as the page says, the options are known, the
# dashboard asks for metrics that there are, and what lints them finds nothing.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
PATH=$PATH:/usr/sbin

sed 's|"127.0.0.1:9090"|"127.0.0.1:0"|' "$root/configs/serve.jsonc" >"$work/serve.jsonc"
check 'configs/serve.jsonc' "$bin" serve "$work/toy.tiles" --config "$work/serve.jsonc" --check

if command -v systemd-analyze >/dev/null; then
    exposure=$(systemd-analyze security --offline=yes --no-pager "$root/configs/citysplat.service" 2>/dev/null | sed -n 's/.*exposure level.*: \([0-9.]*\) .*/\1/p')
    check "configs/citysplat.service is exposed by $exposure" at_most "${exposure/./}" 20
else
    echo 'not looked at: no systemd-analyze'
fi

serve 1 0 --device auto # metrics of the process that draws are there, whether or not it finds a device
curl -s "http://127.0.0.1:${ports[1]}/d/toy/tileset.json" >/dev/null
curl -s "http://127.0.0.1:${ports[1]}/metrics" | sed -n 's/^# TYPE \([a-z_]*\) histogram/\1_bucket/p; s/^# TYPE \([a-z_]*\) .*/\1/p' | sort -u >"$work/there"
grep -o 'citysplat_[a-z_]*' "$root/configs/grafana.json" | sort -u >"$work/asked"
check 'configs/grafana.json asks for twenty-five metrics and more' at_least "$(wc -l <"$work/asked")" 25
check 'configs/grafana.json: all of them are there' is "$(comm -23 "$work/asked" "$work/there")" ''
if command -v node >/dev/null; then
    check 'configs/grafana.json is JSON' node -e 'JSON.parse(require("fs").readFileSync(process.argv[1]))' "$root/configs/grafana.json"
fi
# The image holds every library that the program is linked against, by the names of Debian 12, and nothing of bootstrap's
# list is missing in it for want of a name.
if command -v dpkg-query >/dev/null && grep -q 'VERSION_ID="12"' /etc/os-release && command -v readelf >/dev/null; then
    image=$(sed -n '/apt-get install/,/rm -rf/p' "$root/configs/Containerfile" | tr -d '\\' | tr ' ' '\n' | grep -E '^[a-z0-9][a-z0-9.+-]+$' | grep -vx 'apt-get\|install\|rm' | sort -u)
    loaded=$(dirname "$bin") loaded=("$loaded/citysplat-image.so" "$loaded/citysplat-gdal.so") # when they are needed
    needed=$(readelf -d "$bin" "${loaded[@]}" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p')
    mapfile -t files < <(ldd "$bin" "${loaded[@]}" | awk '$2 == "=>" { print $1, $3 }' | grep -Fwf <(echo "$needed") | cut -d' ' -f2 |
        xargs -r readlink -f | sed 's|.*/\([^/]*/[^/]*\)$|*/\1|')
    # libc6, libgcc-s1 and libstdc++6 come with the others; a sanitizer's library is in no image.
    packages=$(dpkg-query -S "${files[@]}" 2>/dev/null | cut -d: -f1 | grep -vx 'libc6\|libgcc-s1\|libstdc++6\|lib.*san[0-9]*' | sort -u)
    lacks=$(comm -23 <(echo "$packages") <(echo "$image") | tr '\n' ' ')
    check 'configs/Containerfile has the libraries that the program needs' is "$lacks" ''
    unknown=$(comm -23 <(echo "$image") <(dpkg-query -W -f '${Package}\n' | sort -u) | xargs -r apt-cache show 2>&1 >/dev/null | tr '\n' ' ')
    check 'configs/Containerfile: its packages are those of Debian' is "$unknown" ''
    # .ci/nightly container builds it.
    check 'configs/Containerfile builds by bootstrap' grep -q '\./bootstrap build' "$root/configs/Containerfile"
fi
if command -v hadolint >/dev/null; then
    check 'configs/Containerfile' hadolint "$root/configs/Containerfile"
else
    echo 'not looked at: configs/Containerfile, since there is no hadolint'
fi
exit $failed
