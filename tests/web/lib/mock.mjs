// A stand-in for `citysplat serve` that needs no C program: the test city as a two-level tileset,
// encoded by this folder's own SPZ and glTF writers. It lets the web client be worked on alone and
// gives the browser tests a second, independent source of tiles.
//
// Run it by hand: node tests/web/lib/mock.mjs [port]
//
// SPDX-License-Identifier: Apache-2.0
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";

import { makeCity, ORIGIN } from "./city.mjs";
import { encodeGlb } from "./glb.mjs";
import { enuToEcef, placeOfEnu } from "./geo.mjs";
import { encodeSpz } from "./spz.mjs";
import { makeTileset } from "./tileset.mjs";

const DIST = join(dirname(fileURLToPath(import.meta.url)), "../../../web/dist");
const CREDIT = "Test city, drawn by code";
const TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript",
    ".css": "text/css",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
};

// ENU -> glTF axes: p' = (E, U, -N), and rotation and degree-1 harmonics turned the same way.
function toGltf(s, center) {
    const [e, n, u] = s.pos.map((v, i) => v - center[i]);
    const [w, x, y, z] = s.quat;
    const r = Math.SQRT1_2; // (r, -r, 0, 0) * q
    const quat = [r * w + r * x, r * x - r * w, r * y + r * z, r * z - r * y];
    const o = s.sh1;
    const sh1 = o && [-o[3], -o[4], -o[5], o[0], o[1], o[2], o[6], o[7], o[8]];
    return { ...s, pos: [e, u, -n], quat, sh1 };
}

function makeTile(splats, center) {
    const turned = splats.map((s) => toGltf(s, center));
    const bound = (f) =>
        [0, 1, 2].map((i) => f(...turned.map((s) => Math.round(s.pos[i] * 4096) / 4096)));
    return encodeGlb(encodeSpz(turned, 1), turned.length, 1, bound(Math.min), bound(Math.max));
}

function boxOf(splats, center) {
    const lo = [0, 1, 2].map((i) =>
        Math.min(...splats.map((s) => s.pos[i] - 3 * Math.max(...s.sigma))),
    );
    const hi = [0, 1, 2].map((i) =>
        Math.max(...splats.map((s) => s.pos[i] + 3 * Math.max(...s.sigma))),
    );
    const half = lo.map((v, i) => (hi[i] - v) / 2);
    const mid = lo.map((v, i) => (hi[i] + v) / 2 - center[i]);
    return [...mid, half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]];
}

function makeStore() {
    const city = makeCity();
    const files = new Map();
    const coarse = city.filter((_, i) => i % 3 === 0 || city[i].sigma[2] > 5);
    files.set(
        "t/14/0/0.glb",
        makeTile(
            coarse.map((s) => ({ ...s, sigma: s.sigma.map((v) => v * 1.4) })),
            [0, 0, 0],
        ),
    );
    const children = [];
    for (const [x, y] of [
        [0, 0],
        [1, 0],
        [0, 1],
        [1, 1],
    ]) {
        const part = city.filter((s) => s.pos[0] >= 0 === (x === 1) && s.pos[1] < 0 === (y === 1));
        const center = [x ? 40 : -40, y ? -40 : 40, 0];
        files.set(`t/15/${x}/${y}.glb`, makeTile(part, center));
        children.push({
            transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...center, 1],
            boundingVolume: { box: boxOf(part, center) },
            geometricError: 0,
            content: { uri: `r/1/t/15/${x}/${y}.glb` },
        });
    }
    const tileset = makeTileset(
        enuToEcef(ORIGIN),
        {
            boundingVolume: { box: boxOf(city, [0, 0, 0]) },
            geometricError: 8,
            content: { uri: "r/1/t/14/0/0.glb" },
            children,
        },
        CREDIT,
    );
    return { files, tileset, count: city.length };
}

function collections() {
    const sw = placeOfEnu(ORIGIN, [-100, -100, 0]);
    const ne = placeOfEnu(ORIGIN, [100, 100, 60]);
    const bbox = [sw.lon, sw.lat, sw.h, ne.lon, ne.lat, ne.h];
    const one = (id, title) => ({
        id,
        title,
        attribution: CREDIT,
        extent: { spatial: { bbox: [[sw.lon, sw.lat, ne.lon, ne.lat]] } },
        contentExtent: { spatial: { bbox: [bbox] } },
    });
    return { collections: [one("f", "Test city"), one("f2", "Test city, again")] };
}

// The picture a renderer would send; here only its address, to see the client's overlay at work.
function fakeView(path) {
    return `<svg xmlns="http://www.w3.org/2000/svg" width="1280" height="720" viewBox="0 0 1280 720">
<rect width="1280" height="720" fill="#345"/><text x="60" y="360" fill="#fff" font-size="22">${path}</text></svg>`;
}

function sendFile(res, path) {
    const file = join(DIST, normalize(path === "/" ? "/index.html" : path));
    if (!file.startsWith(DIST) || !existsSync(file) || !statSync(file).isFile()) {
        res.writeHead(404, { "content-type": "application/problem+json" });
        res.end('{"title":"Not Found","status":404}');
        return;
    }
    res.writeHead(200, { "content-type": TYPES[extname(file)] ?? "application/octet-stream" });
    createReadStream(file).pipe(res);
}

// Starts on 127.0.0.1; resolves to { url, count, close() }.
export function startMock(port = 0) {
    const store = makeStore();
    const server = createServer((req, res) => {
        const path = decodeURIComponent(new URL(req.url, "http://x").pathname);
        const send = (type, body) => {
            res.writeHead(200, { "content-type": type, "access-control-allow-origin": "*" });
            res.end(body);
        };
        const tile = /^\/d\/f2?\/r\/1\/(t\/.*\.glb)$/.exec(path);
        if (path === "/collections") return send("application/json", JSON.stringify(collections()));
        if (/^\/d\/f2?\/tileset\.json$/.test(path))
            return send("application/json", JSON.stringify(store.tileset));
        if (tile && store.files.has(tile[1]))
            return send("model/gltf-binary", store.files.get(tile[1]));
        if (/^\/d\/f2?\/static\//.test(path)) return send("image/svg+xml", fakeView(path));
        return sendFile(res, path);
    });
    return new Promise((resolve, reject) => {
        server.once("error", reject);
        server.listen(port, "127.0.0.1", () => {
            const close = () => {
                server.closeAllConnections();
                return new Promise((done) => server.close(done));
            };
            resolve({
                url: `http://127.0.0.1:${server.address().port}`,
                count: store.count,
                close,
            });
        });
    });
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
    const mock = await startMock(Number(process.argv[2] ?? 8099));
    console.log(`${mock.url} serves ${mock.count} Gaussians`);
}
