#!/usr/bin/env bash
# s3.sh: an implementation of S3 that is not ours, Ceph's gateway (a monitor, a store in memory, radosgw). A server
# without data reads a private store of a bucket with signed requests.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need node nodejs
need curl curl
need ceph-mon ceph-mon
need ceph-osd ceph-osd
need radosgw radosgw
c=$work/ceph fsid=11111111-2222-3333-4444-555555555555
mon=127.0.0.1:$(free_port) gate=127.0.0.1:$(free_port)
mkdir -p "$c"/{mon,osd,rgw,run}
cat >"$c/conf" <<END
[global]
fsid = $fsid
mon host = v2:$mon
public addr = 127.0.0.1
auth cluster required = none
auth service required = none
auth client required = none
ms mon client mode = crc
ms client mode = crc
run dir = $c/run
admin socket = $c/run/\$name.sock
pid file = $c/run/\$name.pid
log file = $c/\$name.log
crash dir = $c/run
osd pool default size = 1
osd pool default min size = 1
osd pool default pg num = 1
osd pool default pgp num = 1
osd pool default pg autoscale mode = off
osd crush chooseleaf type = 0
mon allow pool size one = true
mon max pg per osd = 1000
[mon.a]
host = localhost
mon data = $c/mon
[osd.0]
osd data = $c/osd
osd objectstore = memstore
memstore device bytes = 268435456
[client.rgw]
rgw data = $c/rgw
keyring = $c/rgw/keyring
rgw frontends = beast endpoint=$gate
rgw thread pool size = 16
END
run() { "$@" >>"$c/out" 2>&1 || { echo "failed: $*"; tail -5 "$c/out" "$c"/*.log; exit 1; }; }
ceph_up() {
    run monmaptool --create --clobber --fsid $fsid --addv a "[v2:$mon]" "$c/monmap"
    run ceph-mon -c "$c/conf" --mkfs -i a --monmap "$c/monmap"
    ceph-mon -c "$c/conf" -i a -f >>"$c/out" 2>&1 & pids[5]=$!
    run timeout 60 ceph -c "$c/conf" osd create $fsid 0
    run ceph-osd -c "$c/conf" -i 0 --mkfs --osd-uuid $fsid
    ceph-osd -c "$c/conf" -i 0 -f >>"$c/out" 2>&1 & pids[6]=$!
    run ceph-authtool --create-keyring "$c/rgw/keyring" --gen-key -n client.rgw
    run timeout 120 radosgw-admin -c "$c/conf" -n client.rgw user create --uid=city --display-name=city --access-key=CITY --secret-key=SECRET
    radosgw -c "$c/conf" -n client.rgw -f >>"$c/out" 2>&1 & pids[7]=$!
    await "http://$gate/"
}
export AWS_ACCESS_KEY_ID=CITY AWS_SECRET_ACCESS_KEY=SECRET AWS_ENDPOINT_URL=http://$gate XDG_CACHE_HOME=$work/cache
s3() { node "$root/tests/front/s3.mjs" "$1" "http://$gate/$2" ${3:+"$3"}; }
check 'the bucket answers' ceph_up
"$city" "$work/lit.tiles" lit || exit 1
check 'a bucket is made' s3 PUT maps
check 'the store is in it' s3 PUT maps/toy.tiles "$work/lit.tiles"
check 'nobody may read it without keys' is "$(status "http://$gate/maps/toy.tiles")" 403
check 'a wrong key is told' grep -q 'status 403' <(AWS_SECRET_ACCESS_KEY=other "$bin" verify s3://maps/toy.tiles 2>&1)
check 'every tile is whole' "$bin" verify s3://maps/toy.tiles
began=$(wc -l <"$c/client.rgw.log")

XDG_CACHE_HOME=$work/cache1 store=s3://maps/toy.tiles serve 1 0
store=$work/lit.tiles serve 3 0
rev=$(revision)
tiles >"$work/paths"
fetch_all "$work/a" <"$work/paths"
(ports[1]=${ports[3]}; fetch_all "$work/b" <"$work/paths")
n=$(wc -l <"$work/paths")
check 'every tile comes' is "$(sums "$work/a" "$n" | grep -c .)" "$n"
check 'with the bytes of the file' cmp <(sums "$work/a" "$n") <(sums "$work/b" "$n")

echo "s3: $n tiles, $(grep -c 'GET /maps/toy.tiles.* 206' "$c/client.rgw.log") requests for ranges"
tail -n +"$began" "$c/client.rgw.log" | grep -oE '"[A-Z]+ [^"]* HTTP[^"]*"' | grep -v '"GET /maps/toy.tiles HTTP' >"$work/else"
check 'nothing else is asked of the bucket' is "$(wc -l <"$work/else")" 0
exit $failed
