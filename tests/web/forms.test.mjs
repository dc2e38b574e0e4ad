// What `citysplat seed` warms is what clients ask for, letter by letter: CesiumJS, 3d-tiles-renderer and the viewer, over a
// quick and a slow line, look at a city, and each tile that they ask for stands in the list of the client.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { mkdtempSync, rmSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, normalize } from "node:path";
import { after, afterEach, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { openPage, useWholeBrowser, waitForViewer } from "./lib/browser.mjs";
import { openCesium } from "./lib/cesium.mjs";
import { SOUTH } from "./lib/checks.mjs";
import { makeCity, ORIGIN } from "./lib/city.mjs";
import { serveFiles } from "./lib/files.mjs";
import { Proxy } from "./lib/proxy.mjs";
import { snippets } from "./lib/snippets.mjs";
import { GIVEN_TILES, MOCK, openLitCity, openSource } from "./lib/source.mjs";

useWholeBrowser();

const HERE = dirname(fileURLToPath(import.meta.url));
const NPM = ["../../web/node_modules", "node_modules"].map((name) => join(HERE, name));
const SIZE = { width: 480, height: 320 };
const COPIES = 12; // of each Gaussian, so that tiles have enough to be cut in two
const SLOW = 120_000; // bytes a second
const TIMEOUT_MS = 120000;
const VIEW = [SOUTH.lon, SOUTH.lat, SOUTH.h, SOUTH.heading, SOUTH.pitch].join();
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

let source;
let proxy;
let opened;
before(async () => {
    if (skip.skip) return;
    const copy = (one, k) => ({ ...one, pos: one.pos.map((v, axis) => v + ((7 * k + 3 * axis) % 11) / 10), sigma: one.sigma.map((v) => v / (1 + (k % 3))) });
    const gaussians = makeCity().flatMap((one) => Array.from({ length: COPIES }, (_, k) => copy(one, k)));
    source = await openSource({ gaussians, antialiased: true });
    proxy = await Proxy.open(source.url);
});
after(async () => {
    await proxy?.down();
    await source?.close();
});
afterEach(async () => {
    await opened?.close();
    opened = null;
    if (proxy) Object.assign(proxy, { log: [], rule: () => null, bytesPerSecond: Infinity });
});

// The list of a client, as paths.
async function listed(url, ds, client) {
    const text = await (await fetch(`${url}/d/${ds}/seed.ndjson?for=${client}`)).text();
    const lines = text.trim().split("\n").map((line) => JSON.parse(line));
    for (const { url: path, etag } of lines) {
        const answer = await fetch(`${url}/d/${ds}/${path}`, { method: "HEAD" });
        assert.equal(answer.status, 200, path);
        assert.equal(answer.headers.get("etag"), etag, path);
    }
    return new Set(lines.map((line) => `/d/${ds}/${line.url}`));
}

async function compare(t, client, of = proxy, url = source.url, ds = "fcity") {
    const list = await listed(url, ds, client);
    const asked = new Set(of.tiles().map(({ path }) => path));
    const kinds = [...asked].map((path) => path.replace(/.*\/t\/\d+\/\d+\/\d+/, "").replace(/v=\w+/, "v="));
    t.diagnostic(`${client}: ${asked.size} addresses asked for, ${list.size} listed: ${[...new Set(kinds)].join(" ")}`);
    assert.deepEqual([...asked].filter((path) => !list.has(path)), []);
    const all = await listed(url, ds, "all");
    assert.deepEqual([...list].filter((path) => !all.has(path)), []);
    return { asked, list, kinds: new Set(kinds) };
}

test("CesiumJS", skip, async (t) => {
    opened = await openCesium(`${proxy.url}/d/fcity/tileset.json`, SIZE);
    const loaded = () => opened.page.waitForFunction(() => window.tileset?.tilesLoaded, null, { timeout: TIMEOUT_MS, polling: 500 });
    await loaded();
    // Near, where it takes leaves as they are.
    await opened.page.evaluate(([lon, lat, h]) => window.widget.camera.setView({ destination: Cesium.Cartesian3.fromDegrees(lon, lat, h), orientation: { pitch: -1.4 } }), [ORIGIN.lon, ORIGIN.lat, ORIGIN.h + 60]);
    await opened.page.waitForTimeout(2000);
    await loaded();
    const { kinds } = await compare(t, "cesium");
    assert.ok(kinds.has(".lowpass.glb?v=") && kinds.has(".glb?v="), `only ${[...kinds]}`);
});

test("3d-tiles-renderer", skip, async (t) => {
    const dir = mkdtempSync(join(tmpdir(), "citysplat-forms-"));
    const other = await serveFiles((path) => (path.startsWith("/npm/") ? NPM.map((root) => join(root, normalize(path.slice(5)))).find((one) => statSync(one, { throwIfNoEntry: false })) : join(dir, normalize(path))));
    t.after(() => {
        other.close();
        rmSync(dir, { recursive: true, force: true });
    });
    const words = { host: proxy.url, ds: "fcity", npm: `${other.url}/npm`, lon: ORIGIN.lon, lat: ORIGIN.lat, height: ORIGIN.h, stand: "20, 60, 80" };
    const [recipe] = snippets("clients.md", "## three.js: Spark", "html");
    const code = recipe.replace(/\{(\w+)\}/g, (word, name) => words[name] ?? word).replace("const tiles =", "const tiles = window.tiles =");
    writeFileSync(join(dir, "index.html"), `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">${code}`);
    opened = await openPage(`${other.url}/index.html`, SIZE);
    const ends = () => opened.page.waitForFunction(() => window.tiles?.visibleTiles.size > 0 && window.tiles.loadProgress === 1, null, { timeout: TIMEOUT_MS, polling: 500 });
    await ends();
    const { kinds } = await compare(t, "three");
    assert.ok(kinds.has(".lowpass.glb") && [...kinds].every((kind) => /^\.(lowpass\.)?glb$/.test(kind)), `${[...kinds]}`);
});

// Whole tiles over a slow line too: a first part of one lacks what is small, and would stand where a coarser one was better.
for (const [line, bytesPerSecond] of [["quick", Infinity], ["slow", SLOW]])
    test(`the viewer, over a ${line} line`, skip, async (t) => {
        proxy.bytesPerSecond = bytesPerSecond;
        opened = await openPage(`${proxy.url}/?lang=en#${VIEW}`, SIZE);
        await waitForViewer(opened.page);
        const { kinds, asked, list } = await compare(t, "viewer");
        assert.deepEqual([...kinds].sort(), [".drc", ".drc?preset=preview&sh=0"]);
        assert.ok(asked.size < list.size);
    });

test("the viewer, where it computes lights", skip, async (t) => {
    const lit = await openLitCity();
    const between = await Proxy.open(lit.url);
    t.after(async () => {
        await between.down();
        await lit.close();
    });
    opened = await openPage(`${between.url}/?lang=en&scene=lit`, SIZE);
    await waitForViewer(opened.page);
    const { kinds } = await compare(t, "viewer", between, lit.url, "lit");
    assert.ok(kinds.has(".drc?appearance=none&preset=preview&sh=0") && kinds.has(".drc?appearance=none"), `${[...kinds]}`);
});
