// Cross-fade between levels: the rule against tests/vectors/fade.json, which tests/lab/test_fade.c runs through
// lab/eval/fade.c; and in the browser, where the camera jumps to where other levels are wanted, and all that changes
// from frame to frame after the jump is levels.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { lookViewer, openPage, waitForViewer } from "./lib/browser.mjs";
import { SOUTH } from "./lib/checks.mjs";
import { ORIGIN } from "./lib/city.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const FADE = new URL("../../web/src/fade.ts", import.meta.url);
const { code } = createRequire(FADE)("esbuild").transformSync(readFileSync(FADE, "utf8"), { loader: "ts" });
const { Fade, FADE_STEP_MOST, FadeClock, fadeShare } = await import(`data:text/javascript,${encodeURIComponent(code)}`);
const VECTORS = JSON.parse(readFileSync(new URL("../vectors/fade.json", import.meta.url), "utf8"));

const FAR = { ...placeOfEnu(ORIGIN, [0, -1100, 820]), heading: 0, pitch: -36, fov: 45 };
const SIZE = { width: 480, height: 320 };
const EDGE_M = 24; // of tiles: several levels between both views
const FADE_MS = 600_000; // longer than any test: the test moves the clock of fades, by a step each frame
const STEPS = Math.round(1 / FADE_STEP_MOST); // of slow frames; of 280 ms at 60 frames a second one less
const POP_MOST = 16; // of 255, in any pixel from frame to frame
const SAME = 2; // of 255: Gaussians at one depth are drawn in the order in which their tiles came
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };

test("the curve is that of lab/eval/fade.c", () => {
    for (const [t, share] of VECTORS.curve) assert.equal(fadeShare(t), share);
});

const areaOf = ([z, x, y]) => [x / 2 ** z, (x + 1) / 2 ** z, y / 2 ** z, (y + 1) / 2 ** z];
const shareIn = (pieces, block) => (pieces.some((piece) => piece.block === block) ? 1 : 0);

test("a slow frame takes a fade no further than a step, and a quick one by its time", () => {
    const framesOf = (frameMs, fadeMs) => {
        const clock = new FadeClock();
        let frames = 0;
        for (let now = 1000; clock.spent < 1; now += frameMs, frames++) {
            const before = clock.spent;
            clock.tick(now, fadeMs);
            assert.ok(clock.spent - before < FADE_STEP_MOST + 1e-9);
        }
            return frames - 1; // the first begins it
    };
    assert.equal(framesOf(70, 280), STEPS);
    assert.ok(Math.abs(framesOf(10, 280) - 28) <= 1);
    assert.equal(framesOf(5000, 280), STEPS);
});

for (const { what, tiles, frames, steps } of VECTORS.cases)
    test(`the rule: ${what}`, () => {
        const fade = new Fade();
        const pieces = tiles.map((key) => ({ block: { area: areaOf(key) }, without: [] }));
        let frame = 0;
        for (const [k, { wanted, drawn }] of steps.entries()) {
            if (frame && ++frame === frames) [fade.from, frame] = [null, 0];
            const begins = !frame;
            fade.want(wanted.map((i) => pieces[i]), frames > 1);
            if (begins && fade.from) frame = 1;
            const share = fadeShare(frame ? frame / frames : 1);
            const shares = pieces.map(({ block }) => {
                const to = shareIn(fade.to, block);
                return 8 * (share * to + (1 - share) * (fade.from ? shareIn(fade.from, block) : to));
            });
            const seen = shares.map((value, i) => [i, value]).filter(([, value]) => value > 0);
            assert.deepEqual(seen, drawn, `frame ${k}`);
        }
    });

test("a tile in place of a part of another takes that part alone, and what is thrown away is gone", () => {
    const [all, one, two] = [[0, 0, 0], [1, 0, 0], [1, 1, 0]].map((key) => ({ area: areaOf(key) }));
    const fade = new Fade();
    const part = (block, ...without) => ({ block, without });
    assert.ok(fade.want([part(all)], true));
    assert.equal(fade.from, null);
    assert.ok(fade.want([part(all, one), part(one)], true));
    assert.deepEqual(fade.from, [part(all)]);
    fade.from = null; // it is over
    assert.ok(!fade.want([part(all, one), part(one)], true));
    assert.ok(fade.want([part(all, one, two), part(one), part(two)], true));
    assert.deepEqual(fade.from, [part(all, one), part(one)]);
    assert.ok(!fade.drop({ area: areaOf([1, 1, 1]) }), "a block that is not drawn");
    assert.ok(fade.drop(all));
    assert.equal(fade.from, null);
    assert.deepEqual(fade.to, [part(one), part(two)]);
});

let source;
before(async () => {
    if (!skip.skip) source = await openSource({ edgeM: EDGE_M });
});
after(() => source?.close());

