// What CesiumJS 1.145 draws of a store as it is served, or as its tiles are, where geometric errors are multiplied by a factor,
// against the server's picture: the figures of docs/decisions/020-level-selection.md and 021-low-pass.md. It needs no browser: it
// selects tiles as Cesium3DTileset does and draws them by the arithmetic of Cesium's PrimitiveGaussianSplatVS and -FS.
//
//   CITYSPLAT_BIN=... node lab/web/cesium_levels.mjs STORE [--half M] [--size WxH] [--factors 0.5,1,2] [--unfiltered] [--exported]
//
// --unfiltered: without the low-pass form of tiles. --exported: from a folder of `citysplat export`. --half: half of the city's
// width, of which the poses are multiples.
//
// SPDX-License-Identifier: Apache-2.0
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { parseArgs } from "node:util";

import { importSource } from "../../tests/web/lib/bundle.mjs";
import { findSpz } from "../../tests/web/lib/glb.mjs";
import { decodePng } from "../../tests/web/lib/png.mjs";
import { decodeSpz, unpackRotation } from "../../tests/web/lib/spz.mjs";
import { ssim } from "../../tests/web/lib/ssim.mjs";

const FOV_DEG = 45;
const STOCK_PX = 16;
const LOW_PASS = 0.3 / 16; // Cesium adds 0.3 to variances of quarter pixels
const DROPPED = 2 / 16; // below this variance, in square pixels, along both axes nothing is drawn
const BESIDE = 1.2; // halves of the picture from its middle, beyond which nothing is drawn
const REACH = Math.sqrt(8); // sigmas from the middle to a side of the quad
const C0 = 0.28209479177387814;
const POSES = {
    // east, north, up in halves of the city; heading, pitch
    home: [0, -2, 1.6, 0, -38],
    near: [0.35, 0.35, 0.35, 225, -35],
    aslant: [1.1, -1.1, 0.7, 315, -24],
    down: [0.1, -0.1, 1.2, 0, -90],
    afar: [-4, 3, 2, 127, -22],
};

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        half: { type: "string", default: "150" },
        size: { type: "string", default: "480x320" },
        unfiltered: { type: "boolean", default: false },
        exported: { type: "boolean", default: false },
        factors: { type: "string", default: "0.5,1,2,4" },
    },
});
const [store] = positionals;
const [width, height] = values.size.split("x").map(Number);
const focal = height / 2 / Math.tan((FOV_DEG * Math.PI) / 360);
const { useUnfilteredTiles } = await importSource("source.ts");
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const three = [0, 1, 2];

// Rows are right, down and ahead, in east-north-up metres.
function cameraOf([e, n, u, heading, pitch]) {
    const [h, p] = [heading, pitch].map((deg) => (deg * Math.PI) / 180);
    const ahead = [Math.sin(h) * Math.cos(p), Math.cos(h) * Math.cos(p), Math.sin(p)];
    const right = [Math.cos(h), -Math.sin(h), 0];
    const down = three.map((k) => ahead[(k + 1) % 3] * right[(k + 2) % 3] - ahead[(k + 2) % 3] * right[(k + 1) % 3]);
    return { eye: [e, n, u].map((v) => v * Number(values.half)), rows: [right, down, ahead] };
}

// Tiles that Cesium shows: { uri, center }, by distance to boxes.
function select(camera, tile, center, factor, out) {
    const box = tile.boundingVolume.box;
    const [middle, half] = [three.map((k) => center[k] + box[k]), [box[3], box[7], box[11]]];
    const away = Math.hypot(...three.map((k) => Math.max(Math.abs(camera.eye[k] - middle[k]) - half[k], 0)));
    const corners = Array.from({ length: 8 }, (_, i) => {
        const at = three.map((k) => middle[k] + ((i >> k) & 1 ? 1 : -1) * half[k] - camera.eye[k]);
        return camera.rows.map((row) => dot(row, at));
    });
    const [tx, ty] = [width / 2 / focal, height / 2 / focal];
    const beyond = [([, , z]) => z <= 0, ([x, , z]) => x > z * tx, ([x, , z]) => x < -z * tx, ([, y, z]) => y > z * ty, ([, y, z]) => y < -z * ty];
    if (beyond.some((side) => corners.every(side))) return;
    if (tile.children && (away === 0 || (tile.geometricError * factor * focal) / away > STOCK_PX))
        for (const child of tile.children) select(camera, child, three.map((k) => center[k] + (child.transform?.[12 + k] ?? 0)), factor, out);
    else if (tile.content) out.push({ uri: tile.content.uri, center });
}

