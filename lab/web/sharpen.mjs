// How soon a slow line shows what the whole view looks like: SSIM of each picture that the viewer draws, against the last.
//
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/sharpen.mjs STORE.tiles [--mbit 1.6,10] [--latency 50] [--width 640]
//       [--height 360] [--query TEXT] [--times 3]
//
// SSIM counts what is not background alone, so sky and ground are off. Times run from the start of the page. Medians of
// --times runs: the first picture, SSIM after 3, 4, 6 and 8 s, when it is 0.9, 0.95 and 0.98 for good, and the end; and
// when the largest tile is first seen, as a share of its bytes.
//
// SPDX-License-Identifier: Apache-2.0
import { resolve } from "node:path";
import { parseArgs } from "node:util";

import { openPage, waitForViewer } from "../../tests/web/lib/browser.mjs";
import { Proxy } from "../../tests/web/lib/proxy.mjs";
import { ssim } from "../../tests/web/lib/ssim.mjs";

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        mbit: { type: "string", default: "1.6" },
        latency: { type: "string", default: "50" },
        width: { type: "string", default: "640" },
        height: { type: "string", default: "360" },
        query: { type: "string", default: "" },
        times: { type: "string", default: "3" },
        curve: { type: "boolean", default: false },
    },
});
const [store] = positionals;
if (!store) {
    console.error("usage: node sharpen.mjs STORE.tiles [--mbit N,N] [--latency MS] [--width W] [--height H] [--query TEXT] [--times N] [--curve]");
    process.exit(2);
}
process.env.CITYSPLAT_TILES = resolve(store);
const { openSource } = await import("../../tests/web/lib/source.mjs");

// Runs in the page before its scripts: keeps what each frame shows.
function watch() {
    const seen = (window.seen = []);
    const copy = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    const look = () => {
        const viewer = window.citysplat?.viewer;
        if (!viewer) return setTimeout(look, 5);
        viewer.on("frame", () => {
            const { canvas } = viewer;
            if (!viewer.state.tiles || !canvas.width) return;
            Object.assign(copy.canvas, { width: canvas.width, height: canvas.height });
            copy.drawImage(canvas, 0, 0);
            const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
            const same = seen.at(-1)?.data.every((v, i) => v === data[i]);
            if (!same) seen.push({ ms: performance.now(), data, gaussians: viewer.state.gaussians });
        });
    };
    look();
}

async function run(target, mbit) {
    const line = await Proxy.open(target);
    line.bytesPerSecond = mbit * 125_000;
    line.latencyMs = Number(values.latency);
    const { width, height } = { width: Number(values.width), height: Number(values.height) };
    const blank = await openPage("about:blank", { width, height });
    try {
        const { page } = blank;
        await page.addInitScript(watch);
        await page.goto(`${line.url}/?backdrop=off&ui=off&${values.query}`, { waitUntil: "commit" });
        await waitForViewer(page, 300_000);
        const times = await page.evaluate(() => window.seen.map(({ ms, gaussians }) => ({ ms, gaussians })));
        const pictures = [];
        for (let i = 0; i < times.length; i++) {
            const text = await page.evaluate((k) => {
                const { data } = window.seen[k];
                let out = "";
                for (let at = 0; at < data.length; at += 32768) out += String.fromCharCode(...data.subarray(at, at + 32768));
                return btoa(out);
            }, i);
            const data = Buffer.from(text, "base64");
            pictures.push({ width, height, at: (x, y) => data.subarray(4 * (y * width + x), 4 * (y * width + x) + 3) });
        }
        const last = pictures.at(-1);
        const curve = times.map((one, i) => ({ ...one, ssim: ssim(pictures[i], last).covered }));
        const bytes = line.log.reduce((sum, one) => sum + one.bytes, 0);
        const tiles = line.tiles();
        const began = line.log[0].began;
        return { curve, bytes, tiles: tiles.map((t) => ({ ...t, began: t.began - began, ended: t.ended - began })) };
    } finally {
        await blank.close();
        await line.down();
    }
}

const at = (curve, ms) => curve.filter((one) => one.ms <= ms).at(-1)?.ssim ?? 0;
function reached(curve, least) {
    let from = null;
    for (const one of curve) from = one.ssim < least ? null : (from ?? one.ms);
    return from;
}

const source = await openSource();
try {
    for (const mbit of values.mbit.split(",").map(Number)) {
        const runs = [];
        for (let i = 0; i < Number(values.times); i++) runs.push(await run(source.url, mbit));
        const median = (of) => runs.map(of).toSorted((a, b) => a - b)[runs.length >> 1];
        const s = (of) => `${(median(of) / 1e3).toFixed(1)} s`;
        const levels = [0.9, 0.95, 0.98].map((least) => `${least}: ${s(({ curve }) => reached(curve, least))}`).join("  ");
        const after = [3, 4, 6, 8].map((t) => `${t} s: ${median(({ curve }) => at(curve, 1000 * t)).toFixed(3)}`).join("  ");
        console.log(`${mbit} Mbit/s  first ${s(({ curve }) => curve[0].ms)}  ${levels}  last ${s(({ curve }) => curve.at(-1).ms)}  ` +
            `${(median(({ bytes }) => bytes) / 1e6).toFixed(3)} MB; SSIM after ${after}`);
        if (!values.curve) continue;
        const { curve, tiles } = runs.at(-1);
        for (const { ms, ssim: v, gaussians } of curve) console.log(`  ${(ms / 1e3).toFixed(2)} s  ${v.toFixed(4)}  ${gaussians}`);
        for (const { path, bytes, began, ended } of tiles) console.log(`  ${path.split("/t/")[1]}  ${bytes}  ${began} to ${ended}`);
    }
} finally {
    await source.close();
}
