// Light and weather in the browser: the lists offer every photograph, a choice changes the picture,
// a mix lies between its two ends, and a link keeps it.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { barePicture, openPage, waitForViewer } from "./lib/browser.mjs";
import { rmsDifference } from "./lib/checks.mjs";
import { firstDataSet, getJson, GIVEN_TILES, MOCK, openLitCity } from "./lib/source.mjs";

const SIZE = { width: 720, height: 480 };
const skip = { skip: MOCK || GIVEN_TILES ? "needs a city trained with appearance" : false };

let source;
let viewer;
let page;
let names; // of the photographs, darkest light first
before(async () => {
    if (skip.skip) return;
    source = await openLitCity();
    viewer = await openPage(source.url, SIZE);
    page = viewer.page;
    await waitForViewer(page);
});
after(async () => {
    await viewer?.close();
    await source?.close();
});

const picture = () => barePicture(page);

function brightness(png) {
    let sum = 0;
    for (let y = 0; y < png.height; y += 2)
        for (let x = 0; x < png.width; x += 2) for (const v of png.at(x, y).slice(0, 3)) sum += v;
    return sum;
}

const shownOnPage = () => page.evaluate(() => window.citysplat.state.appearance);

async function choose(id, value) {
    const before = await shownOnPage();
    await page.evaluate(
        ([name, v]) => {
            const control = document.getElementById(name);
            control.value = v;
            control.dispatchEvent(new Event(control.type === "range" ? "input" : "change"));
        },
        [id, value],
    );
    // The picture stays until the new one is complete: never is nothing drawn.
    let least = Infinity;
    do {
        least = Math.min(least, await page.evaluate(() => window.citysplat.state.gaussians));
        await page.waitForTimeout(20);
    } while ((await shownOnPage()) === before);
    assert.ok(least > 0, "black while the appearance changed");
    await waitForViewer(page);
}

test("every appearance of the server is offered", skip, async () => {
    const id = await firstDataSet(source.url);
    const list = await getJson(`${source.url}/d/${id}/appearances`);
    const offered = await page.$$eval("#appearance-from option", (all) => all.map((one) => one.value));
    assert.deepEqual([...offered].sort(), list.appearances.map((one) => one.name).sort());
    assert.equal(await page.isVisible("#appearance"), true);
    assert.equal(await shownOnPage(), "");
    names = offered.filter((name) => name !== "default");
    assert.ok(names.length > 8, `${names.length} photographs`);
});

test("a photograph's appearance changes the picture, a mix lies between", skip, async () => {
    const seen = [];
    for (const name of names.slice(0, 4)) {
        await choose("appearance-from", name);
        seen.push({ name, png: await picture() });
    }
    seen.sort((a, b) => brightness(a.png) - brightness(b.png));
    const [dark, light] = [seen[0], seen.at(-1)];
    assert.ok(rmsDifference(dark.png, light.png) > 3, "all appearances look the same");
    await choose("appearance-from", "default");
    await choose("appearance-from", dark.name);
    const again = await picture();
    assert.ok(rmsDifference(again, dark.png) < 0.5, "the same appearance gives another picture");
    await choose("appearance-to", light.name);
    assert.equal(await page.isVisible("#appearance-mix"), true);
    const mixed = brightness(await picture());
    assert.ok(brightness(dark.png) < mixed && mixed < brightness(light.png), "not between");
});

test("the address keeps the appearance", skip, async () => {
    const appearance = await shownOnPage();
    assert.match(appearance, /:0\.5,.*:0\.5$/);
    await page.waitForFunction(
        (text) => decodeURIComponent(location.hash).includes(text),
        appearance,
    );
    const before = await picture();
    await page.reload();
    await waitForViewer(page);
    assert.equal(await shownOnPage(), appearance);
    await page.waitForFunction(() => document.getElementById("appearance-to").value !== "");
    assert.ok(rmsDifference(before, await picture()) < 2, "the address shows another picture");
    assert.deepEqual(viewer.log, []);
});

test("an appearance that is not there leaves the picture and the choice", skip, async () => {
    const appearance = await shownOnPage();
    await page.evaluate(() => window.citysplat.viewer.setAppearance("no-such-photograph"));
    await page.waitForSelector("#problem:not([hidden])");
    const state = await page.evaluate(() => window.citysplat.state);
    assert.deepEqual([state.appearance, state.wanted], [appearance, appearance]);
    assert.ok(state.gaussians > 0);
});
