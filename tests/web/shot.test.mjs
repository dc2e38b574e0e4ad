// Pictures of the view at any size: by the server, in parts where they are large, and by the browser.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";

import { barePicture, closeAll, openPage, openViewer, waitForViewer } from "./lib/browser.mjs";
import { importSource } from "./lib/bundle.mjs";
import { checkSouth, rmsDifference, SOUTH } from "./lib/checks.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const SIZE = { width: 800, height: 600 };
const skip = { skip: MOCK || GIVEN_TILES ? "needs a server with the test city" : false };

let source;
let viewer;
let page;
before(async () => {
    if (skip.skip) return;
    source = await openSource();
    viewer = await openViewer(`${source.url}/?lang=en`, { ...SIZE, acceptDownloads: true }, SOUTH);
    page = viewer.page;
});
after(() => closeAll(viewer, source));

// A picture by the module's method: { png } or { error }.
async function shoot(options, on = page) {
    const out = await on.evaluate(async (o) => {
        try {
            const blob = await window.citysplat.viewer.screenshot({ format: "png", ...o });
            const bytes = new Uint8Array(await blob.arrayBuffer());
            let text = "";
            for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
            return { text: btoa(text) };
        } catch (error) {
            return { error: error.message };
        }
    }, options);
    return out.error === undefined ? { png: decodePng(Buffer.from(out.text, "base64")) } : out;
}

const NO_DEVICE = /OpenCL|device|50[13]/;

// Each pixel the mean of four.
function halved(png) {
    const at = (x, y) => {
        const four = [0, 1].flatMap((i) => [0, 1].map((j) => png.at(2 * x + i, 2 * y + j)));
        return [0, 1, 2].map((c) => four.reduce((sum, p) => sum + p[c] / 4, 0));
    };
    return { width: png.width / 2, height: png.height / 2, at };
}

test("parts cover the picture once, and are small enough", async () => {
    const { cutUp, checkSize } = await importSource("shot.ts");
    for (const [width, height] of [[640, 480], [2048, 1900], [2049, 16], [3840, 2160], [16384, 12000], [17, 16384]]) {
        const parts = cutUp(width, height);
        const area = parts.reduce((sum, part) => sum + part.width * part.height, 0);
        assert.equal(area, width * height, `${width} x ${height}`);
        for (const part of parts) {
            assert.ok(part.width <= 2048 && part.height <= 2048 && part.width * part.height <= 4e6);
            assert.ok(part.x >= 0 && part.x + part.width <= width && part.y >= 0 && part.y + part.height <= height);
            const within = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;
            assert.equal(parts.filter((other) => within(part, other)).length, 1);
        }
        checkSize(width, height);
    }
    for (const [width, height] of [[15, 100], [100, 16385], [16384, 16384], [100.5, 100], [NaN, 100]])
        assert.throws(() => checkSize(width, height), /16 to 16384 pixels/);
});

test("the server draws pictures larger than it draws at once, without a seam", skip, async (t) => {
    const small = await shoot({ width: 1100, height: 500, background: "black" });
    if (NO_DEVICE.test(small.error ?? "")) return t.skip(small.error);
    assert.equal(small.error, undefined);
    const large = await shoot({ width: 2200, height: 1000, background: "black" }); // two parts
    assert.deepEqual([large.png.width, large.png.height], [2200, 1000]);
    const rms = rmsDifference(halved(large.png), small.png);
    t.diagnostic(`halved it differs by ${rms.toFixed(2)} of 255 from one of half the size`);
    assert.ok(rms < 6, `${rms}`);
    // Across the seam pixels differ as much as elsewhere.
    const step = (x) => {
        let sum = 0;
        for (let y = 0; y < 1000; y++) {
            const [a, b] = [large.png.at(x, y), large.png.at(x + 1, y)];
            for (let c = 0; c < 3; c++) sum += (a[c] - b[c]) ** 2;
        }
        return Math.sqrt(sum / 3000);
    };
    const around = [1080, 1085, 1090, 1110, 1115, 1120].map(step);
    assert.ok(step(1099) < 1.5 * Math.max(...around) + 0.5, `${step(1099)} at the seam, ${around} around it`);
});

