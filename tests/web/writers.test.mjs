// Files that another program wrote, read by ours, and the other way round: splat-transform
// (PlayCanvas) writes compressed .ply, .spz 3 and 4 and a plain .glb, and reads our compressed .ply
// and .spz 3 and 4;
// what `citysplat convert` makes of each is, column by column, what splat-transform itself reads.
// Khronos' validator judges both of our .glb.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";

import { ORIGIN } from "./lib/city.mjs";
import { applyMatrix, enuToEcef } from "./lib/geo.mjs";
import { decodeGlb } from "./lib/glb.mjs";
import { readPly } from "./lib/ply.mjs";
import { BIN, GIVEN_TILES, MOCK, importCity } from "./lib/source.mjs";

const require = createRequire(import.meta.url);
const TRANSFORM = join(dirname(require.resolve("@playcanvas/splat-transform")), "../bin/cli.mjs");
const COUNT = 700; // more than two chunks of a compressed .ply
const FLOAT_TOLERANCE = 3e-6; // both readers work in float32, and we turn some files there and back
const SH = 45;
const skip = MOCK ? "the mock has no citysplat convert" : false;

const COLUMNS = [
    ...["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"],
    ...Array.from({ length: SH }, (_, i) => `f_rest_${i}`),
    ...["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"],
];
// splat-transform turns .spz about x and .glb about z, into the axes that .ply files of trainers
// have by custom: signs of x, y, z, and of each harmonic under that turn.
const ABOUT_X = { quat: [0, 1, 0, 0], axes: [1, -1, -1], sh: [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1] };
const ABOUT_Z = { quat: [0, 0, 0, 1], axes: [-1, -1, 1], sh: [-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1] };
const AS_IT_IS = { quat: [1, 0, 0, 0], axes: [1, 1, 1], sh: Array(15).fill(1) };

let dir;
before(() => {
    dir = mkdtempSync(join(tmpdir(), "citysplat-writers-"));
    writeFileSync(join(dir, "in.ply"), makePly());
});
after(() => dir && rmSync(dir, { recursive: true, force: true }));

// Gaussians of every kind, from a small generator of its own so that the fixture never changes.
function makePly() {
    let state = 11;
    const signed = (range) => {
        state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
        return (state / 2 ** 31 - 1) * range;
    };
    const range = { x: 50, y: 50, z: 50, opacity: 4, scale: 1.5, rot: 1, f_dc: 1.2, f_rest: 0.6 };
    const head = COLUMNS.map((name) => `property float ${name}\n`).join("");
    const body = Buffer.alloc(4 * COUNT * COLUMNS.length);
    for (let i = 0; i < COUNT * COLUMNS.length; i++) {
        const kind = COLUMNS[i % COLUMNS.length].replace(/_\d+$/, "");
        body.writeFloatLE(signed(range[kind]) - (kind === "scale" ? 2 : 0), 4 * i);
    }
    const text = `ply\nformat binary_little_endian 1.0\nelement vertex ${COUNT}\n${head}end_header\n`;
    return Buffer.concat([Buffer.from(text, "latin1"), body]);
}

function run(program, args) {
    const { status, stdout, stderr } = spawnSync(program, args, { encoding: "utf8" });
    assert.equal(status, 0, `${args.join(" ")}\n${stdout}${stderr}`);
}
const path = (name) => join(dir, name);
const transform = (from, to, ...options) =>
    run(process.execPath, [TRANSFORM, "-q", "-w", "-g", "cpu", ...options, path(from), path(to)]);
const convert = (from, to, ...options) => run(BIN, ["convert", path(from), path(to), "--overwrite", ...options]);
const load = (name) => readPly(readFileSync(path(name)));