// Bands 1 to 3 of a channel, in the direction from the eye.
function harmonics(s, i, [x, y, z], channel) {
    const n = (s.shDegree + 1) ** 2 - 1;
    const [xx, yy, zz] = [x * x, y * y, z * z];
    const basis = [
        ...[-0.4886025 * y, 0.4886025 * z, -0.4886025 * x],
        ...[1.0925484 * x * y, -1.0925484 * y * z, 0.3153916 * (2 * zz - xx - yy), -1.0925484 * x * z, 0.5462742 * (xx - yy)],
        ...[-0.5900436 * y * (3 * xx - yy), 2.8906114 * x * y * z, -0.4570458 * y * (4 * zz - xx - yy)],
        ...[0.3731763 * z * (2 * zz - 3 * xx - 3 * yy), -0.4570458 * x * (4 * zz - xx - yy), 1.4453057 * z * (xx - yy), -0.5900436 * x * (xx - 3 * yy)],
    ];
    let sum = 0;
    for (let k = 0; k < n; k++) sum += (basis[k] * (s.sh[(i * n + k) * 3 + channel] - 128)) / 128;
    return sum;
}

// The ellipse of a Gaussian at `at` before the eye: variances and direction of its axes, in pixels.
function ellipse(camera, s, i, [x, y, z]) {
    const [qx, qy, qz, qw] = unpackRotation(s.rotation[i]);
    const axes = [
        [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz), 2 * (qx * qz - qw * qy)],
        [2 * (qx * qy - qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qw * qx)],
        [2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)],
    ];
    let [a, b, c] = [LOW_PASS, 0, LOW_PASS];
    axes.forEach(([e, u, south], k) => {
        const long = Math.exp(s.scale[3 * i + k] / 16 - 10);
        const [r, d, f] = camera.rows.map((row) => long * dot(row, [e, -south, u]));
        const [px, py] = [(focal / z) * (r - (x / z) * f), (focal / z) * (d - (y / z) * f)];
        a += px * px;
        b += px * py;
        c += py * py;
    });
    const [middle, radius] = [(a + c) / 2, Math.hypot((a - c) / 2, b)];
    const [wide, narrow] = [middle + radius, Math.max(middle - radius, 0.1 / 16)];
    const long = Math.hypot(b, wide - a);
    return { wide, narrow, along: long < 1e-12 ? [1, 0] : [b / long, (wide - a) / long] };
}

function blend(picture, [cx, cy], { wide, narrow, along: [dx, dy] }, rgb, opacity) {
    const [r1, r2] = [REACH * Math.sqrt(wide), REACH * Math.sqrt(narrow)];
    const [ex, ey] = [Math.abs(dx) * r1 + Math.abs(dy) * r2, Math.abs(dy) * r1 + Math.abs(dx) * r2];
    const last = [Math.min(width - 1, Math.floor(cx + ex - 0.5)), Math.min(height - 1, Math.floor(cy + ey - 0.5))];
    for (let y = Math.max(0, Math.ceil(cy - ey - 0.5)); y <= last[1]; y++)
        for (let x = Math.max(0, Math.ceil(cx - ex - 0.5)); x <= last[0]; x++) {
            const at = y * width + x;
            const [px, py] = [x + 0.5 - cx, y + 0.5 - cy];
            const [u, v] = [px * dx + py * dy, px * dy - py * dx];
            if (Math.abs(u) > r1 || Math.abs(v) > r2) continue;
            const alpha = opacity * Math.exp(-0.5 * ((u * u) / wide + (v * v) / narrow));
            for (const k of three) picture.rgb[3 * at + k] += alpha * picture.left[at] * rgb[k];
            picture.left[at] *= 1 - alpha;
        }
}

