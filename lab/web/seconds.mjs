// What somebody sees of a store over a slow line, second by second, at a desk and on a phone: bytes so far, what stands on
// the screen, and how far the page is from its last state, of 255.
//
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/seconds.mjs STORE.tiles [--mbit 1.6] [--latency 300] [--shots FOLDER]
//
// The server has drawn the poster before, as for everybody but the first visitor of a scene.
//
// SPDX-License-Identifier: Apache-2.0
import { join, resolve } from "node:path";
import { parseArgs } from "node:util";

import { openPage, waitForViewer } from "../../tests/web/lib/browser.mjs";
import { rmsDifference } from "../../tests/web/lib/checks.mjs";
import { decodePng } from "../../tests/web/lib/png.mjs";
import { Proxy } from "../../tests/web/lib/proxy.mjs";

const SIZES = { desk: { width: 1440, height: 900 }, phone: { width: 390, height: 844, hasTouch: true, isMobile: true } };
const SECONDS = [1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30];

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        mbit: { type: "string", default: "1.6" },
        latency: { type: "string", default: "300" },
        shots: { type: "string" },
    },
});
const [store] = positionals;
if (!store) {
    console.error("usage: node seconds.mjs STORE.tiles [--mbit N] [--latency MS] [--shots FOLDER]");
    process.exit(2);
}
process.env.CITYSPLAT_TILES = resolve(store);
const { openSource } = await import("../../tests/web/lib/source.mjs");

// Of a page whose scripts may not have come yet.
function look() {
    const { tiles = 0, gaussians = 0 } = window.citysplat?.state ?? {};
    const poster = Boolean(document.querySelector(".citysplat-poster:not([hidden])"));
    return { shown: poster ? "poster" : tiles ? `${gaussians} Gaussians` : "ground", ready: window.citysplat?.ready ?? false };
}

async function visit(target, name) {
    const warm = await openPage(target, SIZES[name]);
    await waitForViewer(warm.page);
    await warm.close();
    const line = await Proxy.open(target);
    line.bytesPerSecond = Number(values.mbit) * 125_000;
    line.latencyMs = Number(values.latency);
    const { page, close } = await openPage("about:blank", SIZES[name]);
    const megabytes = () => line.log.reduce((sum, { bytes }) => sum + bytes, 0) / 1e6;
    const rows = [];
    let readyAt = 0;
    const shoot = (what) => page.screenshot(values.shots && { path: join(values.shots, `${name}-${what}.png`) });
    try {
        await page.goto(line.url, { waitUntil: "commit" });
        const began = Date.now();
        const passed = () => (Date.now() - began) / 1000;
        for (const second of SECONDS) {
            while (passed() < second) {
                await page.waitForTimeout(50);
                if (!readyAt && (await page.evaluate(look)).ready) readyAt = passed();
            }
            const at = passed(); // a slow frame of the page may have held it up
            const { shown } = await page.evaluate(look);
            rows.push({ at, megabytes: megabytes(), shown, png: decodePng(await shoot(second)) });
            if (readyAt) break;
        }
        await waitForViewer(page, 300_000);
        readyAt ||= passed();
        const last = decodePng(await shoot("last"));
        for (const { at, megabytes: mb, shown, png } of rows)
            console.log(`${name}  ${at.toFixed(1)} s  ${mb.toFixed(2)} MB  ${shown}  ${rmsDifference(png, last).toFixed(1)} of 255`);
        console.log(`${name}  ready after ${readyAt.toFixed(1)} s, ${megabytes().toFixed(2)} MB`);
    } finally {
        await close();
        await line.down();
    }
}

const source = await openSource();
try {
    for (const name of Object.keys(SIZES)) await visit(source.url, name);
} finally {
    await source.close();
}
