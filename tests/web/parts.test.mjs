// A tileset of several documents: the test city in tiles of 3 m, some 1,700 of them. Every document
// keeps the rules and leads to all tiles once, exported as served; the viewer and CesiumJS draw what
// they draw of a tileset of one document.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { existsSync, mkdirSync, readFileSync } from "node:fs";
import { createServer } from "node:http";
import { join, normalize } from "node:path";
import { after, before, test } from "node:test";

import { barePicture, openPage, useWholeBrowser, waitForViewer } from "./lib/browser.mjs";
import { lookFrom, openCesium } from "./lib/cesium.mjs";
import { checkSouth, measureContent, SOUTH } from "./lib/checks.mjs";
import { decodePng } from "./lib/png.mjs";
import { BIN, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";
import { listContents } from "./lib/tileset.mjs";

useWholeBrowser();

const EDGE_M = 3;
const NODES_MAX = 1100;
const COARSE_PX = 24;
const SIZE = { width: 800, height: 600 };
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

let source;
let site; // the export on a plain file server
let files;
before(async () => {
    if (skip.skip) return;
    source = await openSource({ edgeM: EDGE_M });
    files = join(source.dir, "site/city");
    mkdirSync(join(source.dir, "site"));
    const store = join(source.dir, "city.tiles");
    const run = spawnSync(BIN, ["export", store, "-o", files, "--format", "3dtiles"], { encoding: "utf8" });
    assert.equal(run.status, 0, run.stderr);
    site = createServer((request, response) => {
        const path = join(files, "..", normalize(new URL(request.url, "http://x").pathname));
        const there = path.startsWith(files) && existsSync(path);
        response.writeHead(there ? 200 : 404, { "Access-Control-Allow-Origin": "*" });
        response.end(there ? readFileSync(path) : undefined);
    });
    await new Promise((done) => site.listen(0, "127.0.0.1", done));
    site.url = `http://127.0.0.1:${site.address().port}`;
});
after(async () => {
    site?.close();
    await source?.close();
});

const count = (tile) => 1 + (tile.children ?? []).reduce((sum, child) => sum + count(child), 0);

// { contents, documents }: all tiles, and how many documents lead to them.
async function walk(url) {
    let documents = 0;
    const contents = await listContents(url, async (at) => {
        const document = await getJson(at);
        documents++;
        assert.ok(count(document.root) <= NODES_MAX, at);
        return document;
    });
    return { contents, documents };
}

test("documents lead to every tile once, exported as served", skip, async () => {
    const { splats } = await getJson(`${source.url}/collections/fcity`);
    const served = await walk(`${source.url}/d/fcity/tileset.json?sh=0`);
    const exported = await walk(`${site.url}/city/tileset.json`);
    assert.ok(splats.tiles > 1024, `${splats.tiles} tiles`);
    for (const { contents, documents } of [served, exported]) {
        assert.equal(contents.length, splats.tiles);
        assert.equal(new Set(contents.map((one) => one.url)).size, splats.tiles);
        assert.ok(documents > 1, `${documents} documents`);
    }
    assert.ok(served.contents.every((one) => one.url.endsWith(".glb?sh=0")), "the query is passed on");
    const place = ({ url, transform }) => [/t\/[\d/]+/.exec(url)[0], ...transform].join();
    assert.deepEqual(served.contents.map(place).sort(), exported.contents.map(place).sort());
    for (const { url } of exported.contents) assert.ok(existsSync(join(files, "..", new URL(url).pathname)), url);
});

// At a coarse setting, where tiles of other documents are drawn already: 1,700 tiles are more than this
// browser draws in a minute.
async function checkViewer(url) {
    const { page, log, close } = await openPage(url, SIZE);
    const [parts, deep] = [[], []];
    page.on("response", (answer) => {
        const [, kind, zoom] = /\/(tileset|t)\/(\d+)\//.exec(answer.url()) ?? [];
        if (kind === "tileset") parts.push([Number(zoom), answer.status()]);
        if (kind === "t") deep.push([Number(zoom), answer.status()]);
    });
    try {
        await page.waitForFunction(() => window.citysplat?.viewer);
        await page.evaluate((px) => (window.citysplat.viewer.detail = px), COARSE_PX);
        await waitForViewer(page);
        const state = await page.evaluate(() => window.citysplat.state);
        const { share } = measureContent(await barePicture(page));
        assert.ok(parts.length > 0, "no other document was asked for");
        assert.ok([...parts, ...deep].every(([, status]) => status === 200));
        const begins = Math.min(...parts.map(([zoom]) => zoom));
        assert.ok(deep.some(([zoom]) => zoom >= begins), "no tile of another document was drawn");
        assert.ok(state.gaussians > 0 && state.broken.length === 0, JSON.stringify(state));
        assert.ok(share > 0.05, `only ${(100 * share).toFixed(1)} % of the picture is not background`);
        assert.deepEqual(log, []);
    } finally {
        await close();
    }
}

test("the viewer draws it", skip, () => checkViewer(source.url));
test("the viewer draws the export", skip, () =>
    checkViewer(`${source.url}/?url=${encodeURIComponent(`${site.url}/city/tileset.json`)}`));

test("CesiumJS draws it", skip, async () => {
    const { page, close } = await openCesium(`${source.url}/d/fcity/tileset.json`, SIZE);
    try {
        await page.evaluate(() => (window.tileset.maximumScreenSpaceError = 1));
        await lookFrom(page, SOUTH);
        let faults = ["nothing was drawn"];
        for (let tries = 0; faults.length && tries < 60; tries++) {
            await page.waitForTimeout(2000);
            faults = checkSouth(decodePng(await page.screenshot()));
        }
        assert.deepEqual(faults, []);
        assert.equal(await page.textContent("#note"), "");
    } finally {
        await close();
    }
});
