// The client's SPZ decoder (web/src/spz.ts) against the definition: what it gives to the graphics
// card must be what the file says, integer by integer. Its Draco reader (web/src/draco.ts) on heads
// that promise more than there is; whole tiles are read in appearance.test.mjs.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { gunzipSync } from "node:zlib";

import { importSource } from "./lib/bundle.mjs";
import { loosen } from "./lib/packed.mjs";
import { decodeSpz as decodeReference, encodeSpz } from "./lib/spz.mjs";

const { decodeSpz } = await importSource("spz.ts");
const { readDraco } = await importSource("draco.ts");

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

const near = (got, want, tolerance, what) =>
    assert.ok(
        Math.abs(got - want) <= tolerance,
        `${what}: got ${got}, want ${want}, tolerance ${tolerance}`,
    );

for (const degree of [0, 1, 2, 3]) {
    test(`degree ${degree}: every field comes back as it is stored`, () => {
        const spz = encodeSpz(makeSplats(3000), degree, degree === 2);
        const want = decodeReference(spz);
        const offset = [1000, -20, 0.5];
        const got = decodeSpz(new Uint8Array(gunzipSync(spz)), offset);
        assert.deepEqual([got.count, got.shDegree, got.antialiased], [3000, degree, degree === 2]);
        const fields = loosen(got);
        for (let i = 0; i < want.count; i++) {
            for (let k = 0; k < 3; k++) {
                const at = want.position[3 * i + k] / 4096 + offset[k];
                near(fields.centres[3 * i + k], at, 5e-4, `position ${i}`);
                assert.equal(fields.colors[4 * i + k], want.color[3 * i + k], `colour ${i}`);
                assert.equal(fields.scales[3 * i + k], want.scale[3 * i + k], `scale ${i}`);
            }
            assert.equal(fields.colors[4 * i + 3], want.alpha[i], `opacity ${i}`);
            assert.equal(fields.rotations[i], want.rotation[i], `rotation ${i}`);
        }
        assert.ok(got.heads.every((word, n) => n % 8 !== 3 || (word & 1) === Number(degree === 2)), "antialiased");
    });

    test(`degree ${degree}: every harmonic is in its place`, () => {
        const spz = encodeSpz(makeSplats(500), degree);
        const want = decodeReference(spz);
        const got = decodeSpz(new Uint8Array(gunzipSync(spz)));
        assert.deepEqual([...loosen(got).sh], [...want.sh]);
    });
}

test("rows are whole and what is left of them is empty", () => {
    const got = decodeSpz(new Uint8Array(gunzipSync(encodeSpz(makeSplats(1500), 1))));
    assert.deepEqual([got.base.length, got.heads.length], [4 * 2048, 8 * 2]);
    assert.ok(got.base.slice(4 * 1500).every((v) => v === 0));
});

// Neighbours in space, as tiles have them, and harmonics that a preset has left few steps of.
test("a Gaussian of a tile takes 36 bytes, and as many more as its row needs", async () => {
    const { centresOf, pack } = await importSource("pack.ts");
    const count = 4096;
    const random = makeRandom(11);
    const whole = (range) => Math.floor(random() * range);
    const perGaussian = ({ base, more }) => (4 * (base.length + more.length)) / count;
    const packed = (reach, most) => {
        const loose = {
            ...{ count, shDegree: 3, antialiased: true, unit: 2 ** -6, embedding: null },
            steps: Int32Array.from({ length: 3 * count }, () => whole(reach)),
            colors: Uint8Array.from({ length: 4 * count }, () => whole(256)),
            scales: Uint8Array.from({ length: 3 * count }, () => whole(256)),
            rotations: Uint32Array.from({ length: count }, () => whole(2 ** 32)),
            sh: Uint8Array.from({ length: 45 * count }, () => 128 + 4 * (whole(2 * most + 1) - most)),
        };
        const out = pack(loose, [100, 200, 300]);
        const got = loosen(out);
        for (const name of ["colors", "scales", "rotations", "sh"]) assert.deepEqual(got[name], loose[name], name);
        assert.deepEqual(got.centres, centresOf(out));
        got.centres.forEach((v, n) => near(v, loose.steps[n] / 64 + 100 * (1 + (n % 3)), 2e-2 * (reach / 2 ** 24), `${n}`));
        return perGaussian(out);
    };
    assert.equal(packed(2 ** 12, 3), 36);
    assert.equal(packed(2 ** 12, 0), 16);
    assert.equal(packed(2 ** 12, 7), 48);
    assert.equal(packed(2 ** 12, 31), 64);
    assert.equal(packed(2 ** 24, 0), 20);
});

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

// A point cloud of Draco: its attributes as [id, components], and what follows their heads.
function makeDraco(count, attributes, rest = []) {
    const counted = [count, count >> 8, count >> 16, count >> 24].map((v) => v & 255);
    const heads = attributes.flatMap(([id, components]) => [0, 5, components, 0, id]);
    return Uint8Array.from([
        ...Buffer.from("DRACO"),
        ...[2, 2, 0, 0, 0, 0],
        ...counted,
        ...[1, attributes.length],
        ...heads,
        ...attributes.map(() => 1),
        ...rest,
    ]);
}

test("a Draco head that promises more than there is gets no memory", () => {
    const plain = [254, 0, 1, 2, 3, 4, 5, 6, 7]; // no prediction, bytes; signs in the lowest bit
    const cloud = readDraco(makeDraco(2, [[7, 3]], plain), 2);
    assert.deepEqual([...cloud.attributes.get(7).values], [1, -2, 2, -3, 3, -4]);
    const most = 1 << 22;
    const refuse = (file, why) => assert.throws(() => readDraco(file, most), why);
    refuse(makeDraco(most + 1, [[0, 3]]), /4194305 points/);
    refuse(makeDraco(1, [[0, 0]]), /of 0 components/);
    refuse(makeDraco(1, [[0, 65]]), /of 65 components/);
    const wide = Array.from({ length: 64 }, (_, id) => [id, 64]);
    refuse(makeDraco(most, wide), /4194304 points of 4096 numbers/);
    refuse(makeDraco(most, [[0, 1]], plain), /4194304 points of 1 numbers in \d+ bytes/);
    refuse(makeDraco(1, [[0, 1], [0, 1]], [254, 0, 1, 2, 254, 0, 1, 2]), /attribute 0 twice/);
});
