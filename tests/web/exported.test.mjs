// Exported files as datasets: city.3tz and city.pmtiles, served from files and from a server that answers ranges, have
// the bytes that 3d-tiles-tools and PMTiles' own reader find in them, and lead clients to all of them.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { after, before, test } from "node:test";

import { BIN, GIVEN_TILES, MOCK, getBytes, getJson, importCity, serve, serveSigned } from "./lib/source.mjs";
import { checkTileset, listContents } from "./lib/tileset.mjs";

const require = createRequire(import.meta.url);
const { PMTiles } = require("pmtiles");
const { TilesetSource3tz } = require("3d-tiles-tools");
const skip = MOCK || GIVEN_TILES ? "the store has to be this test's" : false;

let dir;
let files;
let objects; // the server of objects
before(async () => {
    if (skip) return;
    dir = mkdtempSync(join(tmpdir(), "citysplat-exported-"));
    const tiles = importCity(dir, 20, undefined, undefined, true); // with both forms of tiles
    mkdirSync(join(dir, "out"));
    files = ["city.3tz", "plan.pmtiles", "dense.pmtiles"].map((name) => join(dir, "out", name));
    for (const file of files) {
        const dense = file.includes("dense") ? ["--dense", "--map-format", "png"] : [];
        const run = spawnSync(BIN, ["export", tiles, "-o", file, ...dense], { encoding: "utf8" });
        assert.equal(run.status, 0, run.stderr);
    }
    objects = await startObjects(join(dir, "out"));
});
after(() => {
    objects?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
});

// Files of a folder by ranges, as a bucket hands them out.
function startObjects(folder) {
    const server = createServer((request, response) => {
        const path = join(folder, basename(new URL(request.url, "http://x").pathname));
        const bytes = readFileSync(path);
        const [, from, to] = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "") ?? [];
        const etag = `"${statSync(path).mtimeMs}"`;
        if (from === undefined) return response.writeHead(500).end();
        const part = bytes.subarray(Number(from), Number(to) + 1);
        const range = `bytes ${from}-${Number(from) + part.length - 1}/${bytes.length}`;
        response.writeHead(206, { ETag: etag, "Content-Range": range, "Content-Length": part.length }).end(part);
        server.asked++;
    });
    server.asked = 0;
    return new Promise((done) => server.listen(0, "127.0.0.1", () => done(server)));
}

// The same check for files, for addresses, and below a signed address.
const places = {
    "from files": () => serve(...files),
    "from a server of objects": () => {
        const base = `http://127.0.0.1:${objects.address().port}`;
        return serve(...files.map((file) => `${base}/${basename(file)}`), "--cache-dir", join(dir, "cache"));
    },
    "signed": () => serveSigned(dir, files, ["city", "plan", "dense"]),
};
for (const [place, open] of Object.entries(places))
    test(`tiles and maps ${place}`, { skip }, async (t) => {
        const server = await open();
        try {
            const base = (name) => server.urls?.[name] ?? server.url;
            const n = await check3tz(`${base("city")}/d/city`);
            const [plan, dense] = [
                await checkMap(`${base("plan")}/d/plan`, files[1], 256),
                await checkMap(`${base("dense")}/d/dense`, files[2], 512),
            ];
            t.diagnostic(`${n} files of the 3TZ, ${plan} and ${dense} map tiles; ${objects.asked} requests for ranges`);
        } finally {
            await server.close();
        }
    });

async function check3tz(base) {
    const archive = new TilesetSource3tz();
    await archive.open(files[0]);
    const entry = await getJson(`${base}/tileset.json`);
    assert.deepEqual(checkTileset(entry), []);
    const contents = await listContents(`${base}/tileset.json`, getJson);
    const names = [];
    for (const { url } of contents) {
        const [, name] = /\/r\/[0-9a-f]{12}-[0-9a-f]{8}\/(t\/.*)$/.exec(new URL(url).pathname);
        const response = await fetch(url);
        assert.equal(response.status, 200, url);
        assert.match(response.headers.get("cache-control"), /immutable/);
        assert.deepEqual(Buffer.from(await response.arrayBuffer()), await archive.getValue(name), name);
        names.push(name);
    }
    let documents = 0;
    for await (const key of await archive.getKeys()) {
        if (key.startsWith("@") || key === "tiles.json" || names.includes(key)) continue;
        const revision = new URL(contents[0].url).pathname.split("/r/")[1].split("/")[0];
        const got = await getBytes(`${base}/r/${revision}/${key}`);
        assert.deepEqual(Buffer.from(got), await archive.getValue(key), key);
        documents++;
    }
    assert.ok(names.length > 50 && documents >= 1, `${names.length} tiles, ${documents} documents`);
    await archive.close();
    // without the address' revision, which is what the exported document names
    assert.equal((await fetch(`${base}/${names[0]}`)).status, 200);
    return names.length + documents;
}

async function checkMap(base, file, tileSize) {
    const bytes = readFileSync(file);
    const archive = new PMTiles({
        getKey: () => file,
        getBytes: async (at, n) => ({ data: new Uint8Array(bytes.subarray(at, at + n)).buffer }),
    });
    const head = await archive.getHeader();
    const about = await getJson(`${base}/map.json`);
    assert.deepEqual([about.minzoom, about.maxzoom, about.tileSize], [head.minZoom, head.maxZoom, tileSize]);
    assert.equal(about.attribution, "Test city, drawn by code");
    let [tiles, none] = [0, 0];
    for (let z = head.minZoom; z <= head.maxZoom; z++) {
        const n = 2 ** z;
        const column = (lon) => Math.floor(((lon + 180) / 360) * n);
        const row = (lat) => Math.floor((0.5 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / (2 * Math.PI)) * n);
        const [west, south, east, north] = about.bounds;
        for (let x = column(west) - 1; x <= column(east) + 1; x++)
            for (let y = row(north) - 1; y <= row(south) + 1; y++) {
                const want = await archive.getZxy(z, x, y);
                const url = about.tiles[0].replace("{z}", z).replace("{x}", x).replace("{y}", y);
                const response = await fetch(url);
                assert.equal(response.status, want ? 200 : 204, url);
                if (!want) none++;
                else assert.deepEqual(Buffer.from(await response.arrayBuffer()), Buffer.from(want.data), url);
                tiles += want ? 1 : 0;
            }
    }
    assert.equal(tiles, head.numAddressedTiles);
    assert.ok(none > 8);
    return tiles;
}

test("cut files are refused", { skip }, () => {
    for (const file of files) {
        const cut = join(dir, `cut${file.slice(file.lastIndexOf("."))}`);
        writeFileSync(cut, readFileSync(file).subarray(0, statSync(file).size - 1000));
        const run = spawnSync(BIN, ["serve", cut, "--check"], { encoding: "utf8" });
        assert.notEqual(run.status, 0);
        assert.match(run.stderr, /not all of it/);
    }
});
