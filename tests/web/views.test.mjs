// Pictures that the server draws: backgrounds, depth, roll, scale. Each is checked against another one, so that
// what is drawn does not matter.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { SOUTH } from "./lib/checks.mjs";
import { makeCity, ORIGIN } from "./lib/city.mjs";
import { project } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, getJson, GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const [W, H] = [96, 64];
const FROND = { pos: [-30, -122, 25], sigma: [1.5, 1.5, 1.5], rgb: [1, 0, 0] }; // off the city's edge, above what it gives its colour to
let source;
let base;
let drawn;
before(async () => {
    source = await openSource({ gaussians: [...makeCity(), { ...makeCity()[0], ...FROND }] });
    const ds = await firstDataSet(source.url);
    const { splats } = await getJson(`${source.url}/collections/${ds}`);
    base = `${source.url}/d/${ds}/r/${splats.revision}/static`;
    const first = await fetch(view({ size: "8x8.png" }));
    drawn = first.status === 200;
    if (!drawn) assert.equal(first.status, 503, await first.text());
});
after(() => source?.close());

function view({ fov = 60, roll, pitch = SOUTH.pitch, size = `${W}x${H}.png`, query = "" } = {}) {
    const { heading } = SOUTH;
    const [lon, lat] = [SOUTH.lon, SOUTH.lat].map((v) => v.toFixed(7));
    const h = SOUTH.h.toFixed(3);
    const rolled = roll === undefined ? "" : `,${roll}`;
    return `${base}/${lon},${lat},${h}@${heading},${pitch},${fov}${rolled}/${size}${query}`;
}

async function fetched(options) {
    const response = await fetch(view(options));
    assert.equal(response.status, 200, `${view(options)}: ${response.status}`);
    return { bytes: Buffer.from(await response.arrayBuffer()), headers: response.headers };
}

const png = async (options) => decodePng((await fetched(options)).bytes);

function* pixels() {
    for (let y = 0; y < H; y++) for (let x = 0; x < W; x++) yield [x, y];
}

// A .npy of float32: { shape, at(x, y) }.
function decodeNpy(bytes) {
    assert.equal(bytes.toString("latin1", 1, 6), "NUMPY");
    const start = 10 + bytes.readUInt16LE(8);
    assert.equal(start % 64, 0);
    const head = bytes.toString("latin1", 10, start);
    assert.match(head, /'descr': '<f4', 'fortran_order': False/);
    const shape = /'shape': \((\d+), (\d+)\)/.exec(head).slice(1).map(Number);
    assert.equal(bytes.length, start + 4 * shape[0] * shape[1]);
    return { shape, at: (x, y) => bytes.readFloatLE(start + 4 * (y * shape[1] + x)) };
}

const device = (t) => drawn || t.skip("this machine has no OpenCL device");

test("a background is behind what is drawn", async (t) => {
    if (!device(t)) return;
    const [black, red, clear, sky] = await Promise.all(
        ["", "?background=ff0000", "?background=transparent", "?background=sky"].map((query) =>
            png({ query }),
        ),
    );
    let covered = 0;
    let open = 0;
    for (const [x, y] of pixels()) {
        const a = clear.alpha(x, y) / 255;
        covered += a > 0.9;
        open += a < 0.1;
        const [k, r, c, s] = [black, red, clear, sky].map((p) => p.at(x, y));
        for (let i = 0; i < 3; i++) {
            assert.ok(Math.abs(c[i] * a - k[i]) < 2.5, `${x},${y}: ${c} at ${a}, on black ${k}`);
            const want = Math.min(255, k[i] + (i ? 0 : (1 - a) * 255));
            assert.ok(Math.abs(r[i] - want) < 3, `${x},${y}: on red ${r}, ${want} wanted`);
            // Where the city's edge fades there is ground instead.
            assert.ok(s[i] >= k[i] - 2 || y > 0.8 * H, `${x},${y}: sky takes light away`);
        }
        if (a < 0.01 && y < 0.8 * H) assert.ok(Math.min(...s) > 90, `${x},${y}: no sky, ${s}`);
    }
    assert.ok(covered > 100 && open > 100, `${covered} covered, ${open} open`);
    const up = await png({ pitch: 15, query: "?background=sky" }); // from 45 degrees above the horizon to 15 below
    const [high, horizon, ground] = [2, H * 0.72, H - 1].map((y) => up.at(1, Math.round(y)));
    assert.ok(high[2] - high[0] > horizon[2] - horizon[0] + 20, `${high} above ${horizon}`);
    assert.ok(ground[1] < horizon[1] - 20, `${ground} below ${horizon}`); // its colours: light.test.mjs
});

