// The viewer that lets the server draw: a video while the camera moves, or pictures, one request at a time; the full one
// at rest; and the offer of it on a slow machine.
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
import { firstDataSet, getBytes, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";
import { ssim } from "./lib/ssim.mjs";

const SIZE = { width: 640, height: 400 };
let why = MOCK || GIVEN_TILES ? "needs the test city on a server that draws" : "";

let source;
let proxy;
let viewer;
let page;

// In the page, before its scripts: counts decoders and frames, and those that were closed.
function countVideo() {
    const counts = (window.counts = { decoders: 0, decodersClosed: 0, frames: 0, framesClosed: 0 });
    window.VideoDecoder = class extends VideoDecoder {
        constructor({ output, error }) {
            super({ output: (frame) => (counts.frames++, output(frame)), error });
            counts.decoders++;
        }
        close() {
            counts.decodersClosed++;
            super.close();
        }
    };
    const { close } = VideoFrame.prototype;
    VideoFrame.prototype.close = function () {
        counts.framesClosed += this.format !== null; // null: it is closed already
        close.call(this);
    };
}
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
    viewer = await openViewer(`${proxy.url}/?thin`, { ...SIZE, init: countVideo });
    page = viewer.page;
});
after(async () => {
    await viewer?.close();
    await proxy?.down();
    await source?.close();
});

const pictures = () => proxy.log.filter(({ path }) => path.includes("/static/"));
const streams = () => proxy.log.filter(({ path }) => path.includes("?video="));
const countsOf = (page) => page.evaluate(() => ({ ...window.counts }));
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

// The camera turns in every frame until some pictures were seen, from a heading on; how long a frame takes is not asked.
// { seen, frames, last }: what is told of each picture; when each frame's camera had turned, and where to; the last heading.
async function turn(page, from, enough, most = 600) {
    return page.evaluate(
        async ([heading, enough, most]) => {
            const { viewer } = window.citysplat;
            const from = viewer.pose;
            const seen = [];
            const frames = [];
            const off = viewer.on("picture", (info) => seen.push(info));
            for (let i = 0; i < most && seen.length < enough; i++) {
                viewer.lookAt({ ...from, heading: (heading += 0.5) });
                frames.push({ at: Date.now(), heading });
                await new Promise(requestAnimationFrame);
            }
            off();
            return { seen, frames, last: heading };
        },
        [from, enough, most],
    );
}

// How far what the page shows is from the picture that the server draws of this view at that size.
function apartFromServer(page) {
    return page.evaluate(async () => {
        const canvas = document.querySelector(".citysplat-picture");
        const { width, height } = canvas;
        const url = window.citysplat.viewer.serverPicture(width, height);
        url.searchParams.set("background", "sky");
        const bitmap = await createImageBitmap(await (await fetch(url)).blob());
        const own = new OffscreenCanvas(width, height).getContext("2d");
        own.drawImage(bitmap, 0, 0);
        const [a, b] = [canvas.getContext("2d"), own].map((context) => context.getImageData(0, 0, width, height).data);
        return { width, height, most: a.reduce((most, v, i) => Math.max(most, Math.abs(v - b[i])), 0) };
    });
}

test("moving: a video; at rest the picture that the server draws", async (t) => {
    if (why) return t.skip(why);
    proxy.log = [];
    // The last frame of the video is that of the camera at rest.
    await page.evaluate(() => {
        window.frame = null;
        const { viewer } = window.citysplat;
        viewer.on("picture", ({ moving, video, width, height }) => {
            if (!moving) return;
            const view = viewer.serverPicture(width, height).href;
            window.frame = { video, view, data: document.querySelector(".citysplat-picture").toDataURL("image/png") };
        });
    });
    const { seen } = await turn(page, 10, 20);
    await waitForViewer(page);
    const counts = await countsOf(page);
    const films = seen.filter(({ video }) => video);
    t.diagnostic(`${films.length} frames, ${films.map(({ bytes }) => bytes).join(", ")} bytes; ${JSON.stringify(counts)}`);
    // Where this machine sends no camera for a while, the server takes it to rest: a sharp picture comes between frames.
    assert.ok(films.length >= 15, `${films.length} frames of ${seen.length} pictures`);
    assert.equal(streams().length, 1);
    assert.ok(pictures().length <= 2, `${pictures().length} single pictures beside the stream`);
    assert.deepEqual([counts.decoders, counts.framesClosed], [1, counts.frames]);
    assert.ok(counts.frames >= films.length);

    assert.deepEqual(await apartFromServer(page), { ...SIZE, most: 0 });
    const { video, view, data } = await page.evaluate(() => window.frame);
    const small = decodePng(await getBytes(`${view.replace(/\.jpg/, ".png")}?background=sky`));
    const frame = decodePng(Buffer.from(data.split(",")[1], "base64"));
    const moving = ssim(frame, small).whole;
    const means = [frame, small].map(meanColour);
    t.diagnostic(`SSIM ${moving.toFixed(4)} of the last frame (${frame.width} px, ${means.join(" | ")})`);
    assert.ok(video && moving > 0.95, `SSIM ${moving} of the last frame`);
    means[0].forEach((v, i) => assert.ok(Math.abs(v - means[1][i]) < 2, `colours: ${means.join(" | ")}`));
});

