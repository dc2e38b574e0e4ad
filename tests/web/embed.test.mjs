// The viewer without our server and in other people's pages: an export on a plain file server, in a
// sub-folder, drawn by the page and by a page that uses the module; and how large both are.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { cpSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { openPage, waitForViewer } from "./lib/browser.mjs";
import { measureContent } from "./lib/checks.mjs";
import { makeCity } from "./lib/city.mjs";
import { serveFiles } from "./lib/files.mjs";
import { decodePng } from "./lib/png.mjs";
import { BIN, GIVEN_TILES, importCity, MOCK } from "./lib/source.mjs";

const SIZE = { width: 480, height: 320 };
const DIST = join(dirname(fileURLToPath(import.meta.url)), "../../web/dist");
const PAGE_GZIP_MAX = 263_500; // 900 of them are the cross-fade, 2,000 the view of the poster
const MODULE_GZIP_MAX = 265_000;
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

let dir;
const asked = []; // paths
let server;
let url;
before(async () => {
    if (skip.skip) return;
    dir = mkdtempSync(join(tmpdir(), "citysplat-embed-"));
    const site = join(dir, "some/where");
    mkdirSync(site, { recursive: true });
    const args = ["export", importCity(dir, 60, "fcity", makeCity(), true), "-o", join(site, "city"), "--format", "3dtiles"];
    const run = spawnSync(BIN, args, { encoding: "utf8" });
    if (run.status !== 0) throw new Error(run.stderr);
    for (const part of ["index.html", "assets", "viewer.js", "icon.svg", "examples"])
        cpSync(join(DIST, part), join(site, "app", part), { recursive: true });
    server = await serveFiles((path) => (asked.push(path), join(dir, normalize(path.endsWith("/") ? `${path}index.html` : path))));
    url = `${server.url}/some/where`;
});
after(() => {
    server?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
});

test("the page draws an export from a plain file server in a sub-folder", skip, async () => {
    const { page, log, close } = await openPage(`${url}/app/?url=../city/tileset.json`, SIZE);
    await waitForViewer(page);
    const state = await page.evaluate(() => window.citysplat.state);
    assert.deepEqual([state.scene, state.ready], ["city", true]);
    assert.equal(state.gaussians, makeCity().length);
    // It filters by itself, and takes no tile that is filtered already.
    assert.match(readFileSync(join(dir, "some/where/city/tileset.json"), "utf8"), /\.lowpass\.glb/);
    assert.deepEqual(asked.filter((path) => /\.lowpass\./.test(path)), []);
    assert.ok(asked.some((path) => path.endsWith(".glb")));
    assert.equal(await page.isVisible("#server-button"), false, "no server, no server view");
    assert.deepEqual(log, []);
    await close();
});

test("the module in another page: options, events, methods, disposal", skip, async () => {
    const at = `${url}/app/examples/embed.html?url=../../city/tileset.json`;
    const { page, log, close } = await openPage(at, { width: 800, height: 640 });
    await page.waitForFunction(() => window.viewer?.state.ready, null, { timeout: 60000 });
    assert.match(await page.textContent("#out"), /^\d+ Gaussians$/);
    const box = await page.locator("#city").boundingBox();
    const png = decodePng(await page.screenshot({ clip: box }));
    assert.ok(measureContent(png).colors > 10);
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    await page.waitForFunction(() => / m$/.test(document.getElementById("out").textContent));
    await page.click("#north");
    await page.waitForFunction(() => {
        const { heading } = window.viewer.pose;
        return Math.min(heading, 360 - heading) < 0.01;
    });
    assert.deepEqual(log, []);
    const left = await page.evaluate(() => {
        window.viewer.dispose();
        return document.getElementById("city").childElementCount;
    });
    assert.equal(left, 0);
    await close();
});

test("without a city beside it the page says what to do", skip, async () => {
    const { page, close } = await openPage(`${url}/app/`, SIZE);
    await page.waitForSelector("#problem:not([hidden])");
    assert.match(await page.textContent("#problem-text"), /\?url=/);
    assert.match(await page.title(), /^No city beside this page/);
    await close();
});

test("a tileset that is not there is told as an event", skip, async () => {
    const { page, close } = await openPage(`${url}/app/examples/embed.html?url=none/tileset.json`, SIZE);
    await page.waitForFunction(() => /404/.test(document.getElementById("out").textContent));
    await close();
});

test("both are as small as they say", skip, () => {
    const size = (names) =>
        names.reduce((sum, name) => sum + gzipSync(readFileSync(join(DIST, name))).length, 0);
    const html = readFileSync(join(DIST, "index.html"), "utf8");
    const own = [...html.matchAll(/(assets\/[\w.-]+\.(?:js|css))/g)].map((match) => match[1]);
    const workers = readdirSync(join(DIST, "assets")).filter((name) => /worker.*\.js$/.test(name));
    const page = size(["index.html", ...own, ...workers.map((name) => `assets/${name}`)]);
    assert.ok(page < PAGE_GZIP_MAX, `the page has ${page} bytes gzipped`);
    const module = size(["viewer.js"]);
    assert.ok(module < MODULE_GZIP_MAX, `the module has ${module} bytes gzipped`);
});
