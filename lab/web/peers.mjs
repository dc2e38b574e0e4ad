// One city, the same Gaussians, in this viewer, in PlayCanvas and in Spark: how soon, how fast, how much, how like.
//
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/peers.mjs STORE.tiles [--form sog] [--width 640] [--height 480]
//       [--frames 20] [--step 3] [--away 200] [--up 140] [--rounds 3] [--only NAMES]
//
// Each engine opens a fresh page in turn, --rounds times; medians are printed. The finest level is drawn by all: the others
// load it as one file, exported as --form (sog or ply). The camera stands --up metres over the store's origin and --away beside it,
// and goes round by --step degrees a frame; a frame is over when a pixel of it has been read. "CPU" is the time of
// all of the browser's processes: on a busy machine it says more than a clock. Bytes are what the page gives to WebGL;
// memory on the card is what it has allocated there at the end. SSIM is to `citysplat render` of the exported .ply.
// Needs nothing but this machine, and is no test: it prints.
//
// SPDX-License-Identifier: Apache-2.0
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { loadavg, tmpdir } from "node:os";
import { dirname, extname, join, normalize, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import { openPage, useWholeBrowser } from "../../tests/web/lib/browser.mjs";
import { placeOfEnu } from "../../tests/web/lib/geo.mjs";
import { decodePng } from "../../tests/web/lib/png.mjs";
import { ssim } from "../../tests/web/lib/ssim.mjs";

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        form: { type: "string", default: "sog" },
        width: { type: "string", default: "640" },
        height: { type: "string", default: "480" },
        frames: { type: "string", default: "20" },
        step: { type: "string", default: "3" },
        away: { type: "string", default: "200" },
        up: { type: "string", default: "140" },
        rounds: { type: "string", default: "3" },
        only: { type: "string", default: "" },
        shots: { type: "string", default: "" },
    },
});
const [store] = positionals;
const BIN = process.env.CITYSPLAT_BIN;
if (!store || !BIN || !["sog", "ply"].includes(values.form)) {
    console.error("usage: CITYSPLAT_BIN=... node peers.mjs STORE.tiles [--form sog|ply] [--width W] [--height H] [--frames N] [--step DEG] [--away M] [--up M] [--rounds N] [--only NAMES] [--shots FOLDER]");
    process.exit(2);
}
useWholeBrowser();
process.env.CITYSPLAT_TILES = resolve(store);
const { openSource } = await import("../../tests/web/lib/source.mjs");

const HERE = dirname(fileURLToPath(import.meta.url));
const FOV = 50;
const PATIENCE_MS = 600_000;
const [width, height, frames, step, away, up] = ["width", "height", "frames", "step", "away", "up"].map((name) => Number(values[name]));
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript" };
const ROOTS = {
    "/three/": "../../web/node_modules/three/",
    "/dist/": "../../web/dist/",
    "/spark/": "../../tests/web/node_modules/@sparkjsdev/spark/",
    "/playcanvas/": "../../tests/web/node_modules/playcanvas/",
};
const ENGINES = [
    ["this viewer", "ours", { fullSize: true }],
    ["this viewer, fewer pixels while moving", "ours", {}],
    ["PlayCanvas", "playcanvas", { antiAlias: false }],
    ["PlayCanvas, `antiAlias`", "playcanvas", { antiAlias: true }],
    ["PlayCanvas, `antiAlias`, whole Gaussians", "playcanvas", { antiAlias: true, whole: true }],
    ["Spark", "spark", {}],
].filter(([name]) => !values.only || values.only.split(",").some((one) => name.toLowerCase().startsWith(one.toLowerCase())));