function draw(camera, tiles, load) {
    const list = [];
    for (const { uri, center } of tiles) {
        const s = load(uri);
        for (let i = 0; i < s.count; i++) {
            const [x, y, z] = three.map((k) => s.position[3 * i + k] / (1 << s.fractionBits)); // east, up, south
            const p = [x, -z, y].map((v, k) => v + center[k] - camera.eye[k]);
            const at = camera.rows.map((row) => dot(row, p));
            const beyond = three.slice(0, 2).some((k) => Math.abs(at[k]) * focal > (BESIDE * [width, height][k] * at[2]) / 2);
            if (at[2] > 0.1 && !beyond) list.push({ s, i, p, at });
        }
    }
    list.sort((one, other) => one.at[2] - other.at[2]);
    const picture = { rgb: new Float64Array(3 * width * height), left: new Float64Array(width * height).fill(1) };
    let lost = 0;
    for (const { s, i, p, at } of list) {
        const shape = ellipse(camera, s, i, at);
        if (shape.wide < DROPPED) {
            lost++;
            continue;
        }
        const far = Math.hypot(...p);
        const ray = [p[0] / far, p[2] / far, -p[1] / far];
        const rgb = three.map((k) => {
            const base = 0.5 + (C0 * (s.color[3 * i + k] / 255 - 0.5)) / 0.15;
            return Math.max(0, Math.min(1, base)) + harmonics(s, i, ray, k);
        });
        blend(picture, [width / 2 + (focal * at[0]) / at[2], height / 2 + (focal * at[1]) / at[2]], shape, rgb, s.alpha[i] / 255);
    }
    const bytes = Uint8ClampedArray.from(picture.rgb, (v) => 255 * v);
    return { lost, count: list.length, width, height, at: (x, y) => [...bytes.subarray(3 * (y * width + x), 3 * (y * width + x) + 3)] };
}

function drawServed(dir, name, { eye, rows }) {
    const [file, out] = [join(dir, "camera.json"), join(dir, `${name}.png`)];
    const world_to_camera = [...rows.flatMap((row) => [...row, -dot(row, eye)]), 0, 0, 0, 1];
    writeFileSync(file, JSON.stringify({ width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, world_to_camera }));
    execFileSync(process.env.CITYSPLAT_BIN, ["render", store, "--camera", file, "-o", out]);
    return decodePng(readFileSync(out));
}

const dir = mkdtempSync(join(tmpdir(), "citysplat-levels-"));
process.env.CITYSPLAT_TILES = resolve(store);
const { getBytes, getJson, openSource } = await import("../../tests/web/lib/source.mjs");
const source = await openSource();
try {
    const { collections } = await getJson(`${source.url}/collections`);
    const folder = `${source.url}/d/${collections[0].id}/`;
    const exported = join(dir, "exported");
    if (values.exported) execFileSync(process.env.CITYSPLAT_BIN, ["export", store, "-q", "-o", exported, "--format", "3dtiles"]);
    const read = (uri) => (values.exported ? readFileSync(join(exported, uri)) : getBytes(new URL(uri, folder)));
    const { root } = JSON.parse(await read("tileset.json"));
    if (values.unfiltered) useUnfilteredTiles({ root });
    const { tile_fields: fields, tiles: rows } = (await getJson(`${source.url}/collections/${collections[0].id}/tiles.json`)).splats;
    const first = rows.find(([z, x, y]) => root.content.uri.includes(`/${z}/${x}/${y}.`));
    const center = ["center_e", "center_n", "center_u"].map((name) => first[fields.indexOf(name)]);
    const loaded = new Map();
    const load = (uri) => loaded.get(uri);
    for (const [name, pose] of Object.entries(POSES)) {
        const camera = cameraOf(pose);
        const served = drawServed(dir, name, camera);
        for (const factor of values.factors.split(",").map(Number)) {
            const tiles = [];
            select(camera, root, center, factor, tiles);
            for (const { uri } of tiles)
                if (!loaded.has(uri)) {
                    const bytes = await read(uri);
                    loaded.set(uri, { ...decodeSpz(findSpz(bytes)), bytes: bytes.length });
                }
            const picture = draw(camera, tiles, load);
            const { whole, covered } = ssim(picture, served);
            const zooms = [...new Set(tiles.map(({ uri }) => /\bt\/(\d+)\//.exec(uri)[1]))].sort();
            const bytes = tiles.reduce((sum, { uri }) => sum + load(uri).bytes, 0);
            const filtered = tiles.filter(({ uri }) => uri.includes(".lowpass.")).length;
            const lost = (100 * picture.lost) / Math.max(1, picture.count);
            console.log(`${name} ${width}x${height} x ${factor}: zooms ${zooms}, ${filtered} of ${tiles.length} tiles filtered, SSIM ${whole.toFixed(4)}, covered ${covered.toFixed(4)}, ${lost.toFixed(1)} % of ${picture.count} lost, ${(bytes / 1e6).toFixed(2)} MB`);
        }
    }
} finally {
    rmSync(dir, { recursive: true, force: true });
    await source.close();
}
