// Other people's readers on the served files: splat-transform (PlayCanvas) reads .spz and .ply,
// Google's draco3d decodes .drc. All must give the Gaussians that our own small decoder finds in
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
            const spz = decodeSpz(await getBytes(`${tile}.spz`));
            assert.equal(own.count, spz.count, tile);
            compareAsSets(own, spz, tile);
        }
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

function readAttribute(draco, cloud, decoder, querier, name) {
    const id = decoder.GetAttributeIdByMetadataEntry(cloud, "name", name);
    if (id < 0) return null;
    const attribute = decoder.GetAttribute(cloud, id);
    const width = attribute.num_components();
    const length = cloud.num_points() * width;
    const kinds = {
        [draco.DT_UINT8]: ["DT_UINT8", Uint8Array, "HEAPU8"],
        [draco.DT_UINT16]: ["DT_UINT16", Uint16Array, "HEAPU16"],
        [draco.DT_UINT32]: ["DT_UINT32", Uint32Array, "HEAPU32"],
    };
    const [kind, Type, heap] = kinds[attribute.data_type()];
    const bytes = length * Type.BYTES_PER_ELEMENT;
    const at = draco._malloc(bytes);
    assert.ok(
        decoder.GetAttributeDataArrayForAllPoints(cloud, attribute, draco[kind], bytes, at),
        name,
    );
    const first = at / Type.BYTES_PER_ELEMENT;
    const values = draco[heap].slice(first, first + length);
    draco._free(at);
    return { width, values };
}

async function decodeDraco(bytes) {
    const draco = await require("draco3d").createDecoderModule({});
    const decoder = new draco.Decoder();
    const buffer = new draco.DecoderBuffer();
    buffer.Init(new Int8Array(bytes), bytes.length);
    const cloud = new draco.PointCloud();
    const status = decoder.DecodeBufferToPointCloud(buffer, cloud);
    assert.ok(status.ok(), status.error_msg());
    const querier = new draco.MetadataQuerier();
    const metadata = decoder.GetMetadata(cloud);
    const out = {
        count: cloud.num_points(),
        format: querier.GetStringEntry(metadata, "format"),
        shDegree: querier.GetIntEntry(metadata, "sh_degree"),
        fractionBits: querier.GetIntEntry(metadata, "frac_bits"),
    };
    for (const name of [
        "position",
        "opacity",
        "scale",
        "rotation",
        "rotation_index",
        "color",
        "sh1",
        "sh2",
        "sh3",
    ]) {
        out[name] = readAttribute(draco, cloud, decoder, querier, name);
    }
    [cloud, buffer, querier, decoder].forEach((object) => draco.destroy(object));
    return out;
}

// The Draco values of row i as the SPZ stores them, as one string: rows may be in another order.
function dracoRow(drc, i) {
    const slice = (name) => [
        ...drc[name].values.subarray(i * drc[name].width, (i + 1) * drc[name].width),
    ];
    const fields = slice("rotation").map((v) => (v < 511 ? 512 + (511 - v) : v - 511));
    const packed = [drc.rotation_index.values[i], ...fields].reduce((sum, v) => sum * 1024 + v, 0);
    const sh = ["sh1", "sh2", "sh3"].flatMap((name, band) =>
        drc[name] ? slice(name).map((v) => Math.min(255, v * (band === 0 ? 8 : 16))) : [],
    );
    return [
        slice("position").map((v) => v - 2 ** 23),
        slice("opacity"),
        slice("color"),
        slice("scale"),
        sameRotation(packed),
        sh,
    ].join(";");
}

function spzRow(spz, i) {
    const coefs = 3 * shCoefs(spz.shDegree);
    const slice = (array, width) => [...array.subarray(i * width, (i + 1) * width)];
    return [
        slice(spz.position, 3),
        slice(spz.alpha, 1),
        slice(spz.color, 3),
        slice(spz.scale, 3),
        sameRotation(spz.rotation[i]),
        slice(spz.sh, coefs),
    ].join(";");
}

// A field of magnitude 0 has two signs; both are the same rotation.
function sameRotation(packed) {
    return unpackRotation(packed >>> 0).map((v) =>
        (v + 0).toFixed(6).replace("-0.000000", "0.000000"),
    );
}

test("draco3d decodes .drc to the integers of the .spz", { skip }, async (t) => {
    let rows = 0;
    for (const tile of tiles) {
        const drc = await decodeDraco(await getBytes(`${tile}.drc`));
        const spz = decodeSpz(await getBytes(`${tile}.spz`));
        assert.equal(drc.format, "citysplat-1", tile);
        assert.equal(drc.count, spz.count, tile);
        assert.equal(drc.shDegree, spz.shDegree, tile);
        assert.equal(drc.fractionBits, spz.fractionBits, tile);
        const left = Array.from({ length: drc.count }, (_, i) => dracoRow(drc, i)).sort();
        const right = Array.from({ length: spz.count }, (_, i) => spzRow(spz, i)).sort();
        assert.deepEqual(left, right, tile);
        rows += spz.count;
    }
    t.diagnostic(`${rows} Gaussians of ${tiles.length} tiles`);
});