function meanColour({ width, height, at }) {
    const sums = [0, 0, 0];
    for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) at(x, y).forEach((v, i) => i < 3 && (sums[i] += v));
    return sums.map((sum) => Math.round((10 * sum) / (width * height)) / 10);
}

// Headings name the poses: a picture's request must be of the pose that was the newest when it was sent.
// On a busy machine the proxy learns so much later that an answer has ended than the page does.
const LATE_MS = 150;

test("no video: small pictures one by one, of the newest pose; at rest the full one", async (t) => {
    if (why) return t.skip(why);
    const other = await openViewer(`${proxy.url}/?thin`, { ...SIZE, init: () => delete window.VideoDecoder });
    const { page } = other;
    await page.evaluate(() => {
        window.told = [];
        window.citysplat.viewer.on("problem", ({ kind }) => window.told.push(kind));
    });
    await turn(page, 300, 2); // that there is no video
    await waitForViewer(page);
    proxy.log = [];
    proxy.latencyMs = 30;
    // Small: pictures grow by a third while they come quickly, and on a quick machine none may grow to the full size here.
    await page.evaluate(() => (window.citysplat.viewer.pictures.area = 20_000));
    // Beside 20, the heading at home: its full picture is in the browser's store, and would not be asked for.
    const { seen, frames, last } = await turn(page, 10.25, 6);
    await waitForViewer(page);
    proxy.latencyMs = 0;
    const asked = pictures().map((one) => ({ ...one, px: sizeOf(one), heading: headingOf(one) }));
    t.diagnostic(`${seen.length} pictures in ${frames.length} frames`);
    t.diagnostic(asked.map(({ px, heading }) => `${px} px at ${heading}`).join(", "));
    assert.ok(seen.length >= 6, `${seen.length} pictures while the camera moved`);
    assert.ok(seen.every(({ moving, video }) => moving && !video), "a full picture while the camera moved");
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
    // There and back again: what is left is the full picture, though it is that of before.
    await page.evaluate(async () => {
        const { viewer } = window.citysplat;
        const from = viewer.pose;
        const small = new Promise((done) => viewer.on("picture", done));
        viewer.lookAt({ ...from, heading: from.heading + 5 });
        await small;
        viewer.lookAt(from);
    });
    await waitForViewer(page);
    assert.equal(await page.evaluate(() => document.querySelector(".citysplat-picture").width), SIZE.width);
    assert.deepEqual(await page.evaluate(() => window.told), ["noVideo"]);
    assert.equal(streams().length, 0);
    await other.close();
});

// In the page: the third frame breaks the decoder.
function breakDecoder() {
    window.VideoDecoder = class extends VideoDecoder {
        constructor(init) {
            super(init);
            this.init = init;
            this.left = 3;
        }
        decode(chunk) {
            if (--this.left) return super.decode(chunk);
            super.close();
            this.init.error(new DOMException("broken", "EncodingError"));
        }
    };
}

