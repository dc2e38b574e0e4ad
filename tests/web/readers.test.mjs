// Other people's readers on the served files: splat-transform (PlayCanvas) reads .spz, .sog, .ply
// and .compressed.ply, Google's draco3d decodes .drc. All must give the Gaussians that our own small decoder finds in
// the glTF tile.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";

import { decodeDrc } from "./lib/drc.mjs";
import { findSpz } from "./lib/glb.mjs";
import { readPly } from "./lib/ply.mjs";
import { firstDataSet, getBytes, getJson, MOCK, openSource } from "./lib/source.mjs";
import { decodeSpz, unpackRotation } from "./lib/spz.mjs";
import { listContents } from "./lib/tileset.mjs";

const require = createRequire(import.meta.url);
const TRANSFORM = join(dirname(require.resolve("@playcanvas/splat-transform")), "../bin/cli.mjs");
const TILES_MAX = 6; // enough of a large store
const FLOAT_TOLERANCE = 2e-6; // relative: the readers work in float32
const skip = MOCK ? "the mock serves glTF alone" : false;

let source;
let dir;
let tiles = [];
before(async () => {
    source = await openSource();
    dir = mkdtempSync(join(tmpdir(), "citysplat-readers-"));
    if (MOCK) return;
    const url = `${source.url}/d/${await firstDataSet(source.url)}/tileset.json`;
    const all = await listContents(url, getJson);
    const step = Math.max(1, Math.floor(all.length / TILES_MAX));
    tiles = all.filter((_, i) => i % step === 0).map((t) => t.url.replace(/\.glb$/, ""));
});
after(async () => {
    if (dir) rmSync(dir, { recursive: true, force: true });
    await source?.close();
});

// splat-transform's own reading of a file, as columns.
function readBySplatTransform(bytes, ext) {
    const from = join(dir, `tile.${ext}`);
    const to = join(dir, "read.ply");
    writeFileSync(from, bytes);
    const args = [TRANSFORM, "-q", "-w", "-g", "cpu", from, to];
    const run = spawnSync(process.execPath, args, { encoding: "utf8" });
    assert.equal(run.status, 0, `splat-transform: ${run.stdout}${run.stderr}`);
    return readPly(readFileSync(to));
}

function assertColumn(got, want, tolerance, what) {
    for (let i = 0; i < want.length; i++) {
        const slack = tolerance + FLOAT_TOLERANCE * Math.abs(want[i]);
        assert.ok(
            Math.abs(got[i] - want[i]) <= slack,
            `${what}, row ${i}: got ${got[i]}, want ${want[i]}`,
        );
    }
}

const shCoefs = (degree) => (degree + 1) ** 2 - 1;

// splat-transform turns SPZ half around the x axis, into the axes that trainers' .ply files have by
// custom.
const FLIP = [1, -1, -1];
// The same turn for the harmonics of degree 1, 2, 3: the sign of each basis function under y, z ->
// -y, -z.
const FLIP_SH = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1];

test("the .spz of a tile is the payload of its .glb", { skip }, async () => {
    for (const tile of tiles) {
        const [spz, glb] = [await getBytes(`${tile}.spz`), await getBytes(`${tile}.glb`)];
        assert.ok(spz.equals(findSpz(glb)), tile);
    }
});

