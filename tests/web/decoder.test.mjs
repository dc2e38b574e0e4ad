// The client's SPZ decoder (web/src/spz.ts) against the definition: what it packs for the graphics
// card, unpacked again as the card does it, must be what the file says.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { gunzipSync } from "node:zlib";

import { decodeSpz as decodeReference, encodeSpz, unpackRotation } from "./lib/spz.mjs";

const HALF_STEP = 2 ** -10; // relative: half floats have 11 bits
// Twice the worst error of an axis on a 1024 x 1024 octahedral grid, for half turns.
const ROTATION_MAX_DEG = 0.5;
const HARMONIC_STEP = 1 / 127; // 8 bits below the next power of two

const SOURCE = fileURLToPath(new URL("../../web/src/spz.ts", import.meta.url));
const { transformSync } = createRequire(SOURCE)("esbuild");
const { code } = transformSync(readFileSync(SOURCE, "utf8"), { loader: "ts", target: "es2022" });
const { decodeSpz } = await import(`data:text/javascript,${encodeURIComponent(code)}`);

// A small generator of its own, so that the fixture never changes.
function makeRandom(seed) {
    let state = seed;
    return () => {
        state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
        return state / 2 ** 32;
    };
}

function makeSplats(count) {
    const random = makeRandom(7);
    const signed = (range) => (2 * random() - 1) * range;
    return Array.from({ length: count }, (_, i) => ({
        pos: [signed(2000), signed(2000), signed(2000)],
        sigma: [0, 1, 2].map(() => Math.exp(signed(8) - 2)),
        rgb: [random(), random(), random()],
        opacity: random(),
        quat: i === 0 ? [1, 0, 0, 0] : [signed(1), signed(1), signed(1), signed(1)],
        sh1: Array.from({ length: 45 }, () => signed(1)),
    }));
}

function halfToNumber(h) {
    const sign = h & 0x8000 ? -1 : 1;
    const exponent = (h >> 10) & 31;
    const fraction = h & 1023;
    return (
        sign * (exponent === 0 ? fraction * 2 ** -24 : (1 + fraction / 1024) * 2 ** (exponent - 15))
    );
}

// Octahedral axis and angle -> x y z w.
function unpackOctahedral(packed) {
    let x = ((packed & 1023) / 1023) * 2 - 1;
    let y = (((packed >>> 10) & 1023) / 1023) * 2 - 1;
    const z = 1 - Math.abs(x) - Math.abs(y);
    const t = Math.max(-z, 0);
    x += x >= 0 ? -t : t;
    y += y >= 0 ? -t : t;
    const half = ((packed >>> 20) / 4095) * Math.PI * 0.5;
    const scale = Math.sin(half) / Math.hypot(x, y, z);
    return [x * scale, y * scale, z * scale, Math.cos(half)];
}

function unpackHarmonic(packed) {
    const unit = 2 ** ((packed >>> 27) - 15) / 255;
    return [0, 1, 2].map(
        (k) => ((packed >>> (8 * k)) & 255) * unit * (packed & (1 << (24 + k)) ? -1 : 1),
    );
}

const near = (got, want, tolerance, what) =>
    assert.ok(
        Math.abs(got - want) <= tolerance,
        `${what}: got ${got}, want ${want}, tolerance ${tolerance}`,
    );

