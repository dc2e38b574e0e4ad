// Tiles in two parts: over a slow line the Gaussians that show most come first, of all tiles. The result is the picture
// of whole tiles; a second part that does not come leaves the first on the screen, and comes later.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { barePicture, openPage, waitForViewer } from "./lib/browser.mjs";
import { measureContent, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { makeCity } from "./lib/city.mjs";
import { Proxy } from "./lib/proxy.mjs";
import { GIVEN_TILES, MOCK, openScenes } from "./lib/source.mjs";

const SIZE = { width: 480, height: 320 };
const COPIES = 12; // of each Gaussian of the test city, so that tiles have enough to be cut
const SLOW = 120_000; // bytes a second, of the page too: it is what the viewer knows the line by
const MORE_MOST = 1.03; // bytes of both parts, of those of the tile
const RMS_MOST = 1; // of 255: Gaussians of one depth are drawn in another order
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

let source;
let proxy;
let viewer;
before(async () => {
    if (skip.skip) return;
    const copy = (one, k) => ({ ...one, pos: one.pos.map((v, axis) => v + ((7 * k + 3 * axis) % 11) / 10), sigma: one.sigma.map((v) => v / (1 + (k % 3))) });
    const city = makeCity().flatMap((one) => Array.from({ length: COPIES }, (_, k) => copy(one, k)));
    source = await openScenes({ fcity: city });
    proxy = await Proxy.open(source.url);
});
after(async () => {
    await proxy?.down();
    await source?.close();
});
afterEach(async () => {
    await viewer?.close();
    viewer = null;
    if (proxy) Object.assign(proxy, { log: [], rule: () => null, bytesPerSecond: Infinity });
});

async function open(bytesPerSecond) {
    proxy.bytesPerSecond = bytesPerSecond;
    const view = [SOUTH.lon, SOUTH.lat, SOUTH.h, SOUTH.heading, SOUTH.pitch].join();
    viewer = await openPage(`${proxy.url}/?lang=en#${view}`, SIZE);
    return viewer.page;
}

const read = (page) => page.evaluate(() => window.citysplat.state);
const nameOf = (path) => /t\/(\d+\/\d+\/\d+)/.exec(path)[1];

test("the first parts of all tiles come before the rest of any, and together they are the tiles", skip, async (t) => {
    const page = await open(SLOW);
    await waitForViewer(page);
    const { gaussians, heldBack, broken } = await read(page);
    assert.deepEqual([heldBack, broken], [false, []]);
    const got = await barePicture(page);
    const tiles = proxy.tiles().filter(({ path }) => !path.includes("preset="));
    const part = (k) => tiles.filter(({ path }) => path.endsWith(`?part=${k}`));
    const [first, second] = [part(1), part(2)];
    assert.equal(first.length, tiles.length - second.length, "a tile came in another form");
    assert.ok(second.length >= 2, `${second.length} tiles were cut`);
    assert.ok(Math.max(...first.map(({ ended }) => ended)) <= Math.min(...second.map(({ began }) => began)), "a rest came first");
    let [whole, parts] = [0, 0];
    for (const { path, bytes } of second) {
        const head = first.find((one) => nameOf(one.path) === nameOf(path)).bytes;
        assert.ok(head > 0.5 * (head + bytes) && head < 0.8 * (head + bytes), `${path}: ${head} and ${bytes} bytes`);
        whole += (await (await fetch(source.url + path.replace("?part=2", ""))).arrayBuffer()).byteLength;
        parts += head + bytes;
    }
    t.diagnostic(`${second.length} of ${first.length} tiles cut, ${parts} bytes for ${whole}`);
    assert.ok(parts < MORE_MOST * whole, `${parts} bytes for ${whole}`);
    await page.evaluate(() => Object.defineProperty(window.citysplat.viewer.link, "slow", { value: false }));
    await page.evaluate(() => window.citysplat.viewer.openScene("fcity", window.citysplat.viewer.pose));
    await waitForViewer(page);
    assert.equal((await read(page)).gaussians, gaussians);
    const apart = rmsDifference(got, await barePicture(page));
    assert.ok(apart < RMS_MOST, `${apart} of 255 from the picture of whole tiles`);
});

test("a rest that does not come leaves the first part, and comes later", skip, async () => {
    let broken = null;
    proxy.rule = (path) => {
        if (path.includes("part=2")) broken ??= path;
        return path === broken ? { status: 500, body: { detail: "tile is damaged" } } : null;
    };
    const page = await open(SLOW);
    await page.waitForFunction(() => window.citysplat?.state.broken.length === 1, null, { polling: 50 });
    assert.ok(measureContent(await barePicture(page)).share > 0.1, "the first part is gone");
    const [named] = (await read(page)).broken;
    assert.deepEqual([named.name, named.why], [nameOf(broken), "tile is damaged"]);
    proxy.rule = () => null;
    await waitForViewer(page);
    assert.deepEqual((await read(page)).broken, []);
});

test("where memory is short, tiles stay as their first part, and the page says so", skip, async () => {
    const page = await open(SLOW);
    await waitForViewer(page);
    const { memory, gaussians } = await read(page);
    await viewer.close();
    proxy.log = [];
    const view = [SOUTH.lon, SOUTH.lat, SOUTH.h, SOUTH.heading, SOUTH.pitch].join();
    viewer = await openPage(`${proxy.url}/?memory=${(0.8 * memory) / 2 ** 20}#${view}`, SIZE);
    const held = await (
        await viewer.page.waitForFunction(
            () => {
                const state = window.citysplat?.state; // it is settled for a moment before the first part is drawn, too
                return state?.settled && state.heldBack && state.gaussians > 0 && { memory: state.memory, gaussians: state.gaussians };
            },
            null,
            { polling: 50 },
        )
    ).jsonValue();
    assert.ok(held.memory <= memory, `${held.memory} bytes, all of it takes ${memory}`);
    assert.ok(held.gaussians < gaussians, `${held.gaussians} of ${gaussians} Gaussians, although memory is short`);
    await viewer.page.evaluate(() => (window.citysplat.viewer.memoryMb = 512));
    await waitForViewer(viewer.page);
    assert.equal((await read(viewer.page)).gaussians, gaussians);
});
