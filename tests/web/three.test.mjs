// three.js' own loaders on files of ours, in Chromium, judged by pixels: .spz, plain .glb and .ply
// of one tile give one picture, and so does every preset's .drc decoded by Google's decoder in the
// browser; a single coefficient of each band looks from six directions as the basis says.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { openPage, useWholeBrowser } from "./lib/browser.mjs";
import { measureContent, rmsDifference } from "./lib/checks.mjs";
import { makeCity, ORIGIN } from "./lib/city.mjs";
import { serveFiles } from "./lib/files.mjs";
import { writePly } from "./lib/ply.mjs";
import { decodePng } from "./lib/png.mjs";
import { BIN } from "./lib/source.mjs";

useWholeBrowser();

const HERE = dirname(fileURLToPath(import.meta.url));
const SIZE = { width: 240, height: 180 };
const TIMEOUT_MS = 120000;
// Levels of 255. Quantising and float formats differ by rounding; two presets by what they leave
// out.
const SAME_RMS = 4;
const PREVIEW_RMS = 12;
const COLOR_TOLERANCE = 7;

const ROOTS = {
    "/three/": join(HERE, "../../web/node_modules/three/"),
    "/draco3d/": join(HERE, "node_modules/draco3d/"),
    "/lib/": join(HERE, "lib/"),
};

let dir;
let server;
let opened;

function fileOf(path) {
    if (path === "/") return join(HERE, "three.html");
    const root = Object.keys(ROOTS).find((r) => path.startsWith(r));
    const below = root ? path.slice(root.length) : path.slice(1);
    return join(root ? ROOTS[root] : dir, normalize(below).replace(/^(\.\.[/\\])+/, ""));
}

before(async () => {
    dir = mkdtempSync(join(tmpdir(), "citysplat-three-"));
    server = await serveFiles(fileOf);
    opened = await openPage(`${server.url}/`, SIZE);
    await opened.page.waitForFunction(() => window.ready === true, null, { timeout: TIMEOUT_MS });
});
after(async () => {
    await opened?.close();
    server?.close();
    if (dir) rmSync(dir, { recursive: true, force: true });
});

function convert(from, to, ...options) {
    const args = ["convert", join(dir, from), join(dir, to), "--overwrite", ...options];
    const run = spawnSync(BIN, args, { encoding: "utf8" });
    assert.equal(run.status, 0, `citysplat ${args.join(" ")}\n${run.stderr}`);
}

async function draw(name, camera) {
    await opened.page.evaluate(([n, c]) => window.draw(n, c), [name, camera]);
    const picture = decodePng(await opened.page.screenshot());
    assert.deepEqual(opened.log, [], name);
    return picture;
}

const CAMERA = { from: [60, 90, 160], at: [0, 5, 0], fov: 50 };

test("one city, one picture: .spz, plain .glb, .ply and .drc of every preset", async (t) => {
    writeFileSync(join(dir, "city.ply"), writePly(makeCity(), ORIGIN));
    convert("city.ply", "plain.glb", "--axes", "enu", "--glb-payload", "plain");
    convert("plain.glb", "gltf.ply", "--ply-axes", "gltf");
    const want = await draw("plain.glb", CAMERA);
    const { share, colors } = measureContent(want);
    assert.ok(share > 0.05 && colors > 10, `nothing to see: ${share}, ${colors} colours`);
    const ply = rmsDifference(want, await draw("gltf.ply", CAMERA));
    t.diagnostic(`rms difference to plain.glb, levels of 255: .ply ${ply.toFixed(3)}`);
    assert.ok(ply < SAME_RMS, `.ply: ${ply}`);
    for (const preset of ["spz", "preview", "balanced", "near-lossless"]) {
        convert("city.ply", `${preset}.spz`, "--axes", "enu", "--preset", preset);
        convert("city.ply", `${preset}.v4.spz`, "--axes", "enu", "--preset", preset, "--spz-version", "4");
        convert("city.ply", `${preset}.drc`, "--axes", "enu", "--preset", preset);
        const spz = await draw(`${preset}.spz`, CAMERA);
        const off = rmsDifference(want, spz);
        assert.ok(off < (preset === "preview" ? PREVIEW_RMS : SAME_RMS), `${preset}.spz: ${off}`);
        assert.equal(rmsDifference(spz, await draw(`${preset}.v4.spz`, CAMERA)), 0, `${preset} v4`);
        assert.equal(rmsDifference(spz, await draw(`${preset}.drc`, CAMERA)), 0, `${preset}.drc`);
        t.diagnostic(`${preset}: ${off.toFixed(3)}; its .drc and version 4 are the same picture`);
    }
});