// Runs in the page before its scripts: what goes to the card, what is held there, and when the picture first has light.
function count() {
    const gpu = (window.gpu = { sent: 0, held: 0, heldMost: 0, firstMs: 0 });
    const sizes = new WeakMap();
    const hold = (object, bytes) => {
        if (!object) return;
        gpu.held += bytes - (sizes.get(object) ?? 0);
        gpu.heldMost = Math.max(gpu.heldMost, gpu.held);
        sizes.set(object, bytes);
    };
    const gl2 = WebGL2RenderingContext.prototype;
    const TEXEL = {
        ...{ [gl2.R8]: 1, [gl2.RG8]: 2, [gl2.RGB8]: 3, [gl2.RGBA8]: 4, [gl2.SRGB8_ALPHA8]: 4, [gl2.R16F]: 2, [gl2.RG16F]: 4, [gl2.RGBA16F]: 8 },
        ...{ [gl2.R32F]: 4, [gl2.RG32F]: 8, [gl2.RGBA32F]: 16, [gl2.R32UI]: 4, [gl2.RG32UI]: 8, [gl2.RGBA32UI]: 16, [gl2.RGBA16UI]: 8 },
        ...{ [gl2.RGBA16I]: 8, [gl2.R8UI]: 1, [gl2.RGBA8UI]: 4, [gl2.R16UI]: 2, [gl2.RG16UI]: 4, [gl2.RGBA]: 4, [gl2.R32I]: 4, [gl2.RGBA32I]: 16 },
        ...{ [gl2.DEPTH_COMPONENT24]: 4, [gl2.DEPTH_COMPONENT16]: 2, [gl2.DEPTH24_STENCIL8]: 4, [gl2.DEPTH_COMPONENT32F]: 4, [gl2.R11F_G11F_B10F]: 4 },
    };
    const texel = (format) => {
        if (TEXEL[format]) return TEXEL[format];
        (gpu.unknown ??= []).push(format);
        return 4;
    };
    const BINDING = { [gl2.TEXTURE_2D]: gl2.TEXTURE_BINDING_2D, [gl2.TEXTURE_2D_ARRAY]: gl2.TEXTURE_BINDING_2D_ARRAY, [gl2.TEXTURE_3D]: gl2.TEXTURE_BINDING_3D };
    const bound = (gl, target) => gl.getParameter(BINDING[target] ?? gl.TEXTURE_BINDING_CUBE_MAP);
    const lengthOf = (data, w, h, d = 1) => (ArrayBuffer.isView(data) ? Math.min(data.byteLength, data.BYTES_PER_ELEMENT * (data.length || 0)) : data && typeof data === "object" ? 4 * w * h * d : 0);
    const wrap = (name, before) => {
        const original = gl2[name];
        gl2[name] = function (...args) {
            const out = original.apply(this, args);
            before(this, args);
            return out;
        };
    };
    wrap("texStorage2D", (gl, [target, , format, w, h]) => hold(bound(gl, target), texel(format) * w * h));
    wrap("texStorage3D", (gl, [target, , format, w, h, d]) => hold(bound(gl, target), texel(format) * w * h * d));
    wrap("texImage2D", (gl, args) => {
        const [target, level, format] = args;
        const [w, h, data] = args.length > 6 ? [args[3], args[4], args[8]] : [args[5].width, args[5].height, args[5]];
        gpu.sent += lengthOf(data, w, h);
        if (!level) hold(bound(gl, target), texel(format) * w * h);
    });
    wrap("texImage3D", (gl, [target, level, format, w, h, d, , , , data]) => {
        gpu.sent += lengthOf(data, w, h, d);
        if (!level) hold(bound(gl, target), texel(format) * w * h * d);
    });
    wrap("texSubImage2D", (gl, args) => (gpu.sent += args.length > 7 ? lengthOf(args[8], args[4], args[5]) : lengthOf(args[6], args[6].width, args[6].height)));
    wrap("texSubImage3D", (gl, args) => (gpu.sent += lengthOf(args[10], args[5], args[6], args[7])));
    wrap("renderbufferStorage", (gl, [, format, w, h]) => hold(gl.getParameter(gl.RENDERBUFFER_BINDING), texel(format) * w * h));
    wrap("bufferData", (gl, [target, data]) => {
        const bytes = typeof data === "number" ? data : (data?.byteLength ?? 0);
        if (typeof data !== "number") gpu.sent += bytes;
        if (target === gl.ARRAY_BUFFER) hold(gl.getParameter(gl.ARRAY_BUFFER_BINDING), bytes);
    });
    wrap("bufferSubData", (gl, [, , data]) => (gpu.sent += data.byteLength));
    for (const name of ["deleteTexture", "deleteBuffer", "deleteRenderbuffer"]) wrap(name, (gl, [object]) => hold(object, 0));
    const get = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, options) {
        return get.call(this, kind, kind === "webgl2" ? { ...options, preserveDrawingBuffer: true } : options);
    };
    const small = Object.assign(document.createElement("canvas"), { width: 32, height: 24 }).getContext("2d", { willReadFrequently: true });
    const look = () => {
        const canvas = document.querySelector("canvas");
        if (canvas?.width) {
            small.drawImage(canvas, 0, 0, 32, 24);
            if (small.getImageData(0, 0, 32, 24).data.some((v, i) => i % 4 < 3 && v > 16)) return void (gpu.firstMs = performance.now());
        }
        requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
}