for (const degree of [0, 1, 2, 3]) {
    test(`degree ${degree}: every field comes back`, () => {
        const spz = encodeSpz(makeSplats(3000), degree, degree === 2);
        const want = decodeReference(spz);
        const got = decodeSpz(new Uint8Array(gunzipSync(spz)));
        assert.deepEqual([got.count, got.shDegree, got.antialiased], [3000, degree, degree === 2]);
        const centres = new Float32Array(got.extA.buffer);
        for (let i = 0; i < want.count; i++) {
            for (let k = 0; k < 3; k++)
                assert.equal(centres[4 * i + k], want.position[3 * i + k] / 4096, `position ${i}`);
            near(halfToNumber(got.extA[4 * i + 3]), want.alpha[i] / 255, HALF_STEP, `opacity ${i}`);
            const b = [0, 1, 2].map((k) => got.extB[4 * i + k]);
            const halves = b.flatMap((w) => [halfToNumber(w & 0xffff), halfToNumber(w >>> 16)]);
            for (let k = 0; k < 3; k++) {
                const color =
                    0.5 + (0.28209479177387814 * (want.color[3 * i + k] / 255 - 0.5)) / 0.15;
                near(halves[k], color, HALF_STEP * 2, `colour ${i}`);
                near(halves[3 + k], want.scale[3 * i + k] / 16 - 10, HALF_STEP * 10, `scale ${i}`);
            }
            const p = unpackRotation(want.rotation[i]);
            const q = unpackOctahedral(got.extB[4 * i + 3]);
            const dot = Math.min(1, Math.abs(p.reduce((sum, v, k) => sum + v * q[k], 0)));
            near((2 * Math.acos(dot) * 180) / Math.PI, 0, ROTATION_MAX_DEG, `rotation ${i}`);
        }
    });

    test(`degree ${degree}: every harmonic is in its place and none saturates`, () => {
        const spz = encodeSpz(makeSplats(500), degree);
        const want = decodeReference(spz);
        const got = decodeSpz(new Uint8Array(gunzipSync(spz)));
        const coefs = (degree + 1) ** 2 - 1;
        // Spark's layout: three of degree 1 and the first of degree 2 in sh1, four in sh2, 4 + 3 in
        // sh3a and sh3b.
        const slots = [
            ["sh1", 0],
            ["sh1", 1],
            ["sh1", 2],
            ["sh1", 3],
            ["sh2", 0],
            ["sh2", 1],
            ["sh2", 2],
            ["sh2", 3],
            ["sh3a", 0],
            ["sh3a", 1],
            ["sh3a", 2],
            ["sh3a", 3],
            ["sh3b", 0],
            ["sh3b", 1],
            ["sh3b", 2],
        ];
        assert.deepEqual(
            Object.keys(got.sh),
            [[], ["sh1"], ["sh1", "sh2"], ["sh1", "sh2", "sh3a", "sh3b"]][degree],
        );
        for (let i = 0; i < want.count; i++) {
            for (let c = 0; c < coefs; c++) {
                const [name, word] = slots[c];
                const rgb = unpackHarmonic(got.sh[name][4 * i + word]);
                for (let k = 0; k < 3; k++) {
                    near(
                        rgb[k],
                        (want.sh[3 * (i * coefs + c) + k] - 128) / 128,
                        HARMONIC_STEP,
                        `row ${i}, coefficient ${c}`,
                    );
                }
            }
        }
    });
}

test("damaged files are refused", () => {
    const raw = new Uint8Array(gunzipSync(encodeSpz(makeSplats(10), 1)));
    const changed = (at, value) => Uint8Array.from(raw, (v, i) => (i === at ? value : v));
    assert.throws(() => decodeSpz(raw.slice(0, 10)), /shorter/);
    assert.throws(() => decodeSpz(raw.slice(0, -1)), /truncated/);
    assert.throws(() => decodeSpz(changed(0, 0)), /magic/);
    assert.throws(() => decodeSpz(changed(4, 4)), /version 4/);
    assert.throws(() => decodeSpz(changed(11, 255)), /Gaussians/);
    assert.throws(() => decodeSpz(changed(12, 4)), /degree 4/);
});

test("the extent of a scene leaves its strays out", () => {
    const splats = Array.from({ length: 1000 }, (_, i) => ({
        pos: [(i % 100) - 50, 0, Math.floor(i / 100)],
        sigma: [0.5, 0.5, 0.5],
        rgb: [0, 0, 0],
        opacity: 1,
        quat: [1, 0, 0, 0],
    }));
    splats.push({ ...splats[0], pos: [1900, 1900, 1900], sigma: [90, 90, 90] });
    const { core } = decodeSpz(new Uint8Array(gunzipSync(encodeSpz(splats, 0))));
    near(core.min[0], -45, 1.5, "west");
    near(core.max[0], 44, 1.5, "east");
    near(core.max[1], 0, 1e-6, "top");
});
