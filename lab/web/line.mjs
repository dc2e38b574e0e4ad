// What a slow line brings to somebody who opens a store in the viewer: the first picture and all of the view, in bytes and
// seconds.
//
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/line.mjs STORE.tiles [--mbit 10] [--latency 50] [--width 640]
//       [--height 360] [--query TEXT] [--times 3] [--away]
//
// Bytes are those of all answers, the page and its scripts too, without their heads. The first picture is counted when a
// frame with Gaussians has been drawn, with all that came until then. The last line is what the same picture takes as
// .glb with every level above it: what 3d-tiles-renderer alone asks for. With --times, medians. --away: the camera
// jumps to the open sky when the first picture is there, and what still comes of the old view is told too.
//
// SPDX-License-Identifier: Apache-2.0
import { resolve } from "node:path";
import { parseArgs } from "node:util";

import { openPage, waitForViewer } from "../../tests/web/lib/browser.mjs";
import { Proxy } from "../../tests/web/lib/proxy.mjs";

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        mbit: { type: "string", default: "10" },
        latency: { type: "string", default: "50" },
        width: { type: "string", default: "640" },
        height: { type: "string", default: "360" },
        query: { type: "string", default: "" },
        times: { type: "string", default: "3" },
        away: { type: "boolean", default: false },
    },
});
const [store] = positionals;
if (!store) {
    console.error("usage: node line.mjs STORE.tiles [--mbit N] [--latency MS] [--width W] [--height H] [--query TEXT] [--times N] [--away]");
    process.exit(2);
}
process.env.CITYSPLAT_TILES = resolve(store);
const { openSource } = await import("../../tests/web/lib/source.mjs");

// Runs in the page before its scripts: tells of the first frame with Gaussians.
function watch() {
    const look = () => {
        if (window.citysplat?.state.tiles > 0) setTimeout(() => window.painted(performance.now()));
        else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
}

// Addresses of the tiles of this view and of all above them, as .glb.
function branches() {
    const { root } = window.citysplat.viewer.city.active;
    const out = [];
    const visit = (tile) => {
        if (!tile.traversal?.used) return;
        const { uri } = tile.content ?? {};
        if (uri && !/\.json/.test(uri)) out.push(new URL(uri, `${tile.internal.basePath}/`).href);
        tile.children.forEach(visit);
    };
    visit(root);
    return out.map((url) => url.replace(/\.drc(\?.*)?$/, ".glb"));
}

async function bytesOf(url) {
    return (await (await fetch(url)).arrayBuffer()).byteLength;
}

const sum = (log) => log.reduce((bytes, one) => bytes + one.bytes, 0);

// Runs `use` with a fresh page behind the line, and what was told of the first picture.
async function behindLine(target, use) {
    const line = await Proxy.open(target);
    line.bytesPerSecond = Number(values.mbit) * 125_000;
    line.latencyMs = Number(values.latency);
    const blank = await openPage("about:blank", { width: Number(values.width), height: Number(values.height) });
    try {
        const { page } = blank;
        const first = new Promise((done) =>
            page.exposeFunction("painted", (ms) => done({ firstBytes: sum(line.log), firstMs: ms })),
        );
        await page.addInitScript(watch);
        await page.goto(`${line.url}/?${values.query}`);
        return await use(page, line, await first);
    } finally {
        await blank.close();
        await line.down();
    }
}

function whole(target) {
    return behindLine(target, async (page, line, first) => {
        await waitForViewer(page, 300_000);
        const ended = Math.max(...line.log.map((one) => one.ended));
        const allBytes = sum(line.log);
        const scripts = allBytes - sum(line.tiles());
        const { tiles, gaussians } = await page.evaluate(() => window.citysplat.state);
        line.bytesPerSecond = Infinity;
        const glb = await Promise.all((await page.evaluate(branches)).map(bytesOf));
        const glbBytes = scripts + glb.reduce((all, bytes) => all + bytes, 0);
        const allMs = ended - line.log[0].began;
        return { ...first, allBytes, allMs, tiles, gaussians, scripts, glbBytes, glbTiles: glb.length };
    });
}

// To the open sky, far off: nothing of the old view is wanted there.
function away(target) {
    return behindLine(target, async (page, line) => {
        const before = sum(line.tiles());
        await page.evaluate(() => {
            const pose = window.citysplat.pose();
            window.citysplat.look({ ...pose, lat: pose.lat + 0.2, heading: 0, pitch: 20 });
        });
        await waitForViewer(page, 300_000);
        return { came: sum(line.tiles()) - before };
    });
}

const source = await openSource();
try {
    const runs = [];
    for (let i = 0; i < Number(values.times); i++) runs.push(await whole(source.url));
    const jumps = [];
    for (let i = 0; values.away && i < Number(values.times); i++) jumps.push(await away(source.url));
    const median = (key, of = runs) => of.map((one) => one[key]).toSorted((a, b) => a - b)[of.length >> 1];
    const mb = (key, of) => `${(median(key, of) / 1e6).toFixed(2)} MB`;
    const s = (key) => `${(median(key) / 1e3).toFixed(1)} s`;
    console.log(`first picture  ${mb("firstBytes")}  ${s("firstMs")}`);
    const view = `${median("gaussians")} Gaussians in ${median("tiles")} tiles`;
    console.log(`all of it      ${mb("allBytes")}  ${s("allMs")}  ${view}; ${mb("scripts")} of it are no tiles`);
    const less = 100 * (1 - median("allBytes") / median("glbBytes"));
    console.log(`as .glb        ${mb("glbBytes")}  in ${median("glbTiles")} tiles: ${less.toFixed(0)} % less now`);
    if (jumps.length) {
        const share = (100 * median("came", jumps)) / (median("allBytes") - median("scripts"));
        console.log(`jump away      ${mb("came", jumps)} of the old view came after it, ${share.toFixed(0)} % of its tiles`);
    }
} finally {
    await source.close();
}