test("splat-transform reads .spz", { skip }, async (t) => {
    let rows = 0;
    for (const tile of tiles) {
        const bytes = await getBytes(`${tile}.spz`);
        const spz = decodeSpz(bytes);
        const ply = readBySplatTransform(bytes, "spz");
        assert.equal(ply.count, spz.count, tile);
        const each = (f) => Float64Array.from({ length: spz.count }, (_, i) => f(i));
        ["x", "y", "z"].forEach((name, axis) => {
            const want = each((i) => (FLIP[axis] * spz.position[3 * i + axis]) / 4096);
            assertColumn(ply.column(name), want, 1e-6, `${tile} ${name}`);
        });
        for (let k = 0; k < 3; k++) {
            assertColumn(
                ply.column(`scale_${k}`),
                each((i) => spz.scale[3 * i + k] / 16 - 10),
                1e-5,
                `${tile} scale_${k}`,
            );
            const dc = each((i) => (spz.color[3 * i + k] / 255 - 0.5) / 0.15);
            assertColumn(ply.column(`f_dc_${k}`), dc, 1e-5, `${tile} f_dc_${k}`);
        }
        const alpha = ply.column("opacity").map((v) => 255 / (1 + Math.exp(-v)));
        assertColumn(alpha, spz.alpha, 0.02, `${tile} opacity`);
        checkRotations(ply, spz, tile);
        checkHarmonics(ply, spz, tile);
        rows += spz.count;
    }
    t.diagnostic(`${rows} Gaussians of ${tiles.length} tiles`);
});

function checkRotations(ply, spz, tile) {
    const [w, x, y, z] = [0, 1, 2, 3].map((k) => ply.column(`rot_${k}`));
    for (let i = 0; i < spz.count; i++) {
        const q = unpackRotation(spz.rotation[i]);
        const dot =
            x[i] * q[0] * FLIP[0] + y[i] * q[1] * FLIP[1] + z[i] * q[2] * FLIP[2] + w[i] * q[3];
        assert.ok(
            Math.abs(Math.abs(dot) / Math.hypot(w[i], x[i], y[i], z[i]) - 1) < 1e-5,
            `${tile} rotation ${i}`,
        );
    }
}

function checkHarmonics(ply, spz, tile) {
    const coefs = shCoefs(spz.shDegree);
    assert.equal(ply.names.filter((n) => n.startsWith("f_rest")).length, 3 * coefs, tile);
    for (let k = 0; k < 3 * coefs; k++) {
        const [channel, coef] = [Math.floor(k / coefs), k % coefs];
        const want = Float64Array.from(
            { length: spz.count },
            (_, i) => (FLIP_SH[coef] * (spz.sh[3 * (i * coefs + coef) + channel] - 128)) / 128,
        );
        assertColumn(ply.column(`f_rest_${k}`), want, 1e-6, `${tile} f_rest_${k}`);
    }
}

// Values of a .ply against those of the .spz of the same tile, which is quantised: half a step
// each.
test(
    "the .ply of a tile holds the same Gaussians, and splat-transform reads it",
    { skip },
    async () => {
        for (const tile of tiles) {
            const bytes = await getBytes(`${tile}.ply`);
            const own = readPly(bytes);
            const other = readBySplatTransform(bytes, "ply");
            assert.equal(other.count, own.count, tile);
            for (const name of own.names.filter((n) => !n.startsWith("n"))) {
                assertColumn(other.column(name), own.column(name), 0, `${tile} ${name}`);
            }
            const spz = decodeSpz(await getBytes(`${tile}.spz?preset=spz`));
            assert.equal(own.count, spz.count, tile);
            compareAsSets(own, spz, tile);
        }
    },
);

// A compressed .ply has its rows in the order of the .ply, and 256 of them share a box: 2047 steps of
// it for x and z, 1023 for y.
const CHUNK = 256;
const HALF = { x: 0.5 / 2047, y: 0.5 / 1023, z: 0.5 / 2047 };
const SH_HALF = 8 / 512;

// The widths of the boxes of a column, for each row.
function widths(values) {
    const out = new Float64Array(values.length);
    for (let i = 0; i < values.length; i += CHUNK) {
        const chunk = values.subarray(i, i + CHUNK);
        out.fill(Math.max(...chunk) - Math.min(...chunk), i, i + CHUNK);
    }
    return out;
}

