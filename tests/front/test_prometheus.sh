#!/usr/bin/env bash
# configs/alerts.yml and configs/grafana.json with Debian's Prometheus: the rules are sound, each alert fires when it should
# and is quiet else, and in a Prometheus that scrapes two running servers every expression of both files has data.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need prometheus prometheus
need promtool prometheus
need curl curl
need node nodejs
need openssl openssl

rules=$root/configs/alerts.yml
check 'configs/alerts.yml' promtool check rules "$rules"
sed "s|RULES|$rules|" "$root/tests/front/alerts.yml" >"$work/alerts_test.yml"
check 'each alert is quiet while all is well, and fires when it should' promtool test rules "$work/alerts_test.yml"
sed -n 's/.*- alert: //p' "$rules" | sort >"$work/alerts"
check 'no alert is without a test' is "$(sed -n 's/.*alertname="\([A-Za-z]*\)".*value: 1.*/\1/p' "$root/tests/front/alerts.yml" | sort | comm -3 - "$work/alerts")" ''

# Two servers: one with all that has metrics, and something wrong; one without pictures, that answers 503.
site=splats.example.org
front_certificate
mkdir "$work/stores" "$work/disk"
cp "$work/toy.tiles" "$work/stores/"
head -c 5000 "$work/toy.tiles" >"$work/stores/broken.tiles"
store=$work/stores serve 1 0 --device auto --cache-dir "$work/disk" --tls-cert "$work/splats.pem" --tls-key "$work/splats.key" --admin 127.0.0.1:0
serve 2 0 --metrics public
admin=$(sed -n 's/^operators: port \([0-9]*\).*/\1/p' "$work/1.out")
[ -n "$admin" ] || { cat "$work/1.log" "$work/1.out"; exit 1; }
ask() { # what makes both counters of the cache, and errors
    curl -sk -o "$work/null" "https://127.0.0.1:${ports[1]}/d/toy/tileset.json"
    curl -s -L "http://127.0.0.1:${ports[2]}/d/toy/static/13.4,52.5,90@0,-90/64x48.jpg" "http://127.0.0.1:${ports[2]}/d/toy/tileset.json" >"$work/null"
}
ask
curl -s "http://127.0.0.1:$admin/metrics" >"$work/metrics"
# Certificates are renewed by days.
check 'promtool finds no other fault in names and units of the metrics' is "$(promtool check metrics <"$work/metrics" 2>&1 | grep -v ^citysplat_certificate_days_left)" ''
gone=$(free_port) port=$(free_port)
cat >"$work/prometheus.yml" <<END
global: {scrape_interval: 1s, evaluation_interval: 1s}
rule_files: [$rules]
scrape_configs:
  - job_name: citysplat
    static_configs: [{targets: ["127.0.0.1:$admin", "127.0.0.1:${ports[2]}", "127.0.0.1:$gone"]}]
END
prometheus --config.file="$work/prometheus.yml" --storage.tsdb.path="$work/tsdb" --web.listen-address="127.0.0.1:$port" >"$work/prometheus.log" 2>&1 &
pids[4]=$!
url=http://127.0.0.1:$port
check 'Prometheus answers' await "$url/-/ready"
for _ in $(seq 12); do sleep 0.5; ask; done

# Comparisons are left out: what they compare has to be there, whether or not the alert fires.
{
    sed -n 's/^ *expr: //p' "$rules" | sed -E 's/ (==|>|<) [0-9.]+$//'
    node -e '
        for (const panel of JSON.parse(require("fs").readFileSync(process.argv[1])).panels)
            for (const { expr } of panel.targets) console.log(expr.replaceAll("$instance", ".+").replaceAll("$__rate_interval", "5s"))' "$root/configs/grafana.json"
} >"$work/expressions"
n=0
while read -r expression; do
    for _ in $(seq 20); do # a rate needs two scrapes
        got=$(promtool query instant "$url" "$expression" 2>&1 | grep -c '=> .* @\[')
        [ "$got" = 0 ] || break
        ask
        sleep 0.5
    done
    [ "$got" != 0 ] || { echo "  no data: $expression"; n=$((n + 1)); }
done <"$work/expressions"
check 'there are forty expressions and more' at_least "$(wc -l <"$work/expressions")" 40
check 'each has data' is "$n" 0
check 'Prometheus can evaluate each rule' is "$(curl -s "$url/api/v1/rules" | grep -o '"health":"[a-z]*"' | sort | uniq -c | tr -s ' ')" " $(wc -l <"$work/alerts") \"health\":\"ok\""
active() { curl -s "$url/api/v1/alerts" | grep -o '"alertname":"[A-Za-z]*","instance":"[^"]*"' | sort -u; }
for want in "CitysplatDown 127.0.0.1:$gone" "CitysplatStoresDegraded 127.0.0.1:$admin" "CitysplatCertificateEnds 127.0.0.1:$admin" "CitysplatPicturesOff 127.0.0.1:${ports[2]}" "CitysplatErrors 127.0.0.1:${ports[2]}"; do
    check "$want is pending or fires" at_least "$(active | grep -c "\"${want% *}\",\"instance\":\"${want#* }\"")" 1
done
exit $failed
