// examples/light.html: a slider moves a city between two of its lights, in our viewer and in pictures of the server; both
// change alike, and CesiumJS with them. Sky and ground of the server's pictures are the viewer's.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { meanDifference } from "./lib/checks.mjs";
import { openPage, useWholeBrowser, waitForViewer } from "./lib/browser.mjs";
import { lookFrom, openCesium } from "./lib/cesium.mjs";
import { decodePng } from "./lib/png.mjs";
import { getBytes, GIVEN_TILES, MOCK, openLitCity } from "./lib/source.mjs";

useWholeBrowser();

const SIZE = { width: 1260, height: 420 };
const TIMEOUT_MS = 120000;
const PANES = ["ours", "served"];
const CLIENTS = [...PANES, "cesium"];
const CHANGE_LEAST = 4; // of 255: the city of the tests has lights that differ
const ALIKE_LEAST = 0.8; // cosine of two changes of colour
const GROUND_APART = 3; // of 255
const WHOLE_APART = 2; // of 255 in the mean, of a city with its edge
const skip = { skip: MOCK || GIVEN_TILES ? "needs a city of several lights" : false };

let source;
let opened;
before(async () => {
    if (skip.skip) return;
    source = await openLitCity();
    opened = await openPage(`${source.url}/examples/light.html`, SIZE);
});
after(async () => {
    await opened?.close();
    await source?.close();
});

// The mean colour in the middle of each client's picture, once it shows this light.
async function coloursAt(share) {
    const { page } = opened;
    const want = await page.evaluate((value) => {
        const input = document.getElementById("share");
        input.value = value;
        input.dispatchEvent(new Event("input"));
        return window.two[value];
    }, share);
    const is = (name) => {
        const image = document.getElementById("served");
        const drawn = decodeURIComponent(image.src).endsWith(`appearance=${name}`) && image.complete && image.naturalWidth > 0;
        return window.viewer.state.ready && window.viewer.state.appearance === name && drawn;
    };
    await page.waitForFunction(is, want, { timeout: TIMEOUT_MS, polling: 500 });
    await page.waitForTimeout(1500);
    const colours = {};
    const take = async (id, shot) => {
        const picture = decodePng(await shot.screenshot({ timeout: TIMEOUT_MS }));
        colours[id] = picture.mean(picture.width / 2, picture.height / 2, 60);
    };
    for (const id of PANES) await take(id, page.locator(`#${id}`));
    const [pose, pane] = [await page.evaluate(() => window.viewer.pose), await page.locator("#ours").boundingBox()];
    const tileset = `${source.url}/d/lit/tileset.json?appearance=${encodeURIComponent(want)}`;
    const cesium = await openCesium(tileset, { width: Math.round(pane.width), height: Math.round(pane.height) });
    try {
        await lookFrom(cesium.page, pose);
        const whole = () => window.tileset.tilesLoaded && window.tileset.gaussianSplatPrimitive?._numSplats > 0;
        await cesium.page.waitForFunction(whole, null, { timeout: TIMEOUT_MS, polling: 500 });
        await cesium.page.waitForTimeout(3000); // sorted
        await take("cesium", cesium.page);
        assert.deepEqual(cesium.log, []);
    } finally {
        await cesium.close();
    }
    return colours;
}

test("three clients move between the same two lights", skip, async (t) => {
    await opened.page.waitForFunction(() => window.two && window.viewer.state.ready, null, { timeout: TIMEOUT_MS });
    const [first, second] = [await coloursAt(0), await coloursAt(1)];
    const change = Object.fromEntries(CLIENTS.map((id) => [id, second[id].map((v, i) => v - first[id][i])]));
    const length = (v) => Math.hypot(...v);
    t.diagnostic(CLIENTS.map((id) => `${id} ${change[id].map((v) => v.toFixed(0))}`).join(", "));
    for (const id of CLIENTS) assert.ok(length(change[id]) > CHANGE_LEAST, `${id} changes by ${change[id]}`);
    for (const id of CLIENTS.slice(1)) {
        const dot = change[id].reduce((sum, v, i) => sum + v * change.ours[i], 0);
        assert.ok(dot / length(change[id]) / length(change.ours) > ALIKE_LEAST, `${id} ${change[id]}, ours ${change.ours}`);
    }
    assert.deepEqual(opened.log, []);
});

test("sky and ground of the server's pictures are those of the browser, in each light", skip, async (t) => {
    const names = await opened.page.evaluate(() => window.two);
    const seen = [];
    for (const name of names) {
        const { page, close } = await openPage(`${source.url}/?scene=lit&ui=off&appearance=${name}`, { width: 640, height: 360, colorScheme: "light" });
        t.after(close);
        await waitForViewer(page, TIMEOUT_MS);
        // The view at hand, by both.
        const both = async () => {
            await waitForViewer(page, TIMEOUT_MS);
            const own = decodePng(await page.screenshot());
            const url = new URL(await page.evaluate(() => window.citysplat.viewer.serverPicture(640, 360).href.replace(/\.jpg/, ".png")));
            url.searchParams.set("background", "sky");
            return [own, decodePng(await getBytes(url))];
        };
        // The city's edge fades into the same ground.
        const apart = meanDifference(...(await both()));
        t.diagnostic(`${name}: the whole city is ${apart.toFixed(2)} of 255 apart`);
        assert.ok(apart < WHOLE_APART, `${name}: ${apart} of 255`);
        await page.evaluate(() => window.citysplat.look({ ...window.citysplat.pose(), pitch: -8 }));
        const [own, served] = await both();
        const [zenith, horizon, ground] = [[320, 5, 2], [20, 140, 40], [20, 300, GROUND_APART]].map(([x, y, most]) => {
            const [a, b] = [own, served].map((picture) => picture.mean(x, y, 3));
            t.diagnostic(`${name} at ${x}, ${y}: ${a.map((v) => v.toFixed(0))} by the browser, ${b.map((v) => v.toFixed(0))} by the server`);
            a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) <= most, `${name} at ${x}, ${y}: ${a} by the browser, ${b} by the server`));
            return b;
        });
        assert.ok(Math.hypot(...zenith.map((v, i) => v - horizon[i])) > 20 && Math.hypot(...ground.map((v, i) => v - horizon[i])) > 20, "all one colour");
        seen.push(ground);
    }
    assert.ok(Math.hypot(...seen[0].map((v, i) => v - seen[1][i])) > CHANGE_LEAST, `the ground is the same in both lights: ${seen}`);
});
