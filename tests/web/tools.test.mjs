// 3d-tiles-tools, the tools of 3D Tiles' authors, on a tileset as it is served: packed into .3tz and
// unpacked it is the same bytes, its tiles are analysed as glTF with their extensions, and what they
// upgrade to 3D Tiles 1.1 is what is there.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { EXT, EXT_SPZ } from "./lib/glb.mjs";
import { BIN, GIVEN_TILES, MOCK, firstDataSet, getBytes, getJson, openSource } from "./lib/source.mjs";
import { listContents } from "./lib/tileset.mjs";

const require = createRequire(import.meta.url);
const TOOLS = join(dirname(fileURLToPath(import.meta.url)), "node_modules/3d-tiles-tools/build/src/cli.mjs");

const SERVED = "balanced"; // the server's own preset
let source;
let dir;
let tiles; // paths below the folder
before(async () => {
    source = await openSource({ antialiased: true });
    dir = mkdtempSync(join(tmpdir(), "citysplat-tools-"));
    const url = `${source.url}/d/${await firstDataSet(source.url)}/tileset.json`;
    mkdirSync(join(dir, "served"));
    writeFileSync(join(dir, "served/tileset.json"), await getBytes(url));
    tiles = [];
    for (const content of await listContents(url, getJson)) {
        const path = new URL(content.url).pathname.slice(new URL("./", url).pathname.length);
        mkdirSync(dirname(join(dir, "served", path)), { recursive: true });
        writeFileSync(join(dir, "served", path), await getBytes(content.url));
        tiles.push(path);
    }
});
after(async () => {
    await source?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
});

// Files below a folder and their bytes.
function filesOf(folder) {
    const names = readdirSync(folder, { recursive: true }).filter((name) => statSync(join(folder, name)).isFile());
    return new Map(names.sort().map((name) => [name, readFileSync(join(folder, name))]));
}

test("into a .3tz and out again: the same files", async (t) => {
    const { TilesetConverter, TilesetSource3tz } = require("3d-tiles-tools");
    const [served, packed, back] = ["served", "city.3tz", "back"].map((name) => join(dir, name));
    await TilesetConverter.convert(served, undefined, packed, false);
    const archive = new TilesetSource3tz();
    await archive.open(packed);
    const keys = [];
    for await (const key of await archive.getKeys()) keys.push(key);
    assert.deepEqual(keys.filter((key) => !key.startsWith("@")).sort(), ["tileset.json", ...tiles].sort());
    for (const path of tiles.slice(0, 3))
        assert.deepEqual(await archive.getValue(path), readFileSync(join(served, path)), path);
    await archive.close();
    await TilesetConverter.convert(packed, undefined, back, false);
    assert.deepEqual(filesOf(back), filesOf(served));
    t.diagnostic(`${tiles.length} tiles, ${statSync(packed).size} bytes as .3tz`);
});

function exportCity(name, ...more) {
    const out = join(dir, name);
    const run = spawnSync(BIN, ["export", join(source.dir, "city.tiles"), "-o", out, ...more], { encoding: "utf8" });
    assert.equal(run.status, 0, run.stderr);
    return out;
}

test("an exported folder has the tiles that the server sends, also filtered for CesiumJS", { skip: MOCK || GIVEN_TILES }, (t) => {
    const files = filesOf(exportCity("as-served", "--format", "3dtiles", "--preset", SERVED));
    const named = [...files].filter(([name]) => name.endsWith(".json")).map(([, bytes]) => bytes.toString()).join();
    const inFolder = (path) => path.slice(path.lastIndexOf("t/", path.search(/\d+\/\d+\/\d+\./)));
    for (const path of tiles) {
        const name = inFolder(path);
        assert.ok(named.includes(name), `no document names ${name}`);
        assert.deepEqual(files.get(name), readFileSync(join(dir, "served", path)), name);
    }
    const filtered = (all) => [...all.keys()].filter((name) => name.endsWith(".lowpass.glb"));
    assert.ok(filtered(files).length > 0);
    for (const name of filtered(files)) assert.ok(files.has(name.replace(".lowpass", "")), `${name}: not as it is`);
    const bare = filesOf(exportCity("bare", "--format", "3dtiles", "--no-lowpass"));
    assert.deepEqual([...bare.keys()], [...files.keys()].filter((name) => !name.endsWith(".lowpass.glb")));
    assert.ok(!bare.get("tileset.json").includes(".lowpass"));
    t.diagnostic(`${filtered(files).length} of ${files.size} files are filtered tiles`);
});

test("a .3tz of the program is the folder that it exports", { skip: MOCK || GIVEN_TILES }, async (t) => {
    const { TilesetConverter, TilesetSource3tz } = require("3d-tiles-tools");
    const folder = exportCity("exported", "--format", "3dtiles");
    const [packed, back] = [exportCity("exported.3tz", "--format", "3tz"), join(dir, "unpacked")];
    const files = filesOf(folder);
    const archive = new TilesetSource3tz(); // by the index alone
    await archive.open(packed);
    for (const [name, bytes] of files) assert.deepEqual(await archive.getValue(name), bytes, name);
    assert.equal(await archive.getValue("t/0/0/0.glb"), undefined);
    await archive.close();
    await TilesetConverter.convert(packed, undefined, back, false);
    assert.deepEqual(filesOf(back), files);
    t.diagnostic(`${files.size} files`);
});

test("a tile is analysed as the glTF that it is", () => {
    const out = join(dir, "analysed");
    const args = ["analyze", "-i", join(dir, "served", tiles[0]), "-o", out];
    const run = spawnSync(process.execPath, [TOOLS, ...args], { encoding: "utf8" });
    assert.equal(run.status, 0, run.stdout + run.stderr);
    const [name] = readdirSync(out);
    const gltf = JSON.parse(readFileSync(join(out, name), "utf8"));
    assert.deepEqual([...gltf.extensionsRequired].sort(), [EXT, EXT_SPZ]);
    assert.equal(gltf.meshes[0].primitives[0].mode, 0);
});

test("an upgrade to 3D Tiles 1.1 finds no tile to change", async () => {
    const { TilesetUpgrader } = require("3d-tiles-tools");
    const [served, upgraded] = ["served", "upgraded"].map((name) => join(dir, name));
    await new TilesetUpgrader("1.1", undefined).upgrade(served, upgraded, false);
    const [before, after] = [filesOf(served), filesOf(upgraded)];
    assert.deepEqual([...after.keys()], [...before.keys()]);
    for (const path of tiles) assert.deepEqual(after.get(path), before.get(path), path);
    const [was, is] = [before, after].map((files) => JSON.parse(files.get("tileset.json")));
    // It drops the declaration of what 1.1 has without one; clients of 1.0 need it.
    assert.deepEqual(was.extensionsUsed, ["3DTILES_content_gltf"]);
    for (const key of ["extensionsUsed", "extensionsRequired", "extensions"]) delete was[key], delete is[key];
    assert.deepEqual(is, was);
});
