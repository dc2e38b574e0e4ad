// examples/light.html: a slider moves a city between two of its lights, in our viewer, in CesiumJS and in pictures of the
// server, and all three change alike.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { openPage, useWholeBrowser } from "./lib/browser.mjs";
import { decodePng } from "./lib/png.mjs";
import { GIVEN_TILES, MOCK, openLitCity } from "./lib/source.mjs";

useWholeBrowser();

const SIZE = { width: 1260, height: 420 };
const TIMEOUT_MS = 120000;
const PANES = ["ours", "cesium", "served"];
const CHANGE_LEAST = 4; // of 255: the city of the tests has lights that differ
const ALIKE_LEAST = 0.8; // cosine of two changes of colour
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

// The mean colour in the middle of each pane, once all three show this light.
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
        return window.viewer.state.ready && window.viewer.state.appearance === name && document.body.dataset.cesium === name && drawn;
    };
    await page.waitForFunction(is, want, { timeout: TIMEOUT_MS, polling: 500 });
    await page.waitForTimeout(1500);
    const colours = {};
    for (const id of PANES) {
        const picture = decodePng(await page.locator(`#${id}`).screenshot({ timeout: TIMEOUT_MS }));
        colours[id] = picture.mean(picture.width / 2, picture.height / 2, 60);
    }
    return colours;
}

test("three clients move between the same two lights", skip, async (t) => {
    await opened.page.waitForFunction(() => window.two && window.viewer.state.ready, null, { timeout: TIMEOUT_MS });
    const [first, second] = [await coloursAt(0), await coloursAt(1)];
    const change = Object.fromEntries(PANES.map((id) => [id, second[id].map((v, i) => v - first[id][i])]));
    const length = (v) => Math.hypot(...v);
    t.diagnostic(PANES.map((id) => `${id} ${change[id].map((v) => v.toFixed(0))}`).join(", "));
    for (const id of PANES) assert.ok(length(change[id]) > CHANGE_LEAST, `${id} changes by ${change[id]}`);
    for (const id of PANES.slice(1)) {
        const dot = change[id].reduce((sum, v, i) => sum + v * change.ours[i], 0);
        assert.ok(dot / length(change[id]) / length(change.ours) > ALIKE_LEAST, `${id} ${change[id]}, ours ${change.ours}`);
    }
    assert.deepEqual(opened.log, []);
});
