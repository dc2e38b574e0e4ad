// Engines that are not ours, by their npm packages, on tiles as they are served: PlayCanvas, Spark and Babylon.js draw each
// format that docs/clients.md names for them, one picture each. (Its recipes as printed: the test recipes.)
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { existsSync, readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { dirname, extname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { openPage, useWholeBrowser } from "./lib/browser.mjs";
import { measureContent, rmsDifference } from "./lib/checks.mjs";
import { ORIGIN } from "./lib/city.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { BIN, firstDataSet, getBytes, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";
import { ssim } from "./lib/ssim.mjs";
import { listContents } from "./lib/tileset.mjs";

useWholeBrowser();

const HERE = dirname(fileURLToPath(import.meta.url));
const SIZE = { width: 320, height: 240 };
const TIMEOUT_MS = 120000;
const SSIM_LEAST = 0.95; // of what is not background, to the server's picture
const SAME_RMS = 6; // levels of 255: formats differ by their steps
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };
const CAMERA = { from: [60, 90, 160], at: [0, 5, 0], fov: 50 };
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css" };
const ROOTS = {
    "/three/": "../../web/node_modules/three/",
    "/spark/": "node_modules/@sparkjsdev/spark/",
    "/playcanvas/": "node_modules/playcanvas/",
    "/spz/": "node_modules/@adobe/spz/",
};
// Babylon.js is thousands of modules: one file of those that are used, as a page's own build makes it.
const BABYLON = `
    export { Engine } from "@babylonjs/core/Engines/engine.js";
    export { Scene } from "@babylonjs/core/scene.js";
    export { TargetCamera } from "@babylonjs/core/Cameras/targetCamera.js";
    export { HemisphericLight } from "@babylonjs/core/Lights/hemisphericLight.js";
    export { TransformNode } from "@babylonjs/core/Meshes/transformNode.js";
    export { Vector3 } from "@babylonjs/core/Maths/math.vector.js";
    export { Color4 } from "@babylonjs/core/Maths/math.color.js";
    export { ImportMeshAsync } from "@babylonjs/core/Loading/sceneLoader.js";
    export * as fflate from "fflate";
    import "@babylonjs/loaders/SPLAT/index.js";
    import "@babylonjs/loaders/glTF/2.0/index.js";`;
const bundleBabylon = () => {
    const { buildSync } = createRequire(join(HERE, "../../web/package.json"))("esbuild");
    const stdin = { contents: BABYLON, resolveDir: HERE };
    return buildSync({ stdin, bundle: true, format: "esm", write: false, logLevel: "error" }).outputFiles[0].contents;
};

let source;
let pages;
let opened;
let tile; // URL of the tile that holds the whole city, without its extension
before(async () => {
    if (skip.skip) return;
    source = await openSource({ signed: true });
    const url = `${source.url}/d/${await firstDataSet(source.url)}/tileset.json`;
    tile = (await listContents(url, getJson))[0].url.replace(/\.glb$/, "");
    pages = createServer((request, response) => {
        const path = normalize(new URL(request.url, "http://x").pathname);
        const root = Object.keys(ROOTS).find((one) => path.startsWith(one));
        try {
            if (path === "/babylon.mjs") {
                response.setHeader("Content-Type", "text/javascript");
                return response.end(bundleBabylon());
            }
            const exported = path.startsWith("/exported/") && join(source.dir, path.slice("/exported".length));
            const file = exported ? exported : root ? join(HERE, ROOTS[root], path.slice(root.length)) : join(HERE, "engines.html");
            response.setHeader("Content-Type", TYPES[extname(file)] ?? "application/octet-stream");
            response.end(readFileSync(file));
        } catch {
            response.writeHead(404).end();
        }
    });
    await new Promise((done) => pages.listen(0, "127.0.0.1", done));
    opened = await openPage(`http://127.0.0.1:${pages.address().port}/`, SIZE);
    await opened.page.waitForFunction(() => window.ready === true, null, { timeout: TIMEOUT_MS });
});
after(async () => {
    await opened?.close();
    pages?.close();
    await source?.close();
});

// CAMERA, which is about the store's origin, as an address of the server says it.
function poseOfCamera() {
    const enu = ([x, y, z]) => [x, -z, y];
    const [from, at] = [enu(CAMERA.from), enu(CAMERA.at)];
    const [e, n, u] = at.map((v, k) => v - from[k]);
    const { lon, lat, h } = placeOfEnu(ORIGIN, from);
    const degrees = (radians) => ((radians * 180) / Math.PI).toFixed(6);
    const heading = degrees((Math.atan2(e, n) + 2 * Math.PI) % (2 * Math.PI));
    return `${lon.toFixed(9)},${lat.toFixed(9)},${h.toFixed(4)}@${heading},${degrees(Math.atan2(u, Math.hypot(e, n)))},${CAMERA.fov}`;
}

async function draw(engine, ext, url = `${tile}.${ext}`) {
    const args = [engine, url, ext, CAMERA];
    await opened.page.evaluate(([e, u, x, c]) => window.draw(e, u, x, c), args);
    const path = process.env.ENGINES_SHOTS && join(process.env.ENGINES_SHOTS, `${engine}-${ext}.png`);
    return decodePng(await opened.page.screenshot({ timeout: TIMEOUT_MS, ...(path && { path }) }));
}

async function compare(t, engine, first, ...others) {
    const want = await draw(engine, first);
    const { share, colors } = measureContent(want);
    assert.ok(share > 0.05 && colors > 10, `${engine}, ${first}: ${share}, ${colors} colours`);
    for (const ext of others) {
        const off = rmsDifference(want, await draw(engine, ext));
        t.diagnostic(`${engine}: .${ext} is ${off.toFixed(2)} of 255 from .${first}`);
        assert.ok(off < SAME_RMS, `${engine}, ${ext}: ${off}`);
    }
    assert.deepEqual(opened.log, []);
}

test("PlayCanvas draws plain.glb, .sog and both .ply alike", skip, (t) =>
    compare(t, "playcanvas", "plain.glb", "sog", "ply", "compressed.ply"));

// The whole city, about the store's origin.
function exportCity(name, format) {
    if (existsSync(join(source.dir, name))) return;
    const args = ["export", join(source.dir, "city.tiles"), "-o", join(source.dir, name), "--format", format];
    const run = spawnSync(BIN, args, { encoding: "utf8" });
    assert.equal(run.status, 0, run.stderr);
}

for (const [engine, ...formats] of [["playcanvas", "compressed.ply"], ["spark", "sog"], ["babylon", "sog"]])
    test(`${engine} draws the exported city as the server draws it`, skip, async (t) => {
        const folder = `${source.url}/d/${await firstDataSet(source.url)}/static/`;
        const served = decodePng(await getBytes(`${folder}${poseOfCamera()}/${SIZE.width}x${SIZE.height}.png`));
        for (const ext of formats) {
            exportCity(`whole.${ext}`, "auto");
            const { covered, share } = ssim(await draw(engine, ext, `/exported/whole.${ext}`), served);
            const kilobytes = statSync(join(source.dir, `whole.${ext}`)).size / 1000;
            t.diagnostic(`.${ext}: SSIM ${covered.toFixed(4)} (${(100 * share).toFixed(0)} % covered), ${kilobytes.toFixed(0)} kB`);
            assert.ok(share > 0.05 && covered >= SSIM_LEAST, `${ext}: ${covered}`);
        }
        assert.deepEqual(opened.log, []);
    });

test("Spark draws .spz, .sog and both .ply alike", skip, (t) =>
    compare(t, "spark", "spz", "sog", "ply", "compressed.ply"));

test("Babylon.js draws plain.glb, .spz, .sog and both .ply alike", skip, (t) =>
    compare(t, "babylon", "plain.glb", "spz", "sog", "ply", "compressed.ply"));