const dir = mkdtempSync(join(tmpdir(), "citysplat-peers-"));
const source = await openSource();
const pages = createServer((request, response) => {
    const path = normalize(new URL(request.url, "http://x").pathname);
    const root = Object.keys(ROOTS).find((one) => path.startsWith(one));
    const file = path.startsWith("/exported/") ? join(dir, path.slice(9)) : root ? join(HERE, ROOTS[root], path.slice(root.length)) : join(HERE, "peers.html");
    try {
        const bytes = readFileSync(file);
        response.setHeader("Content-Type", TYPES[extname(file)] ?? "application/octet-stream").end(bytes);
    } catch {
        response.writeHead(404).end();
    }
});

function poseOf(origin, eye) {
    const [e, u, s] = eye;
    const heading = ((Math.atan2(-e, s) * 180) / Math.PI + 360) % 360; // east, north of the way to the origin: -e, s
    return { ...placeOfEnu(origin, [e, -s, u]), heading, pitch: (-Math.atan2(u, Math.hypot(e, s)) * 180) / Math.PI, fov: FOV };
}

// What the program draws of the same file from the first camera: its axes are east, north, up.
function drawServed() {
    const d = Math.hypot(away, up);
    const [c, s] = [away / d, up / d]; // ahead: north by c, down by s
    const rows = [[1, 0, 0], [0, -s, -c], [0, c, -s]];
    const eye = [0, -away, up];
    const focal = height / 2 / Math.tan((FOV * Math.PI) / 360);
    const world_to_camera = [...rows.flatMap((row) => [...row, -row.reduce((sum, v, k) => sum + v * eye[k], 0)]), 0, 0, 0, 1];
    writeFileSync(join(dir, "camera.json"), JSON.stringify({ width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, world_to_camera }));
    execFileSync(BIN, ["render", join(dir, "city.ply"), "-q", "--camera", join(dir, "camera.json"), "-o", join(dir, "served.png")]);
    return decodePng(readFileSync(join(dir, "served.png")));
}