test(
    "the .compressed.ply of a tile holds the Gaussians of its .ply, and splat-transform reads it",
    { skip },
    async (t) => {
        let [rows, size] = [0, 0];
        for (const tile of tiles) {
            const bytes = await getBytes(`${tile}.compressed.ply`);
            const got = readBySplatTransform(bytes, "compressed.ply");
            const want = readPly(await getBytes(`${tile}.ply`));
            assert.equal(got.count, want.count, tile);
            const near = (name, half) => {
                const [a, b] = [got.column(name), want.column(name)];
                const box = widths(b);
                b.forEach((v, i) => {
                    const slack = 1.02 * half * box[i] + FLOAT_TOLERANCE * (1 + Math.abs(v));
                    assert.ok(Math.abs(a[i] - v) <= slack, `${tile} ${name}, row ${i}: ${a[i]}, ${v}`);
                });
            };
            for (const name of ["x", "y", "z"]) near(name, HALF[name]);
            [HALF.x, HALF.y, HALF.z].forEach((half, k) => near(`scale_${k}`, half));
            for (let k = 0; k < 3; k++) near(`f_dc_${k}`, 0.5 / 255);
            const alpha = (ply) => ply.column("opacity").map((v) => 255 / (1 + Math.exp(-v)));
            assertColumn(alpha(got), alpha(want), 0.51, `${tile} opacity`);
            const quats = (ply) => [0, 1, 2, 3].map((k) => ply.column(`rot_${k}`));
            const [p, q] = [quats(got), quats(want)];
            for (let i = 0; i < want.count; i++) {
                const along = (a, b) => a.reduce((sum, c, k) => sum + c[i] * b[k][i], 0);
                const cos = Math.abs(along(p, q)) / Math.sqrt(along(p, p) * along(q, q));
                assert.ok(cos > 0.999995, `${tile} rotation ${i}: ${cos}`);
            }
            const rest = (ply) => ply.names.filter((n) => n.startsWith("f_rest"));
            assert.deepEqual(rest(got), rest(want), "bands of harmonics");
            for (const name of rest(want))
                assertColumn(got.column(name), want.column(name), 1.02 * SH_HALF, `${tile} ${name}`);
            rows += got.count;
            size += bytes.length;
        }
        t.diagnostic(`${rows} Gaussians of ${tiles.length} tiles: ${size} bytes`);
    },
);

// Half steps of .sog: 65535 of ln(1 + |p|) an axis, 255 of a rotation's kept components; codebooks of
// 256 values by what they may lose.
const SOG_LOSS_MAX = 0.03; // rms of what a codebook or palette changes, as a share of the spread

test(
    "the .sog of a tile holds the Gaussians of its .spz, and splat-transform reads it",
    { skip },
    async (t) => {
        let [rows, size] = [0, 0];
        for (const tile of tiles) {
            const bytes = await getBytes(`${tile}.sog`);
            const got = readBySplatTransform(bytes, "sog");
            const want = readBySplatTransform(await getBytes(`${tile}.spz?preset=spz`), "spz");
            assert.equal(got.count, want.count, tile);
            for (const name of ["x", "y", "z"]) {
                const [a, b] = [got.column(name), want.column(name)];
                const logs = b.map((v) => Math.sign(v) * Math.log1p(Math.abs(v)));
                const step = (Math.max(...logs) - Math.min(...logs)) / 65535;
                b.forEach((v, i) => {
                    const slack = 0.51 * step * (1 + Math.abs(v)) + 0.51 / 4096 + 1e-5;
                    assert.ok(Math.abs(a[i] - v) <= slack, `${tile} ${name}, row ${i}: ${a[i]}, ${v}`);
                });
            }
            const alpha = (ply) => ply.column("opacity").map((v) => 255 / (1 + Math.exp(-v)));
            assertColumn(alpha(got), alpha(want), 1.02, `${tile} opacity`);
            const quats = (ply) => [0, 1, 2, 3].map((k) => ply.column(`rot_${k}`));
            const [p, q] = [quats(got), quats(want)];
            for (let i = 0; i < want.count; i++) {
                const along = (a, b) => a.reduce((sum, c, k) => sum + c[i] * b[k][i], 0);
                const cos = Math.abs(along(p, q)) / Math.sqrt(along(p, p) * along(q, q));
                assert.ok(cos > 0.9998, `${tile} rotation ${i}: ${cos}`);
            }
            assert.deepEqual(got.names.length, want.names.length, "bands of harmonics");
            for (const name of want.names.filter((n) => /^(scale|f_dc)_/.test(n))) {
                const [a, b] = [got.column(name), want.column(name)];
                const mean = b.reduce((sum, v) => sum + v, 0) / b.length;
                const off = b.reduce((sum, v, i) => sum + (a[i] - v) ** 2, 0);
                const spread = b.reduce((sum, v) => sum + (v - mean) ** 2, 0);
                const half = b.length * (name.startsWith("s") ? 1 / 32 : 0.5 / 255 / 0.15) ** 2;
                assert.ok(off <= half + SOG_LOSS_MAX ** 2 * spread, `${tile} ${name}: ${off}, ${spread}`);
            }
            rows += got.count;
            size += bytes.length;
        }
        t.diagnostic(`${rows} Gaussians of ${tiles.length} tiles: ${size} bytes`);
    },
);

