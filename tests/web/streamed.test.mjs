// A store as a streamed SOG: PlayCanvas' own splat-transform reads every chunk, and what it reads is the store,
// each Gaussian once at the finest level, each run within the box that it is said to be in; the tree and its
// levels are what PlayCanvas' engine makes of them.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";

import { readPly } from "./lib/ply.mjs";
import { BIN, GIVEN_TILES, MOCK, importCity } from "./lib/source.mjs";

const require = createRequire(import.meta.url);
const TRANSFORM = join(dirname(require.resolve("@playcanvas/splat-transform")), "../bin/cli.mjs");
const HERE = dirname(fileURLToPath(import.meta.url));
const ENGINE = join(HERE, "node_modules/playcanvas/build/playcanvas/src/scene/gsplat-unified");
const skip = MOCK || GIVEN_TILES ? "needs the test city" : false;
const NEAR_M = 0.01; // 16 bits of a logarithm, at 100 m from the origin

let dir;
const at = (name) => join(dir, name);
let meta;
let chunks; // as splat-transform reads them, by the number of their file
before(() => {
    if (skip) return;
    dir = mkdtempSync(join(tmpdir(), "citysplat-streamed-"));
    importCity(dir, 25); // several tiles, several zooms
    run(BIN, ["export", at("city.tiles"), "-o", at("ssog"), "--format", "streamed-sog"]);
    meta = JSON.parse(readFileSync(at("ssog/lod-meta.json"), "utf8"));
    chunks = meta.filenames.map((name, i) => {
        run(process.execPath, [TRANSFORM, "-q", "-w", "-g", "cpu", at(`ssog/${name}`), at(`${i}.ply`)]);
        return pointsOf(readFileSync(at(`${i}.ply`)));
    });
});
after(() => dir && rmSync(dir, { recursive: true, force: true }));

function run(program, args) {
    const { status, stdout, stderr } = spawnSync(program, args, { encoding: "utf8" });
    assert.equal(status, 0, `${args.join(" ")}\n${stdout}${stderr}`);
}

function pointsOf(bytes) {
    const ply = readPly(bytes);
    const [x, y, z, red, sigma] = ["x", "y", "z", "f_dc_0", "scale_0"].map((name) => ply.column(name));
    return Array.from(x, (_, i) => ({ at: [x[i], y[i], z[i]], red: red[i], sigma: sigma[i] }));
}

function leavesOf(node) {
    return node.lods ? [node] : node.children.flatMap(leavesOf);
}

test("every Gaussian of the finest level is in it once, where it was", { skip }, (t) => {
    run(BIN, ["export", at("city.tiles"), "-o", at("finest.ply")]);
    const want = pointsOf(readFileSync(at("finest.ply"))); // east, north, up: SOG has (east, -up, north)
    const finest = leavesOf(meta.tree).flatMap(({ lods }) => {
        const run = lods[0] ?? Object.values(lods)[0];
        return chunks[run.file].slice(run.offset, run.offset + run.count);
    });
    assert.equal(finest.length, want.length);
    const cell = ([e, n, u]) => [e, n, u].map((v) => Math.floor(v / (4 * NEAR_M)));
    const cells = new Map();
    for (const one of want) {
        const key = cell(one.at).join();
        cells.set(key, [...(cells.get(key) ?? []), one]);
    }
    let worst = 0;
    for (const got of finest) {
        const [e, minusUp, n] = got.at;
        const [a, b, c] = cell([e, n, -minusUp]);
        let [best, off] = [null, Infinity];
        for (let k = 0; k < 27; k++) {
            const key = [a + (k % 3) - 1, b + (Math.floor(k / 3) % 3) - 1, c + Math.floor(k / 9) - 1].join();
            for (const one of cells.get(key) ?? []) {
                const far = Math.hypot(one.at[0] - e, one.at[1] - n, one.at[2] + minusUp);
                const differs = Math.abs(one.red - got.red) + Math.abs(one.sigma - got.sigma);
                if (one.taken || far > NEAR_M || far + differs >= off) continue;
                [best, off] = [one, far + differs];
                one.far = far;
            }
        }
        assert.ok(best, `nothing at ${got.at}`);
        best.taken = true;
        worst = Math.max(worst, best.far);
        assert.ok(Math.abs(best.red - got.red) < 0.05, `${best.red}, not ${got.red}`);
    }
    t.diagnostic(`${finest.length} Gaussians, ${chunks.length} chunks, at most ${(1000 * worst).toFixed(2)} mm off`);
});

test("runs fill the chunks of one level each, and boxes hold them", { skip }, () => {
    const leaves = leavesOf(meta.tree);
    assert.ok(leaves.length > 4 && meta.lodLevels > 2, `${leaves.length} boxes, ${meta.lodLevels} levels`);
    const filled = chunks.map(() => []);
    for (const { bound, lods } of leaves)
        for (const [level, { file, offset, count }] of Object.entries(lods)) {
            filled[file].push([offset, count]);
            assert.equal(meta.filenames[file].split("_")[0], level);
            for (const { at: p } of chunks[file].slice(offset, offset + count))
                p.forEach((v, k) => {
                    assert.ok(v > bound.min[k] - NEAR_M && v < bound.max[k] + NEAR_M, `${p} of ${level}`);
                });
        }
    filled.forEach((runs, file) => {
        let end = 0;
        for (const [offset, count] of runs.sort(([a], [b]) => a - b)) {
            assert.equal(offset, end);
            end += count;
        }
        assert.equal(end, chunks[file].length);
    });
    const within = (inner, outer) => {
        for (let k = 0; k < 3; k++) assert.ok(inner.min[k] >= outer.min[k] && inner.max[k] <= outer.max[k]);
    };
    const walk = (node) => node.children?.forEach((child) => (within(child.bound, node.bound), walk(child)));
    walk(meta.tree);
    assert.equal(meta.count, meta.counts.reduce((a, b) => a + b));
    assert.equal(meta.counts.length, meta.lodLevels);
});

test("the engine reads levels and boxes, and every box has its coarsest", { skip }, async () => {
    const load = (name) => import(pathToFileURL(join(ENGINE, name)).href);
    const { GSplatOctree } = await load("gsplat-octree.js");
    const octree = new GSplatOctree("http://city.test/ssog/lod-meta.json", meta);
    assert.equal(octree.nodes.length, leavesOf(meta.tree).length);
    assert.deepEqual(octree.files.map(({ url }) => url), meta.filenames.map((name) => `http://city.test/ssog/${name}`));
    const table = octree.acquireLodTable(0, meta.lodLevels - 1);
    assert.ok(table.totalFinestCount >= meta.counts[0]);
    assert.ok(table.totalCoarsestCount <= table.totalFinestCount / 2);
});

test("the same bytes again, and a folder that is there is left alone", { skip }, () => {
    run(BIN, ["export", at("city.tiles"), "-o", at("again"), "--format", "streamed-sog"]);
    const files = readdirSync(at("ssog"), { recursive: true }).filter((name) => /\.(json|webp)$/.test(name));
    assert.equal(files.length, 1 + chunks.length * readdirSync(at("ssog/0_0")).length);
    for (const name of files) assert.deepEqual(readFileSync(at(`again/${name}`)), readFileSync(at(`ssog/${name}`)), name);
    const args = ["export", at("city.tiles"), "-o", at("again"), "--format", "streamed-sog"];
    assert.notEqual(spawnSync(BIN, args).status, 0);
    run(BIN, [...args, "--overwrite"]);
});