test("a decoder that fails: it is said once, and pictures come one by one", async (t) => {
    if (why) return t.skip(why);
    const other = await openViewer(`${proxy.url}/?thin`, { ...SIZE, init: breakDecoder });
    const { page } = other;
    await page.evaluate(() => {
        window.told = [];
        window.citysplat.viewer.on("problem", (problem) => window.told.push(problem.message));
    });
    proxy.log = [];
    const { seen, last } = await turn(page, 10.25, 12);
    await waitForViewer(page);
    assert.ok(seen.filter(({ video }) => video).length <= 2);
    assert.ok(seen.slice(5).every(({ video }) => !video));
    assert.deepEqual(await page.evaluate(() => window.told.map((text) => text.includes("(broken)"))), [true]);
    assert.deepEqual(streams().map(({ aborted }) => aborted), [true]);
    assert.deepEqual([sizeOf(pictures().at(-1)), headingOf(pictures().at(-1))], [SIZE.width, last]);
    assert.deepEqual(other.log.filter((line) => !line.startsWith("failed:")), []);
    await other.close();
});

const until = async (what, condition, ms = 30_000) => {
    for (const end = Date.now() + ms; !(await condition()); ) {
        assert.ok(Date.now() < end, what);
        await new Promise((done) => setTimeout(done, 50));
    }
};
const hide = (hidden) =>
    page.evaluate((value) => {
        Object.defineProperty(document, "hidden", { value, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
    }, hidden);

test("a stream goes on in another size, and ends while nobody looks or nothing moves", async (t) => {
    if (why) return t.skip(why);
    await hide(true); // ends that of the tests above
    await hide(false);
    proxy.log = [];
    await turn(page, 10, 6);
    await page.setViewportSize({ width: 500, height: 420 });
    const { seen } = await turn(page, 30, 12);
    await waitForViewer(page);
    const ratio = (v) => v.width / v.height;
    const changed = seen.findIndex((one) => Math.abs(ratio(one) - 500 / 420) < 0.05);
    assert.ok(changed >= 0 && seen.slice(changed).every(({ video }) => video), JSON.stringify(seen));
    assert.deepEqual(streams().map(({ aborted }) => aborted), [false]);
    assert.deepEqual(await apartFromServer(page), { width: 500, height: 420, most: 0 });

    await hide(true);
    await until("the stream goes on while nobody looks", () => streams()[0].aborted);
    await hide(false);
    await page.setViewportSize(SIZE);
    await turn(page, 50, 6);
    await waitForViewer(page);
    assert.equal(streams().length, 2);
    await until("the stream goes on while nothing moves", () => streams()[1].aborted);
    const counts = await countsOf(page);
    assert.deepEqual([counts.decodersClosed, counts.framesClosed], [counts.decoders, counts.frames]);
});

test("the server away: the last picture stays, and the next comes by itself", async (t) => {
    if (why) return t.skip(why);
    await turn(page, 10, 6); // a stream is open
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

const STEER_MS = 15_000;

test("steering leaves nothing behind", async (t) => {
    if (why) return t.skip(why);
    const steered = await openViewer(`${proxy.url}/?thin`, { ...SIZE, init: countVideo });
    const { page } = steered;
    const session = await page.context().newCDPSession(page);
    const heap = async () => {
        await session.send("HeapProfiler.collectGarbage");
        return (await session.send("Runtime.getHeapUsage")).usedSize / 2 ** 20;
    };
    proxy.log = [];
    await turn(page, 0, 20);
    await waitForViewer(page);
    const before = await heap();
    for (const end = Date.now() + STEER_MS; Date.now() < end; ) await turn(page, Math.random() * 360, 60, 200);
    await waitForViewer(page);
    const [counts, after] = [await countsOf(page), await heap()];
    t.diagnostic(`${JSON.stringify(counts)}, heap ${before.toFixed(2)}, then ${after.toFixed(2)} MB`);
    assert.ok(counts.frames > STEER_MS / 600, `${counts.frames} frames in ${STEER_MS} ms`);
    assert.deepEqual([counts.decoders, counts.framesClosed], [1, counts.frames]);
    assert.equal(streams().length, 1);
    assert.ok(after - before < 2, `${after - before} MB more`);
    await page.evaluate(() => window.citysplat.viewer.dispose());
    await until("the stream outlives the viewer", () => streams()[0].aborted);
    const { decoders, decodersClosed } = await countsOf(page);
    assert.equal(decodersClosed, decoders);
    await steered.close();
});