test("server and browser draw the view at hand, and the view stays as it was", skip, async (t) => {
    const was = await barePicture(page);
    const own = await shoot({ ...SIZE, by: "browser", background: "black" });
    assert.deepEqual(checkSouth(own.png), [], "by the browser");
    const tall = await shoot({ width: 500, height: 900, by: "browser" });
    assert.deepEqual([tall.png.width, tall.png.height], [500, 900]);
    assert.ok(rmsDifference(was, await barePicture(page)) < 0.5, "the view changed");
    const served = await shoot({ ...SIZE, background: "black" });
    if (NO_DEVICE.test(served.error ?? "")) return t.skip(served.error);
    assert.deepEqual(checkSouth(served.png), [], "by the server");
    assert.ok(rmsDifference(own.png, served.png) < 12);
    const { error } = await shoot({ width: 30000, height: 10 });
    assert.match(error, /16 to 16384 pixels/);
});

test("a refusal of the server names its answer", skip, async () => {
    const said = await page.evaluate(async () => {
        const { viewer } = window.citysplat;
        await viewer.setAppearance("");
        const ask = fetch;
        let id = null;
        window.fetch = async (url, how) => {
            const answer = await ask(url, /\/render$/.test(url) ? { ...how, body: '{"camera": 1}' } : how);
            if (/\/render$/.test(url)) id = answer.headers.get("x-request-id");
            return answer;
        };
        const problem = await viewer.screenshot({ width: 32, height: 32, by: "server" }).catch((error) => error);
        window.fetch = ask;
        return { id, kind: problem.kind, status: problem.values?.status, requestId: problem.requestId };
    });
    assert.ok(said.id, "the server says no id");
    assert.deepEqual(said, { id: said.id, kind: "http", status: 422, requestId: said.id });
});

test("the dialog saves what was chosen, and says what went wrong", skip, async (t) => {
    await page.keyboard.press("i");
    await page.waitForSelector("#shot[open]");
    assert.deepEqual(await page.inputValue("#shot-width"), String(SIZE.width));
    await page.selectOption("#shot-size", "3840x2160");
    assert.deepEqual([await page.inputValue("#shot-width"), await page.inputValue("#shot-height")], ["3840", "2160"]);
    await page.fill("#shot-width", "700");
    await page.fill("#shot-height", "400");
    assert.equal(await page.inputValue("#shot-size"), "own");
    assert.equal(await page.isDisabled("#shot-background option[value=transparent]"), true);
    await page.selectOption("#shot-format", "webp");
    assert.equal(await page.isDisabled("#shot-background option[value=transparent]"), false);
    await page.route("**/render", (route) =>
        route.fulfill({ status: 422, contentType: "application/problem+json", body: '{"detail": "no such light"}' }),
    );
    await page.click("#shot-make");
    await page.waitForFunction(() => /Error 422.*no such light/.test(document.getElementById("shot-text").textContent));
    await page.unroute("**/render");
    const id = await firstDataSet(source.url);
    const probe = await shoot({ width: 32, height: 32 });
    if (NO_DEVICE.test(probe.error ?? "")) return t.skip(probe.error);
    const coming = page.waitForEvent("download");
    await page.click("#shot-make");
    const download = await coming;
    assert.equal(download.suggestedFilename(), `${id}-700x400.webp`);
    const bytes = readFileSync(await download.path());
    assert.deepEqual([bytes.toString("latin1", 0, 4), bytes.toString("latin1", 8, 12)], ["RIFF", "WEBP"]);
    assert.match(await page.textContent("#shot-text"), /700x400\.webp, \d+ kB/);
    await page.click("#shot-close");
    assert.equal(await page.isVisible("#shot"), false);
});

test("a tileset on a file server is drawn by the browser", skip, async () => {
    const id = await firstDataSet(source.url);
    const alone = await openPage(`${source.url}/?lang=en&url=${source.url}/d/${id}/tileset.json`, SIZE);
    try {
        await waitForViewer(alone.page);
        await alone.page.click("#shot-button");
        await alone.page.waitForSelector("#shot[open]");
        assert.equal(await alone.page.inputValue("#shot-by"), "browser");
        assert.equal(await alone.page.isDisabled("#shot-by option[value=server]"), true);
        await alone.page.selectOption("#shot-format", "png");
        const coming = alone.page.waitForEvent("download");
        await alone.page.click("#shot-make");
        const png = decodePng(readFileSync(await (await coming).path()));
        assert.deepEqual([png.width, png.height], [SIZE.width, SIZE.height]);
        assert.deepEqual(alone.log, []);
    } finally {
        await alone.close();
    }
});
