// The module that others build with, from their side: its version, its size; nothing of the page around it changes; several
// stand in one page, and nothing is left of one that was disposed of.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { closeAll, openPage } from "./lib/browser.mjs";
import { measureContent, NORTH, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { decodePng } from "./lib/png.mjs";
import { openSource } from "./lib/source.mjs";

const HERE = dirname(fileURLToPath(import.meta.url));
const WEB = join(HERE, "../../web");
const DIST = join(WEB, "dist");
const SIZE = { width: 640, height: 400 };
const TIMEOUT_MS = 60000;
const ALL_GZIP_MAX = 262_500; // the module with its workers; docs/viewer.md says 262 kB
const COLLECT_MS = 20_000;
const CYCLES = 20; // a browser has 16 contexts of WebGL

test("the version is the package's, and semantic", async () => {
    const { name, version } = JSON.parse(readFileSync(join(WEB, "package.json"), "utf8"));
    assert.equal(name, "citysplat-viewer");
    assert.match(version, /^\d+\.\d+\.\d+(-[\w.]+)?$/);
    assert.ok(readFileSync(join(DIST, "viewer.js"), "utf8").includes(`"${version}"`), "not in the module");
});

test("it is one file, as small as the documents say", (t) => {
    const text = readFileSync(join(DIST, "viewer.js"), "utf8");
    assert.doesNotMatch(text, /\bimport\s*\(|^import\b|[};]import\b(?!\.meta)|\.worker-/m, "it loads other files");
    const size = gzipSync(text).length;
    t.diagnostic(`${size} bytes gzipped`);
    assert.ok(size < ALL_GZIP_MAX, `${size} bytes gzipped`);
});

let source;
let opened;
let page;
before(async () => {
    source = await openSource();
    opened = await openPage(`${source.url}/examples/embed.html?url=none`, SIZE);
    page = opened.page;
    await page.evaluate(() => {
        window.viewer.dispose();
        window.viewer = null;
        document.body.innerHTML = '<p id="text">Around it</p><div id="a"></div><div id="b"></div>';
        for (const id of ["a", "b"]) document.getElementById(id).style.cssText = "width:300px;height:200px;float:left";
    });
});
after(() => closeAll(opened, source));

const make = (id, more = {}) =>
    page.evaluate(
        async ([id, more]) => {
            const { createViewer } = await import("../viewer.js");
            window[id] = createViewer(document.getElementById(id), { url: "../", ...more });
        },
        [id, more],
    );
const ready = (id) => page.waitForFunction((name) => window[name].state.ready, id, { timeout: TIMEOUT_MS });
const part = async (id) => decodePng(await page.locator(`#${id}`).screenshot());

// What a page around the viewer can see of it.
const traces = () =>
    page.evaluate(() => ({
        sheets: document.styleSheets.length + document.adoptedStyleSheets.length,
        head: document.head.querySelectorAll("style, link, script").length,
        root: document.documentElement.getAttributeNames().join(),
        body: document.body.getAttributeNames().join(),
        globals: Object.keys(window).filter((name) => !["a", "b"].includes(name)).sort().join(),
        text: JSON.stringify(Object.fromEntries([...getComputedStyle(document.getElementById("text"))].map((name) => [name, getComputedStyle(document.getElementById("text"))[name]]))),
        container: document.getElementById("a").style.cssText,
        children: document.body.children.length,
    }));

test("it changes nothing of the page around it, and takes itself away", async () => {
    const before = await traces();
    await make("a");
    await ready("a");
    const { container, ...during } = await traces();
    const { container: own, ...without } = before;
    assert.deepEqual(during, without);
    assert.match(container, /position: relative/);
    assert.doesNotMatch(own, /position/);
    await page.evaluate(() => (window.a.dispose(), (window.a = null)));
    assert.deepEqual(await traces(), before);
    assert.equal(await page.locator("#a > *").count(), 0);
});

test("two in one page draw their own views, and keys move the one that has the focus", async () => {
    await Promise.all([make("a"), make("b")]);
    await Promise.all([ready("a"), ready("b")]);
    await page.evaluate(([a, b]) => (window.a.lookAt(a), window.b.lookAt(b)), [SOUTH, NORTH]);
    await Promise.all([ready("a"), ready("b")]);
    const [a, b] = [await part("a"), await part("b")];
    for (const png of [a, b]) assert.ok(measureContent(png).colors > 10, `${measureContent(png).colors} colours`);
    assert.ok(rmsDifference(a, b) > 10, "both show the same view");
    const poses = () => page.evaluate(() => [window.a.pose, window.b.pose]);
    for (const [id, moves, rests] of [["b", 1, 0], ["a", 0, 1]]) {
        const from = await poses();
        await page.locator(`#${id} > [tabindex]`).focus();
        await page.keyboard.down("e");
        await page.waitForFunction(
            ([name, heading]) => Math.abs(window[name].pose.heading - heading) > 2,
            [id, from[moves].heading],
            { timeout: TIMEOUT_MS },
        );
        await page.keyboard.up("e");
        assert.deepEqual((await poses())[rests], from[rests], `keys for ${id} move the other one`);
    }
    // One goes, the other stays and takes the keys.
    await page.evaluate(() => window.a.dispose());
    const { heading } = (await poses())[1];
    await page.keyboard.down("e");
    await page.waitForFunction((h) => Math.abs(window.b.pose.heading - h) > 2, heading, { timeout: TIMEOUT_MS });
    await page.keyboard.up("e");
    await page.evaluate(() => window.b.dispose());
    await page.evaluate(() => (window.a = window.b = null));
    assert.deepEqual(opened.log.filter((line) => !/404/.test(line)), []);
});

test("a frame that loads when asked: the server's picture before it, and the same view in it", async (t) => {
    const frame = await openPage("about:blank", { width: 800, height: 600 });
    t.after(() => frame.close());
    const asked = [];
    frame.page.on("request", (request) => asked.push(new URL(request.url()).pathname));
    await frame.page.goto(`${source.url}/examples/frame.html`);
    const poster = frame.page.locator("#poster");
    await frame.page.waitForFunction(() => document.getElementById("poster").style.backgroundImage);
    await frame.page.waitForLoadState("networkidle");
    assert.deepEqual(frame.log.filter((line) => !/50[13]/.test(line)), []);
    assert.deepEqual(asked.filter((path) => /assets|viewer|\/t\/|tileset/.test(path)), [], "loaded unasked");
    const box = await poster.boundingBox();
    const shot = async (name) => {
        const folder = process.env.MODULE_SHOTS;
        return decodePng(await frame.page.screenshot({ clip: box, ...(folder && { path: `${folder}/${name}.png` }) }));
    };
    const before = await shot("poster");
    const drawn = asked.some((path) => path.includes("/static/")) && !frame.log.some((line) => /50[13]/.test(line));
    await poster.click();
    const inside = await (await frame.page.waitForSelector("iframe")).contentFrame();
    await inside.waitForFunction(() => window.citysplat?.state.ready, null, { timeout: TIMEOUT_MS });
    const after = await shot("frame");
    assert.ok(measureContent(after).colors > 10);
    if (drawn) {
        assert.ok(measureContent(before).colors > 10, "no poster");
        // The F and the ball, below the words on the picture.
        const part = (png) => ({ width: 300, height: 80, at: (x, y) => png.at(x + 234, y + 215) });
        const rms = rmsDifference(part(before), part(after));
        t.diagnostic(`the frame is ${rms.toFixed(1)} of 255 from its poster`);
        assert.ok(rms < 12, `the frame shows another view: ${rms} of 255`);
    }
});

// How many of window.made are in memory. Collections from a script's own stack may spare what lies on it, and what a closed
// worker or an aborted answer held goes in a later turn: so again until none is left, or the time is over.
async function held(session) {
    const count = () => page.evaluate(() => window.made.filter((one) => one.deref()).length);
    const end = Date.now() + COLLECT_MS;
    for (;;) {
        await session.send("HeapProfiler.collectGarbage");
        const left = await count();
        if (!left || Date.now() > end) return left;
        await page.waitForTimeout(250);
    }
}

test(`${CYCLES} viewers one after another leave nothing: no worker, context, request or object`, async () => {
    const session = await page.context().newCDPSession(page);
    await page.evaluate(() => (window.made = []));
    const warnings = [];
    page.on("console", (message) => warnings.push(message.text()));
    const requests = [];
    page.on("request", (request) => requests.push(request.url()));
    for (let n = 0; n < CYCLES; n++) {
        await make("a");
        await page.evaluate(() => window.made.push(new WeakRef(window.a)));
        // Some of them while their tiles are on their way, the last one whole.
        if (n % 5 === 0 || n === CYCLES - 1) await ready("a");
        else await page.waitForFunction(() => window.a.scene, null, { timeout: TIMEOUT_MS });
        await page.evaluate(() => {
            window.a.dispose();
            window.a = null;
        });
    }
    await page.waitForTimeout(300);
    assert.equal(page.workers().length, 0, "workers are left");
    assert.deepEqual(warnings.filter((text) => /Too many active WebGL/.test(text)), []);
    requests.length = 0;
    const frames = await page.evaluate(async () => {
        const { requestAnimationFrame: own } = window;
        let asked = 0;
        window.requestAnimationFrame = (run) => (asked++, own.call(window, run));
        await new Promise((done) => setTimeout(done, 500));
        window.requestAnimationFrame = own;
        return asked;
    });
    assert.deepEqual([frames, requests], [0, []], "it goes on after its end");
    assert.equal(await page.evaluate(() => window.made.length), CYCLES);
    assert.equal(await held(session), 0, "disposed viewers are held");
});