// Looks at FAR, then jumps to SOUTH and back: of each, what frames after the jump changed, as means and as largest
// 99 % quantile in 1/255, how far those of it were from what lies between first and last, and the last one's pixels.
async function jump(more, context = {}) {
    const { page, log, close } = await openPage(`${source.url}/?backdrop=off&ui=off${more}`, { ...SIZE, ...context });
    try {
        await page.waitForFunction(() => window.citysplat?.viewer.city);
        await page.evaluate((steps) => {
            const { viewer } = window.citysplat;
            const { canvas } = viewer;
            const { clientWidth: width, clientHeight: height } = canvas;
            const copy = Object.assign(document.createElement("canvas"), { width, height });
            const context = copy.getContext("2d", { willReadFrequently: true });
            // Of the largest difference of a pixel's channels: the mean, and what 1 % of the pixels reach.
            window.differ = (a, b) => {
                const counts = new Array(256).fill(0);
                for (let i = 0; i < a.length; i += 4)
                    counts[Math.max(...[0, 1, 2].map((c) => Math.abs(a[i + c] - b[i + c])))]++;
                const most = counts.findLastIndex((count) => count > 0);
                let [q99, above] = [255, 0];
                while (q99 > 0 && (above += counts[q99]) < a.length / 400) q99--;
                return { mean: counts.reduce((sum, n, d) => sum + n * d, 0) / (a.length / 4), q99, most };
            };
            viewer.on("frame", () => {
                const pose = JSON.stringify(viewer.pose);
                context.drawImage(canvas, 0, 0, width, height);
                const { data } = context.getImageData(0, 0, width, height);
                if (pose !== window.pose) [window.frames, window.step] = [[], 0];
                window.pose = pose;
                const { engine } = viewer.city;
                window.frames.push({ data, fading: engine.fading });
                if (engine.shownClock) engine.shownClock.spent = Math.min(1, ++window.step / steps);
            });
        }, STEPS);
        await waitForViewer(page);
        await lookViewer(page, SOUTH);
        await lookViewer(page, FAR); // all tiles of both are there now
        const looks = [];
        for (const pose of [SOUTH, FAR]) {
            await page.evaluate(() => (window.citysplat.viewer.pace.sharpness = 1)); // all pixels at once
            await lookViewer(page, pose);
            looks.push(
                await page.evaluate(() => {
                    const { frames, differ } = window;
                    const [a, b] = [frames[0].data, frames.at(-1).data];
                    const steps = frames.slice(1).map(({ data }, i) => differ(frames[i].data, data));
                    const strays = frames
                        .slice(1, -1)
                        .map(({ data }) => {
                            const near = data.map((v, i) =>
                                Math.max(Math.min(a[i], b[i]), Math.min(Math.max(a[i], b[i]), v)),
                            );
                            return differ(near, data).q99;
                        });
                    return {
                        frames: frames.length,
                        faded: frames.filter(({ fading }) => fading).length,
                        all: differ(a, b),
                        mean: Math.max(...steps.map(({ mean }) => mean)),
                        q99: Math.max(...steps.map(({ q99 }) => q99)),
                        most: Math.max(...steps.map(({ most }) => most)),
                        stray: Math.max(0, ...strays),
                        last: b,
                    };
                }),
            );
            Object.assign(looks.at(-1), await page.evaluate(() => window.citysplat.state));
        }
        // Turns end a little after the last frame, later on a busy machine: of the first second without any.
        const rest = await page.evaluate(async () => {
            const { viewer } = window.citysplat;
            const counts = {};
            const ends = ["turn", "frame"].map((name) => viewer.on(name, () => counts[name]++));
            for (let second = 0; second < 10; second++) {
                Object.assign(counts, { turn: 0, frame: 0 });
                await new Promise((done) => setTimeout(done, 1000));
                if (!counts.turn && !counts.frame) break;
            }
            for (const end of ends) end();
            return { turns: counts.turn, drawn: counts.frame, left: viewer.city.engine.leaving.size };
        });
        assert.deepEqual(log, []);
        return { looks, rest };
    } finally {
        await close();
    }
}

const numbers = ({ frames, faded, all, mean, q99, most, stray }) =>
    JSON.stringify({ frames, faded, all, mean, q99, most, stray });
const differs = (a, b) => Object.keys(a).filter((i) => Math.abs(a[i] - b[i]) > SAME).length;

test("levels fade into each other, and the viewer comes to rest with the same picture", skip, async (t) => {
    const atOnce = await jump("&crossfade=0");
    const faded = await jump(`&crossfade=${FADE_MS}`);
    for (const [i, where] of ["nearer", "farther"].entries()) {
        const [one, other] = [atOnce.looks[i], faded.looks[i]];
        t.diagnostic(`${where}: at once ${numbers(one)}, faded ${numbers(other)}`);
        assert.equal(one.faded, 0);
        assert.ok(other.faded >= STEPS, `${other.faded} frames of a fade`);
        assert.ok(other.mean < 0.6 * one.mean, `a frame changes by ${other.mean}, at once ${one.mean}`);
        assert.ok(other.q99 <= 0.6 * one.q99, `a frame changes by ${other.q99}, at once ${one.q99}`);
        assert.ok(other.stray <= 0.6 * one.q99, `a picture on the way is ${other.stray} beyond both`);
        assert.ok(other.most <= POP_MOST, `a pixel of a frame changes by ${other.most}`);
        assert.equal(differs(one.last, other.last), 0);
        assert.deepEqual([one.tiles, one.gaussians], [other.tiles, other.gaussians]);
    }
    assert.deepEqual(faded.rest, { turns: 0, drawn: 0, left: 0 });
});

test("no fade where motion is not wanted", skip, async () => {
    const { looks, rest } = await jump(`&crossfade=${FADE_MS}`, { reducedMotion: "reduce" });
    for (const look of looks) assert.equal(look.faded, 0, numbers(look));
    assert.deepEqual(rest, { turns: 0, drawn: 0, left: 0 });
});