// The order of rows may differ: compare sorted columns. Spreads survive any order and any frame's
// origin.
function compareAsSets(ply, spz, tile) {
    const sorted = (values) => Float64Array.from(values).sort();
    const spread = (values) => values.map((v) => v - values[0]);
    const spzAxis = (axis, sign) =>
        sorted(
            Float64Array.from(
                { length: spz.count },
                (_, i) => (sign * spz.position[3 * i + axis]) / 4096,
            ),
        );
    // ENU x, y, z are glTF x, -z, y.
    const pairs = { x: spzAxis(0, 1), y: spzAxis(2, -1), z: spzAxis(1, 1) };
    for (const [name, want] of Object.entries(pairs)) {
        assertColumn(
            spread(sorted(ply.column(name))),
            spread(want),
            1.5 / 4096,
            `${tile} sorted ${name}`,
        );
    }
    const alpha = sorted(ply.column("opacity").map((v) => 255 / (1 + Math.exp(-v))));
    assertColumn(alpha, sorted(spz.alpha), 0.51, `${tile} sorted opacity`);
    for (let k = 0; k < 3; k++) {
        const want = sorted(
            Float64Array.from(
                { length: spz.count },
                (_, i) => (spz.color[3 * i + k] / 255 - 0.5) / 0.15,
            ),
        );
        const clamp = (v) => Math.max(-0.5 / 0.15, Math.min(0.5 / 0.15, v));
        const got = sorted(ply.column(`f_dc_${k}`).map(clamp));
        assertColumn(got, want, 0.51 / 255 / 0.15, `${tile} sorted f_dc_${k}`);
    }
}

// ---- Draco --------------------------------------------------------------------------------------

// draco3d's rows against those of the .spz of the same preset: the same integers in the same order.
for (const preset of ["spz", "preview", "balanced", "near-lossless"]) {
    test(`draco3d decodes .drc, ${preset}, to the integers of the .spz`, { skip }, async (t) => {
        const draco = await require("draco3d").createDecoderModule({});
        let [rows, size, spzSize] = [0, 0, 0];
        for (const tile of tiles) {
            const file = await getBytes(`${tile}.drc?preset=${preset}`);
            const spzFile = await getBytes(`${tile}.spz?preset=${preset}`);
            const drc = decodeDrc(draco, file);
            const spz = decodeSpz(spzFile);
            assert.equal(drc.format, "citysplat-2", tile);
            for (const key of ["count", "shDegree", "fractionBits", "antialiased"])
                assert.equal(drc[key], spz[key], `${tile} ${key}`);
            for (const key of ["position", "alpha", "color", "scale", "rotation", "sh"])
                assert.deepEqual(Array.from(drc[key]), Array.from(spz[key]), `${tile} ${key}`);
            rows += spz.count;
            size += file.length;
            spzSize += spzFile.length;
        }
        t.diagnostic(`${rows} Gaussians of ${tiles.length} tiles: ${size} bytes, .spz ${spzSize}`);
    });
}
