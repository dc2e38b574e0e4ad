// The map as one PMTiles file, read by PMTiles' own reader: every tile is the bytes that the server answers for
// its address, and where the server has none the file has none.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { BIN, GIVEN_TILES, MOCK, firstDataSet, getJson, openSource } from "./lib/source.mjs";

const { PMTiles, TileType } = createRequire(import.meta.url)("pmtiles");
const skip = MOCK || GIVEN_TILES ? "the store has to be this test's" : false;

let source;
let dir;
let base;
before(async () => {
    source = await openSource();
    dir = mkdtempSync(join(tmpdir(), "citysplat-pmtiles-"));
    base = `${source.url}/d/${await firstDataSet(source.url)}`;
});
after(async () => {
    await source?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
});

// The file's bytes by ranges, as a web server hands them out.
class Bytes {
    constructor(path) {
        this.path = path;
        this.data = readFileSync(path);
        this.asked = [];
    }
    getKey() {
        return this.path;
    }
    async getBytes(offset, length) {
        this.asked.push([offset, length]);
        const part = this.data.subarray(offset, offset + length);
        return { data: part.buffer.slice(part.byteOffset, part.byteOffset + part.byteLength) };
    }
}

function exportMap(name, ...more) {
    const out = join(dir, name);
    const run = spawnSync(BIN, ["export", join(source.dir, "city.tiles"), "-o", out, "--overwrite", ...more], { encoding: "utf8" });
    return { out, run };
}

// The server's tile; null for 204.
async function served(z, x, y, ext, scale = "") {
    for (;;) {
        const response = await fetch(`${base}/map/${z}/${x}/${y}${scale}.${ext}`);
        if (response.status === 204) return null;
        if (response.ok) return new Uint8Array(await response.arrayBuffer());
        assert.ok([429, 503].includes(response.status), `${response.status} ${await response.text()}`);
        await new Promise((done) => setTimeout(done, 300)); // the device starts
    }
}

test("every tile is the server's, and no other is there", { skip }, async (t) => {
    const about = await getJson(`${base}/map.json`);
    const zooms = `${about.minzoom}-${about.minzoom + 4}`;
    const { out, run } = exportMap("city.pmtiles", "--zooms", zooms);
    assert.equal(run.status, 0, run.stderr);
    assert.match(run.stdout, /map tiles of zooms/);
    const bytes = new Bytes(out);
    const archive = new PMTiles(bytes);
    const head = await archive.getHeader();
    assert.equal(head.tileType, TileType.Webp);
    assert.equal(head.clustered, true);
    assert.deepEqual([head.minZoom, head.maxZoom], [about.minzoom, about.minzoom + 4]);
    const box = [head.minLon, head.minLat, head.maxLon, head.maxLat];
    box.forEach((deg, i) => assert.ok(Math.abs(deg - about.bounds[i]) < 1e-6));
    const metadata = await archive.getMetadata();
    assert.equal(metadata.attribution, "Test city, drawn by code");
    assert.ok(bytes.asked[0][0] === 0 && bytes.asked[0][1] === 16384, "one read finds the root");
    let [tiles, none] = [0, 0];
    for (let z = about.minzoom; z <= about.minzoom + 4; z++) {
        const n = 2 ** z;
        const column = (lon) => Math.floor(((lon + 180) / 360) * n);
        const row = (lat) => {
            const s = Math.asinh(Math.tan((lat * Math.PI) / 180));
            return Math.floor((0.5 - s / (2 * Math.PI)) * n);
        };
        const [west, south, east, north] = about.bounds;
        for (let x = column(west) - 1; x <= column(east) + 1; x++)
            for (let y = row(north) - 1; y <= row(south) + 1; y++) {
                const want = await served(z, x, y, "webp");
                const got = await archive.getZxy(z, x, y);
                assert.equal(Boolean(got), Boolean(want), `${z}/${x}/${y}`);
                if (want) assert.deepEqual(Buffer.from(got.data), Buffer.from(want), `${z}/${x}/${y}`);
                want ? tiles++ : none++;
            }
    }
    assert.equal(tiles, head.numAddressedTiles);
    assert.ok(tiles > 8 && none > 8);
    t.diagnostic(`${tiles} tiles the same, ${none} in neither, ${bytes.data.length} bytes`);
});

test("the same bytes again, PNG for dense screens, and what is refused", { skip }, async () => {
    const about = await getJson(`${base}/map.json`);
    const zoom = String(about.minzoom);
    const dense = ["--zooms", zoom, "--map-format", "png", "--dense"];
    const [one, two] = ["one.pmtiles", "two.pmtiles"].map((name) => exportMap(name, ...dense));
    assert.equal(one.run.status, 0, one.run.stderr);
    assert.deepEqual(readFileSync(one.out), readFileSync(two.out));
    const archive = new PMTiles(new Bytes(one.out));
    assert.equal((await archive.getHeader()).tileType, TileType.Png);
    const [lon, lat] = about.center;
    const n = 2 ** about.minzoom;
    const x = Math.floor(((lon + 180) / 360) * n);
    const y = Math.floor((0.5 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / (2 * Math.PI)) * n);
    const got = await archive.getZxy(about.minzoom, x, y);
    const want = await served(about.minzoom, x, y, "png", "@2x");
    assert.deepEqual(Buffer.from(got.data), Buffer.from(want));
    for (const [more, words] of [
        [["--zooms", "9-3"], /--zooms/],
        [["--zooms", "1-40"], /from 0 to/],
        [["--zooms", "x"], /--zooms/],
    ]) {
        const { run } = exportMap("bad.pmtiles", ...more);
        assert.notEqual(run.status, 0);
        assert.match(run.stderr, words);
    }
    assert.deepEqual(readdirSync(dir).sort(), ["city.pmtiles", "one.pmtiles", "two.pmtiles"]);
});