test("before sky and ground nothing is left beyond the city's edge", { skip: MOCK || GIVEN_TILES ? "needs the test city" : false }, async (t) => {
    if (!device(t)) return;
    const [w, h] = [3 * W, 3 * H];
    const [bare, sky] = await Promise.all(["", "?background=sky"].map((query) => png({ size: `${w}x${h}.png`, query })));
    const at = project(ORIGIN, { ...SOUTH, fov: 60 }, FROND.pos, w, h);
    const red = (picture) => {
        const [r, g] = picture.mean(...at, 1);
        return r - g;
    };
    t.diagnostic(`redder than green by ${red(bare).toFixed(0)} before black, by ${red(sky).toFixed(0)} before ground`);
    assert.ok(red(bare) > 100 && red(sky) < 0.8 * red(bare), `${red(bare)}, ${red(sky)}`);
});

test("depth as PNG and as NumPy array is the same", async (t) => {
    if (!device(t)) return;
    const npy = decodeNpy((await fetched({ size: `${W}x${H}.npy` })).bytes);
    assert.deepEqual(npy.shape, [H, W]);
    const cm = await png({ query: "?depth=cm" });
    const m = await png({ query: "?depth=m" });
    assert.match(cm.text.Depth, /^unit_m=0.01;/);
    assert.match(m.text.Depth, /^unit_m=1;/);
    let seen = 0;
    for (const [x, y] of pixels()) {
        const z = npy.at(x, y);
        const [fine, coarse] = [cm.grey(x, y), m.grey(x, y)];
        if (Number.isNaN(z)) {
            assert.equal(fine + coarse, 0);
            continue;
        }
        seen++;
        assert.ok(z > 1 && z < 2000, `${z}`);
        assert.ok(Math.abs(Math.min(z, 655.35) - fine / 100) < 0.0051, `${z} m, ${fine} cm`);
        assert.ok(Math.abs(z - coarse) < 0.51, `${z} m, ${coarse} m`);
    }
    assert.ok(seen > 500, `${seen}`);
});

test("a camera that is turned over sees the picture turned over", async (t) => {
    if (!device(t)) return;
    const [upright, over, zero] = await Promise.all([
        png({}),
        png({ roll: 180 }),
        fetched({ roll: 0 }),
    ]);
    assert.deepEqual(zero.headers.get("etag"), (await fetched({})).headers.get("etag"));
    let far = 0;
    let plain = 0;
    for (const [x, y] of pixels()) {
        const a = upright.at(x, y);
        const b = over.at(W - 1 - x, H - 1 - y);
        const c = over.at(x, y);
        far = Math.max(far, ...a.map((v, i) => Math.abs(v - b[i])));
        plain = Math.max(plain, ...a.map((v, i) => Math.abs(v - c[i])));
    }
    assert.ok(far <= 6 && plain > 40, `${far} turned, ${plain} not`);
});

test("roll is clockwise: what was above is then to the left", async (t) => {
    if (!device(t)) return;
    const size = "64x64.png";
    const [upright, turned] = await Promise.all([png({ size }), png({ size, roll: 90 })]);
    let far = 0;
    for (let y = 4; y < 60; y++)
        for (let x = 4; x < 60; x++)
            far = Math.max(
                far,
                ...upright.at(x, y).map((v, i) => Math.abs(v - turned.at(y, 63 - x)[i])),
            );
    assert.ok(far <= 8, `${far}`);
});

test("@2x is twice the pixels of the same view", async (t) => {
    if (!device(t)) return;
    const [twice, large] = await Promise.all([
        fetched({ size: `${W}x${H}@2x.png` }),
        fetched({ size: `${2 * W}x${2 * H}.png` }),
    ]);
    assert.equal(twice.headers.get("etag"), large.headers.get("etag"));
    assert.ok(twice.bytes.equals(large.bytes));
    assert.equal(decodePng(twice.bytes).width, 2 * W);
});
