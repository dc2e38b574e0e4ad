// Two scenes of a server over each other, say two dates of a place: a line between both, faded, swapped.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { closeAll, lookViewer, openViewer, setControl, waitForViewer } from "./lib/browser.mjs";
import { NORTH, SOUTH } from "./lib/checks.mjs";
import { fCellCenter, ORIGIN, RED_TOP } from "./lib/city.mjs";
import { project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { GIVEN_TILES, MOCK, openTwoDates } from "./lib/source.mjs";

const SIZE = { width: 760, height: 500 };
const TOWER = [RED_TOP[0], RED_TOP[1], RED_TOP[2] + 0.5]; // red, in the east; blue at the later date
const LETTER = fCellCenter(0, 2); // yellow, in the west; cyan at the later date
const skip = { skip: MOCK || GIVEN_TILES ? "needs two cities" : false };

let source;
let viewer;
let page;
before(async () => {
    if (skip.skip) return;
    source = await openTwoDates();
    viewer = await openViewer(`${source.url}/?lang=en&scene=fcity`, SIZE);
    page = viewer.page;
});
after(() => closeAll(viewer, source));

// "first" or "later", by the colours of the tower and of the letter as they are on the screen.
async function datesAt(pose) {
    await page.waitForFunction(() => document.getElementById("compare-text").textContent === "");
    const ui = (on) => page.evaluate((v) => void (document.documentElement.dataset.ui = v), on ? "on" : "off");
    await ui(false);
    const png = decodePng(await page.screenshot());
    await ui(true);
    const date = (place) => {
        const [x, y] = project(ORIGIN, pose, place, SIZE.width, SIZE.height);
        const [r, , b] = png.mean(x, y, 1);
        assert.ok(Math.abs(r - b) > 60, `neither: ${r}, ${b} at ${x}, ${y}`);
        return r > b ? "first" : "later";
    };
    return { tower: date(TOWER), letter: date(LETTER) };
}

test("another scene lies right of a line, follows the camera, and is swapped", skip, async () => {
    await lookViewer(page, SOUTH);
    assert.equal(await page.textContent("#server-button"), "Compare");
    await page.click("#server-button");
    assert.deepEqual(await page.$$eval("#compare-with option", (all) => all.map((one) => one.value)), ["later"]);
    await setControl(page, "compare-with", "later");
    await page.waitForSelector("#other-scene.fresh");
    assert.deepEqual(await datesAt(SOUTH), { letter: "first", tower: "later" });
    assert.deepEqual(
        await page.$$eval("#compare-left, #compare-right", (all) => all.map((one) => one.textContent)),
        ["fcity", "later"],
    );
    await lookViewer(page, NORTH); // now the tower is left
    await page.waitForTimeout(300);
    assert.deepEqual(await datesAt(NORTH), { letter: "later", tower: "first" });
    await page.keyboard.press("x");
    assert.deepEqual(await datesAt(NORTH), { letter: "first", tower: "later" });
    assert.equal(await page.textContent("#compare-left"), "later");
    await page.click("#compare-swap");
    await setControl(page, "amount", "100");
    assert.deepEqual(await datesAt(NORTH), { letter: "later", tower: "later" });
    await page.click("#compare label:has-text('Fade')");
    await setControl(page, "amount", "0");
    assert.deepEqual(await datesAt(NORTH), { letter: "first", tower: "first" });
});

test("where the other scene has nothing to show, that is said", skip, async () => {
    const sky = { ...NORTH, heading: 0, pitch: 30 }; // away from both
    await page.evaluate((pose) => window.citysplat.look(pose), sky);
    await page.waitForFunction(() => /^Nothing/.test(document.getElementById("compare-text").textContent));
    await lookViewer(page, NORTH);
    await page.waitForFunction(() => document.getElementById("compare-text").textContent === "");
});

test("both share the memory; the other one goes when it is closed, and changes with the scene", skip, async () => {
    const limit = () => page.evaluate(() => window.citysplat.viewer.city.cache.maxBytesSize);
    const shared = await limit();
    await page.keyboard.press("v");
    assert.equal(await page.locator("#other-scene canvas").count(), 0);
    assert.equal(await page.isVisible("#divider"), false);
    assert.equal(await limit(), 2 * shared);
    await page.evaluate(() => window.citysplat.viewer.openScene("later", window.citysplat.pose()));
    await waitForViewer(page);
    await page.keyboard.press("v");
    assert.deepEqual(await page.$$eval("#compare-with option", (all) => all.map((one) => one.value)), ["fcity"]);
    await setControl(page, "compare-with", "fcity");
    await setControl(page, "amount", "50");
    await page.click("#compare label:has-text('Wipe')");
    await page.waitForSelector("#other-scene.fresh");
    assert.deepEqual(await datesAt(NORTH), { letter: "first", tower: "later" });
    await page.click("#compare-close");
    // What was on its way to a comparison that was closed is given up.
    assert.deepEqual(viewer.log, []);
});

// What a link says is what is seen, and what is seen is what the next link says.
test("a link opens the comparison as it was", skip, async () => {
    const view = [NORTH.lon, NORTH.lat, NORTH.h, NORTH.heading, NORTH.pitch].join();
    const open = async (query) => {
        await page.goto("about:blank");
        await page.goto(`${source.url}/?lang=en&scene=fcity&${query}#${view}`);
        await waitForViewer(page);
    };
    const controls = () =>
        page.evaluate(() => ({
            scene: document.getElementById("compare-with").value,
            by: document.querySelector('input[name="mode"]:checked').value,
            amount: Number(document.getElementById("amount").value),
            line: document.getElementById("divider").hidden ? null : document.getElementById("divider").style.left,
        }));
    const said = (want) =>
        page.waitForFunction((text) => decodeURIComponent(location.search).endsWith(text), want, { timeout: 10000 });
    await open("compare=later&wipe=37.25&swap=");
    await page.waitForSelector("#other-scene.fresh");
    assert.deepEqual(await controls(), { scene: "later", by: "wipe", amount: 62.75, line: "37.25%" });
    // The tower is left of the line, where the other scene lies after the swap; the letter right of it.
    assert.deepEqual(await datesAt(NORTH), { letter: "first", tower: "later" });
    await said("scene=fcity&compare=later&wipe=37.25&swap=");
    await page.click("#compare-swap");
    await page.click("#compare label:has-text('Fade')");
    await setControl(page, "amount", "100");
    await said("scene=fcity&compare=later&fade=100");
    await page.reload();
    await waitForViewer(page);
    await page.waitForSelector("#other-scene.fresh");
    assert.deepEqual(await controls(), { scene: "later", by: "fade", amount: 100, line: null });
    assert.deepEqual(await datesAt(NORTH), { letter: "later", tower: "later" });
    await page.click("#compare-close");
    await said("scene=fcity");
    // A scene that is gone is not replaced by another one.
    await open("compare=no-such-date&wipe=30");
    assert.match(await page.textContent("#toast"), /no-such-date/);
    assert.equal(await page.isVisible("#divider"), false);
    await said("scene=fcity");
});
