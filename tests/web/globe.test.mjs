// cesium.html: the city on CesiumJS' globe. It lies where it belongs and as high, the camera is that
// of the viewer's address both ways, nothing of Cesium is loaded by the viewer's own page, and nobody
// but the server is asked.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { closeAll, openPage, useWholeBrowser } from "./lib/browser.mjs";
import { checkSouth, SOUTH } from "./lib/checks.mjs";
import { makeCity, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

useWholeBrowser();

const DIST = join(dirname(fileURLToPath(import.meta.url)), "../../web/dist");
const SIZE = { width: 400, height: 300 }; // a globe without a graphics card: seconds a frame
const TIMEOUT_MS = 240000;
const ENGINE_GZIP_MAX = 1_150_000;
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city and a server" : false };

const hashOf = ({ lon, lat, h, heading, pitch }) => `#${lon},${lat},${h},${heading},${pitch}`;

let source;
let opened;
let asked;
before(async () => {
    if (skip.skip) return;
    source = await openSource({ signed: true });
    opened = await openPage(`${source.url}/cesium.html${hashOf(SOUTH)}`, SIZE);
    await opened.page.addStyleTag({ content: "#panel,.cesium-widget-credits{display:none!important}" });
});
after(() => closeAll(opened, source));

// Every tile that this view wants is in the one primitive that is drawn.
async function settle(page) {
    await page.waitForFunction(
        () => {
            const { tileset } = window.globe ?? {};
            if (!tileset || document.querySelector(".banner")) return !!tileset;
            const wanted = tileset._selectedTiles.reduce((n, t) => n + (t.content?.pointsLength ?? 0), 0);
            const drawn = tileset.gaussianSplatPrimitive?._numSplats ?? 0;
            const stable = tileset.tilesLoaded && drawn > 0 && drawn === wanted;
            window.calm = stable ? (window.calm ?? 0) + 1 : 0;
            return window.calm > 4;
        },
        null,
        { timeout: TIMEOUT_MS, polling: 300 },
    );
    assert.deepEqual(await page.locator(".banner").allTextContents(), []);
    await page.waitForTimeout(3500); // sorted and still
}

test("the city stands on the globe as in every other view", skip, async () => {
    const { page } = opened;
    await page.waitForFunction(() => window.globe?.tileset, null, { timeout: TIMEOUT_MS });
    await page.evaluate(() => void (window.globe.tileset.maximumScreenSpaceError = 0.1));
    await settle(page);
    const count = await page.evaluate(() => window.globe.tileset.gaussianSplatPrimitive._numSplats);
    assert.equal(count, makeCity().length);
    const png = await page.screenshot({ timeout: TIMEOUT_MS, path: process.env.GLOBE_SHOT });
    // the needle's ends are half transparent, and the globe behind them is bright
    const faults = checkSouth(decodePng(png)).filter((fault) => !/^needle at -?1 sigma/.test(fault));
    assert.deepEqual(faults, []);
    assert.deepEqual(opened.log, []);
});

test("its ground is the survey's floor: the globe neither hides the city nor lies far below it", skip, async () => {
    const { page } = opened;
    const name = await firstDataSet(source.url);
    const { voidHeight } = await getJson(`${source.url}/d/${name}/terrain.json`);
    const floor = await page.evaluate(([lon, lat]) => {
        const { scene } = window.globe.widget;
        const place = scene.camera.positionCartographic.clone();
        [place.longitude, place.latitude] = [lon, lat].map((v) => (v * Math.PI) / 180);
        return scene.globe.getHeight(place);
    }, [ORIGIN.lon, ORIGIN.lat]);
    assert.ok(Math.abs(floor - voidHeight) < 0.5, `the globe is at ${floor} m, the floor at ${voidHeight}`);
    assert.ok(voidHeight <= ORIGIN.h && voidHeight > ORIGIN.h - 20, `floor ${voidHeight}, ground ${ORIGIN.h}`);
});

test("a click tells the height of what is there", skip, async () => {
    const { page } = opened;
    const at = project(ORIGIN, SOUTH, RED_TOP, SIZE.width, SIZE.height);
    await page.mouse.click(Math.round(at[0]), Math.round(at[1]));
    await page.waitForFunction(() => document.getElementById("place-text").textContent, null, {
        timeout: TIMEOUT_MS,
    });
    const height = Number(/([-\d.]+) m above/.exec(await page.textContent("#place-text"))[1]);
    assert.ok(Math.abs(height - ORIGIN.h - RED_TOP[2]) < 3, `the red roof is at ${height} m`);
});

test("the address is the view, both ways, and leads back to the viewer", skip, async () => {
    const { page } = opened;
    const close = (a, b) =>
        ["lon", "lat"].every((k) => Math.abs(a[k] - b[k]) < 1e-6) &&
        ["h", "heading", "pitch", "fov"].every((k) => Math.abs(a[k] - b[k]) < 0.05);
    const pose = () => page.evaluate(() => window.globe.pose);
    assert.ok(close(await pose(), SOUTH), JSON.stringify(await pose()));
    const next = { ...SOUTH, h: SOUTH.h + 40, heading: 30, pitch: -50 };
    await page.evaluate((hash) => void (location.hash = hash), hashOf(next));
    await page.waitForFunction((h) => Math.abs(window.globe.pose.h - h) < 0.1, next.h, { timeout: TIMEOUT_MS });
    assert.ok(close(await pose(), next), JSON.stringify(await pose()));
    await page.evaluate((to) => window.globe.look(to), { ...next, heading: 60 });
    await page.waitForFunction(() => /,60\.00,-50\.00/.test(location.hash), null, { timeout: TIMEOUT_MS });
    const back = await page.getAttribute("#back", "href");
    assert.match(back, /^\.\/#[\d.]+,[-\d.]+,[\d.]+,60\.00,-50\.00$/);
});

test("the viewer links here with its view and loads nothing of Cesium", skip, async () => {
    const { page, close } = await openPage("about:blank", SIZE);
    asked = [];
    page.on("request", (request) => asked.push(request.url()));
    await page.goto(`${source.url}/${hashOf(SOUTH)}`);
    await page.waitForFunction(() => /cesium\.html#/.test(document.getElementById("globe").href), null, {
        timeout: TIMEOUT_MS,
    });
    const { hash, pathname } = new URL(await page.evaluate(() => document.getElementById("globe").href));
    assert.equal(pathname, new URL(`${source.url}/cesium.html`).pathname);
    assert.equal(hash.split(",").slice(3).join(), "0.00,-36.00");
    assert.deepEqual(asked.filter((url) => /cesium|engine-/.test(url)), []);
    await close();
});

test("it is as small as it says", skip, () => {
    const html = readFileSync(join(DIST, "cesium.html"), "utf8");
    const engines = readdirSync(join(DIST, "assets")).filter((name) => /^engine-.*\.js$/.test(name));
    const script = /assets\/(cesium-[\w-]+\.js)/.exec(html)[1];
    const text = readFileSync(join(DIST, "assets", script));
    const engine = engines.find((name) => text.includes(name));
    const size = gzipSync(text).length + gzipSync(readFileSync(join(DIST, "assets", engine))).length;
    assert.ok(size < ENGINE_GZIP_MAX, `scripts of ${size} bytes gzipped`);
    assert.match(html, /Content-Security-Policy/);
});