const megabytes = (bytes) => bytes / 1e6;
const residentMb = (id) => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${id}/status`, "utf8"))[1]) / 1024;

async function run(engine, more, want, name) {
    const { page, log, close } = await openPage("about:blank", { width, height });
    const browser = await page.context().browser().newBrowserCDPSession();
    const processes = async () => (await browser.send("SystemInfo.getProcessInfo")).processInfo;
    const cpu = async () => (await processes()).reduce((sum, { cpuTime }) => sum + cpuTime, 0);
    try {
        await page.addInitScript(count);
        const started = await cpu();
        await page.goto(`http://127.0.0.1:${pages.address().port}/`);
        await page.waitForFunction(() => window.ready === true);
        const what = { ...more, server: `${source.url}/`, file: `/exported/city.${values.form}`, ext: values.form, fov: FOV, away, up, step, poses };
        await page.evaluate(([e, w]) => window.start(e, w), [engine, what]);
        const loaded = await page.evaluate(() => ({ ...window.own, ...window.gpu }));
        const loadCpu = (await cpu()) - started;
        await page.evaluate(() => window.own.back());
        const shot = { timeout: PATIENCE_MS, ...(values.shots && { path: join(values.shots, `${name.replaceAll(/\W+/g, "-")}.png`) }) };
        const { covered } = ssim(decodePng(await page.screenshot(shot)), want);
        const before = [await cpu(), await page.evaluate(() => window.gpu.sent)];
        const turned = await page.evaluate((n) => window.own.turnAll(n), frames);
        const turnCpu = ((await cpu()) - before[0]) / frames;
        const sent = await page.evaluate(() => window.gpu.sent);
        const session = await page.context().newCDPSession(page);
        await session.send("HeapProfiler.collectGarbage");
        const heap = await session.send("Runtime.getHeapUsage");
        const all = await processes();
        const pageId = all.filter(({ type }) => type === "renderer").sort((a, b) => b.cpuTime - a.cpuTime)[0].id;
        if (log.length) throw new Error(log.join("\n"));
        return {
            first: loaded.firstMs / 1e3,
            whole: loaded.restMs / 1e3,
            loadCpu,
            frame: turned.ms.toSorted((a, b) => a - b)[frames >> 1],
            turnCpu: 1000 * turnCpu,
            pixels: `${turned.size.join(" x ")}`,
            gaussians: loaded.gaussians,
            sent: megabytes(loaded.sent),
            perFrame: megabytes((sent - before[1]) / frames),
            held: megabytes(await page.evaluate(() => window.gpu.held)),
            heldMost: megabytes(await page.evaluate(() => window.gpu.heldMost)),
            heap: megabytes(heap.usedSize),
            buffers: megabytes(heap.backingStorageSize ?? 0),
            resident: residentMb(pageId),
            ssim: covered,
            unknown: await page.evaluate(() => window.gpu.unknown ?? []),
        };
    } finally {
        await close();
    }
}

let poses;
try {
    await new Promise((done) => pages.listen(0, "127.0.0.1", done));
    for (const ext of new Set(["ply", values.form])) execFileSync(BIN, ["export", store, "-q", "-o", join(dir, `city.${ext}`)], { stdio: "ignore" });
    const info = execFileSync(BIN, ["info", store], { encoding: "utf8" });
    const [lon, lat, h] = /origin_lon_lat_h\s+(.*)/.exec(info)[1].split(",").map(Number);
    const angle = (i) => (i * step * Math.PI) / 180;
    poses = Array.from({ length: frames + 1 }, (_, i) => poseOf({ lon, lat, h }, [away * Math.sin(angle(i)), up, away * Math.cos(angle(i))]));
    const want = drawServed();
    const found = new Map(ENGINES.map(([name]) => [name, []]));
    for (let round = 0; round < Number(values.rounds); round++)
        for (const [name, engine, more] of ENGINES) {
            const one = await run(engine, more, want, name);
            found.get(name).push(one);
            console.error(`${name}: ${JSON.stringify(one)}`);
        }
    const size = megabytes(statSync(join(dir, `city.${values.form}`)).size).toFixed(1);
    console.log(`${width} x ${height}, .${values.form} ${size} MB, load ${loadavg().map((v) => v.toFixed(1)).join(" ")}\n`);
    console.log("| | Gaussians | first picture, whole, s | CPU till then, s | a frame, ms | CPU a frame, ms | pixels while turning | to the card, MB | a frame, MB | on the card, MB | heap, buffers, MB | process of the page, MB | SSIM |");
    console.log(`|---|${"---:|".repeat(12)}`);
    for (const [name, runs] of found) {
        const m = (of, digits) => runs.map((one) => one[of]).toSorted((a, b) => a - b)[runs.length >> 1].toFixed(digits);
        const cells = [runs[0].gaussians, `${m("first", 1)}, ${m("whole", 1)}`, m("loadCpu", 1), m("frame", 0), m("turnCpu", 0), runs[0].pixels, m("sent", 1), m("perFrame", 2), m("held", 1), `${m("heap", 1)}, ${m("buffers", 1)}`, m("resident", 0), m("ssim", 3)];
        console.log(`| ${name} | ${cells.join(" | ")} |`);
    }
} finally {
    pages.close();
    rmSync(dir, { recursive: true, force: true });
    await source.close();
}
