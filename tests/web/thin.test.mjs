// The viewer that lets the server draw: pictures while the camera moves, one request at a time, the
// full one at rest, and the offer of it on a slow machine.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { lookViewer, openPage, openViewer, waitForViewer } from "./lib/browser.mjs";
import { measureContent, SOUTH } from "./lib/checks.mjs";
import { ORIGIN, RED_TOP } from "./lib/city.mjs";
import { placeOfEnu, project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { Proxy } from "./lib/proxy.mjs";
import { firstDataSet, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const SIZE = { width: 640, height: 400 };
let why = MOCK || GIVEN_TILES ? "needs the test city on a server that draws" : "";

let source;
let proxy;
let viewer;
let page;
before(async () => {
    if (why) return;
    source = await openSource();
    const place = [SOUTH.lon.toFixed(7), SOUTH.lat.toFixed(7), SOUTH.h.toFixed(2)].join();
    const id = await firstDataSet(source.url);
    const trial = await fetch(`${source.url}/d/${id}/static/${place}@0,-36/64x48.jpg`);
    if (trial.status === 501 || trial.status === 503) why = `no pictures: ${trial.status}`;
    else if (!trial.ok) throw new Error(`${trial.url}: ${await trial.text()}`);
    if (why) return;
    proxy = await Proxy.open(source.url);
    viewer = await openViewer(`${proxy.url}/?thin`, SIZE);
    page = viewer.page;
});
after(async () => {
    await viewer?.close();
    await proxy?.down();
    await source?.close();
});

const pictures = () => proxy.log.filter(({ path }) => path.includes("/static/"));
const sizeOf = ({ path }) => Number(/\/(\d+)x\d+\.jpg/.exec(path)[1]);
const headingOf = ({ path }) => Number(/@([\d.]+),/.exec(decodeURIComponent(path))[1]);

test("home is that of the drawn city", async (t) => {
    if (why) return t.skip(why);
    const pose = await page.evaluate(() => window.citysplat.pose());
    const other = await openPage(source.url, SIZE);
    await waitForViewer(other.page);
    const drawn = await other.page.evaluate(() => window.citysplat.pose());
    await other.close();
    for (const key of ["lon", "lat", "h", "heading", "pitch"])
        assert.ok(Math.abs(pose[key] - drawn[key]) < 1e-5, `${key}: ${pose[key]}, ${drawn[key]}`);
    const png = decodePng(await page.screenshot());
    assert.ok(measureContent(png).share > 0.1);
});

test("a click tells the place, which the server knows", async (t) => {
    if (why) return t.skip(why);
    await lookViewer(page, SOUTH);
    const top = placeOfEnu(ORIGIN, [RED_TOP[0], RED_TOP[1], RED_TOP[2]]);
    const [x, y] = project(ORIGIN, SOUTH, RED_TOP, SIZE.width, SIZE.height);
    const told = page.evaluate(() => new Promise((done) => window.citysplat.viewer.on("click", done)));
    await page.mouse.click(x, y);
    const { place } = await told;
    const apart = (key) => Math.abs(place[key] - top[key]) * 111_320;
    assert.ok(apart("lat") < 3 && apart("lon") < 3 && Math.abs(place.h - top.h) < 3, JSON.stringify([place, top]));
    await page.click("#place-close");
    await page.evaluate(() => window.citysplat.viewer.home());
    await waitForViewer(page);
});

// The camera turns in every frame until some pictures were seen; how long a frame takes is not asked. Headings name the
// poses: a picture's request must be of the pose that was the newest when it was sent.
// On a busy machine the proxy learns so much later that an answer has ended than the page does.
const LATE_MS = 150;

test("moving: small pictures one by one, of the newest pose; at rest the full one", async (t) => {
    if (why) return t.skip(why);
    proxy.log = [];
    proxy.latencyMs = 30;
    // Small: pictures grow by a third while they come quickly, and on a quick machine none may grow to the full size here.
    await page.evaluate(() => (window.citysplat.viewer.pictures.area = 20_000));
    const { seen, frames, last } = await page.evaluate(
        async ([enough, frames]) => {
            const { viewer } = window.citysplat;
            const from = { ...viewer.pose, heading: 10 };
            const seen = []; // of each picture: whether it is a small one
            const poses = []; // of each frame: when the camera had turned, and where to
            let heading = from.heading;
            const off = viewer.on("picture", ({ moving }) => seen.push({ moving }));
            for (let i = 0; i < frames && seen.length < enough; i++) {
                viewer.lookAt({ ...from, heading: (heading += 0.5) });
                poses.push({ at: Date.now(), heading });
                await new Promise(requestAnimationFrame);
            }
            off();
            return { seen, frames: poses, last: heading };
        },
        [6, 600],
    );
    await waitForViewer(page);
    proxy.latencyMs = 0;
    const asked = pictures().map((one) => ({ ...one, px: sizeOf(one), heading: headingOf(one) }));
    t.diagnostic(`${seen.length} pictures in ${(last - 10) * 2} frames`);
    t.diagnostic(asked.map(({ px, heading }) => `${px} px at ${heading}`).join(", "));
    assert.ok(seen.length >= 6, `${seen.length} pictures while the camera moved`);
    assert.ok(seen.every(({ moving }) => moving), "a full picture while the camera moved");
    assert.ok(asked[0].px < SIZE.width / 1.5, `${asked[0].px} px wide while moving`);
    asked.slice(1).forEach((one, i) => assert.ok(one.began >= asked[i].ended - LATE_MS, "two requests on their way"));
    assert.ok(asked.every(({ aborted }) => !aborted), "a request was taken back");
    // The next one is asked for after the answer before it has ended, so with a pose that is not older than that.
    asked.slice(1).forEach((one, i) => {
        const newest = frames.filter(({ at }) => at < asked[i].ended - LATE_MS).at(-1);
        assert.ok(!newest || one.heading >= newest.heading - 0.01, "an old pose");
    });
    // On its way when the camera stopped: one small picture at most, perhaps one of the pose at rest, then the full one.
    const full = asked.filter(({ px }) => px === SIZE.width);
    assert.deepEqual(full.map(({ heading }) => heading), [last]);
    assert.equal(asked.at(-1), full[0]);
    assert.ok(asked.length <= seen.length + 3, `${asked.length} requests for ${seen.length} pictures`);
});

test("the server away: the last picture stays, and the next comes by itself", async (t) => {
    if (why) return t.skip(why);
    await proxy.down();
    await page.evaluate(() => {
        const { viewer } = window.citysplat;
        viewer.lookAt({ ...viewer.pose, heading: viewer.pose.heading + 30 });
    });
    await page.waitForSelector("#banner-link.wait");
    assert.ok(measureContent(decodePng(await page.screenshot())).share > 0.1, "black");
    await proxy.up();
    await waitForViewer(page);
    assert.equal(await page.evaluate(() => window.citysplat.state.link), "ok");
});

test("a slow machine is offered the server's pictures", async (t) => {
    if (why) return t.skip(why);
    const slow = await openPage(proxy.url, SIZE);
    await waitForViewer(slow.page);
    // Frames of 150 ms, while the camera turns.
    await slow.page.evaluate(async () => {
        const { viewer } = window.citysplat;
        const from = viewer.pose;
        for (let i = 0; i < 16; i++) {
            viewer.lookAt({ ...from, heading: from.heading + i });
            await new Promise(requestAnimationFrame);
            for (const end = performance.now() + 150; performance.now() < end; );
        }
    });
    await slow.page.click("#banner-slow button");
    await slow.page.waitForFunction(() => window.citysplat.state.mode === "pictures");
    await waitForViewer(slow.page);
    assert.equal(await slow.page.inputValue("#mode"), "pictures");
    await slow.close();
});