// Every column of ours against theirs, which is turned.
function assertSame(ours, theirs, turn) {
    assert.equal(ours.count, COUNT);
    assert.equal(theirs.count, COUNT);
    const sign = (name) => {
        const k = Number(name.split("_").at(-1));
        if (name.startsWith("f_rest")) return turn.sh[k % 15];
        return turn.axes["xyz".indexOf(name)] ?? 1;
    };
    for (const name of COLUMNS.filter((c) => !c.startsWith("rot"))) {
        const [got, want, s] = [ours.column(name), theirs.column(name), sign(name)];
        for (let i = 0; i < COUNT; i++) {
            assert.ok(
                Math.abs(got[i] - s * want[i]) <= FLOAT_TOLERANCE * (1 + Math.abs(want[i])),
                `${name}, row ${i}: got ${got[i]}, want ${s * want[i]}`,
            );
        }
    }
    const quats = (ply) => [0, 1, 2, 3].map((k) => ply.column(`rot_${k}`));
    const [a, b] = [quats(ours), quats(theirs)];
    for (let i = 0; i < COUNT; i++) {
        const got = a.map((c) => c[i] / Math.hypot(...a.map((d) => d[i])));
        const own = b.map((c) => c[i] / Math.hypot(...b.map((d) => d[i])));
        const turned = product(turn.quat, own);
        // Half turns about its own axes leave an ellipsoid as it is.
        const cosines = UNITS.map((u) => Math.abs(dot(got, product(turned, u))));
        assert.ok(Math.max(...cosines) > 1 - 2e-6, `rotation ${i}: ${got}, want ${turned}`);
    }
}

const UNITS = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
const dot = (a, b) => a.reduce((sum, v, k) => sum + v * b[k], 0);
function product([w, x, y, z], [a, b, c, d]) {
    return [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ];
}

test("a compressed .ply of splat-transform", { skip }, () => {
    transform("in.ply", "theirs.compressed.ply");
    transform("theirs.compressed.ply", "want.ply");
    convert("theirs.compressed.ply", "got.ply");
    assertSame(load("got.ply"), load("want.ply"), AS_IT_IS);
});

test("our compressed .ply in splat-transform", { skip }, () => {
    convert("in.ply", "ours.compressed.ply");
    transform("ours.compressed.ply", "want.ply");
    convert("ours.compressed.ply", "got.ply");
    assertSame(load("got.ply"), load("want.ply"), AS_IT_IS);
});

for (const version of ["3", "4"]) {
    test(`an .spz ${version} of splat-transform`, { skip }, () => {
        transform("in.ply", "theirs.spz", "--spz-version", version);
        transform("theirs.spz", "want.ply");
        convert("theirs.spz", "got.ply", "--ply-axes", "gltf");
        assertSame(load("got.ply"), load("want.ply"), ABOUT_X);
    });

    for (const preset of ["spz", "balanced"]) {
        test(`our .spz ${version}, ${preset}, in splat-transform`, { skip }, () => {
            convert(
                ...["in.ply", "ours.spz", "--axes", "gltf"],
                ...["--spz-version", version, "--preset", preset],
            );
            transform("ours.spz", "want.ply");
            convert("ours.spz", "got.ply", "--ply-axes", "gltf");
            assertSame(load("got.ply"), load("want.ply"), ABOUT_X);
        });
    }
}

test("a plain .glb of splat-transform", { skip }, () => {
    transform("in.ply", "theirs.glb");
    convert("theirs.glb", "got.ply", "--ply-axes", "gltf");
    assertSame(load("got.ply"), load("in.ply"), ABOUT_Z);
});

// It knows neither the extension nor its colons (validate.test.mjs).
const ALLOWED = new Set(["MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNSUPPORTED_EXTENSION", "UNUSED_OBJECT"]);

for (const payload of ["spz", "plain"]) {
    test(`the glTF validator on a .glb, ${payload}`, { skip }, async () => {
        const validator = require("gltf-validator");
        convert("in.ply", "ours.glb", "--axes", "gltf", "--glb-payload", payload);
        const bytes = readFileSync(path("ours.glb"));
        const { issues } = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 1000 });
        assert.deepEqual(issues.messages.filter((m) => !ALLOWED.has(m.code)), []);
        const names = Object.keys(decodeGlb(bytes).json.meshes[0].primitives[0].attributes);
        assert.equal(
            issues.messages.filter((m) => m.code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE").length,
            names.filter((n) => n.includes(":")).length,
        );
    });
}
