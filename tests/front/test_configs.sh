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
# The image is made of the Debian package, which names the libraries itself; .ci/nightly container builds it.
check 'configs/Containerfile makes the package' grep -q 'cpack -B' "$root/configs/Containerfile"
check 'configs/Containerfile installs it' grep -qE 'apt-get install .*/tmp/citysplat\.deb' "$root/configs/Containerfile"
if command -v apt-cache >/dev/null && grep -q '^ID=debian' /etc/os-release; then
    image=$(sed -n '/apt-get install/p' "$root/configs/Containerfile" | tr ' ' '\n' | grep -E '^[a-z0-9][a-z0-9.+-]+$' | grep -vx 'apt-get\|install\|cd\|cpack\|build' | sort -u)
    unknown=$(echo "$image" | xargs -r apt-cache show 2>&1 >/dev/null | tr '\n' ' ')
    check 'configs/Containerfile: its packages are those of Debian' is "$unknown" ''
fi
if command -v hadolint >/dev/null; then
    check 'configs/Containerfile' hadolint "$root/configs/Containerfile"
else
    echo 'not looked at: configs/Containerfile, since there is no hadolint'
fi
exit $failed