// ---- one coefficient at a time ------------------------------------------------------------------

// The basis of the 3DGS paper's code, for unit d from the camera to the mean.
function basis(x, y, z) {
    return [
        -0.4886025119 * y,
        0.4886025119 * z,
        -0.4886025119 * x,
        1.0925484306 * x * y,
        -1.0925484306 * y * z,
        0.3153915653 * (2 * z * z - x * x - y * y),
        -1.0925484306 * x * z,
        0.5462742153 * (x * x - y * y),
        -0.5900435899 * y * (3 * x * x - y * y),
        2.8906114426 * x * y * z,
        -0.4570457995 * y * (4 * z * z - x * x - y * y),
        0.3731763326 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457995 * x * (4 * z * z - x * x - y * y),
        1.4453057213 * z * (x * x - y * y),
        -0.5900435899 * x * (x * x - 3 * y * y),
    ];
}

// An ENU .ply of one grey ball whose coefficient k is c in red and -c in green.
function ball(k, c) {
    const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"];
    for (let i = 0; i < 45; i++) names.push(`f_rest_${i}`);
    names.push("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3");
    const values = names.map((name) => {
        if (name === `f_rest_${k}`) return c;
        if (name === `f_rest_${15 + k}`) return -c;
        return { opacity: 9, rot_0: 1 }[name] ?? 0;
    });
    const head = names.map((n) => `property float ${n}\n`).join("");
    return `ply\nformat ascii 1.0\ncomment axes ENU\nelement vertex 1\n${head}end_header\n${values.join(" ")}\n`;
}

// Cameras about the ball, in glTF axes (x east, y up, z south): the axes, and two corners.
const PLACES = [
    [6, 0, 0], [-6, 0, 0], [0, 6, 0], [0, -6, 0], [0, 0, 6], [0, 0, -6], [4, 3, 3], [-3, 4, -3],
];

test("a coefficient looks from six sides and two corners as its basis says", async () => {
    const c = 0.75; // on the grid of every band
    for (let k = 0; k < 15; k++) {
        writeFileSync(join(dir, "ball.ply"), ball(k, c));
        convert("ball.ply", `ball-${k}.spz`, "--preset", "near-lossless");
        const cameras = PLACES.map((from) => ({ from, at: [0, 0, 0], fov: 30 }));
        const centers = await opened.page.evaluate(([n, c]) => window.centers(n, c), [`ball-${k}.spz`, cameras]);
        for (const [side, from] of PLACES.entries()) {
            const n = Math.hypot(...from);
            // Looking from the camera to the ball; east, north, up are glTF x, -z, y.
            const [east, up, south] = from.map((v) => -v / n);
            const value = c * basis(east, -south, up)[k];
            const want = [0.5 + value, 0.5 - value, 0.5].map((v) => 255 * Math.min(1, Math.max(0, v)));
            const center = centers[side];
            for (let channel = 0; channel < 3; channel++) {
                const got = center[channel];
                assert.ok(
                    Math.abs(got - want[channel]) <= COLOR_TOLERANCE,
                    `coefficient ${k} from ${from}, channel ${channel}: ${got}, want ${want[channel].toFixed(0)}`,
                );
            }
        }
    }
    assert.deepEqual(opened.log, []);
});
