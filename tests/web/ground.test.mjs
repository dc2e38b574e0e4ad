// What lies around a city: colours that go on beyond its edge, the edge that fades, terrain that becomes level
// (web/src/groundmap.ts). How it looks is a matter of viewer.test.mjs.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";

import { importSource } from "./lib/bundle.mjs";

const { fill, findHeights, HEIGHT_CELLS, isObject, MAP_PX, mapGround, SPAN } = await importSource("groundmap.ts");
const { pack } = await importSource("pack.ts");

const { piecesOf, tileX, tileY } = await importSource("basemap.ts");

const GREEN = [60, 120, 40];
const GREY = [100, 100, 100];
const HALF = MAP_PX / (2 * SPAN); // of the city, in cells
const MIDDLE = MAP_PX / 2;

// The city from above: a square of grey with a rim of green, a hole in its middle and a frond to the east.
function above({ hole = true, frond = true } = {}) {
    const bytes = new Uint8Array(4 * MAP_PX ** 2);
    const paint = (x, y, color) => bytes.set([...color, 255], 4 * (y * MAP_PX + x));
    for (let y = 0; y < MAP_PX; y++)
        for (let x = 0; x < MAP_PX; x++) {
            const far = Math.max(Math.abs(x - MIDDLE), Math.abs(y - MIDDLE)) / HALF;
            if (far < 1 && (far > 0.08 || !hole)) paint(x, y, far > 0.6 ? GREEN : GREY);
            if (frond && y === MIDDLE && x > MIDDLE && far < 1.6) paint(x, y, [250, 0, 0]);
        }
    return bytes;
}
const texel = ({ texels }, x, y) => {
    const at = 4 * (Math.round(y) * MAP_PX + Math.round(x));
    return [...texels.subarray(at, at + 4)];
};
const near = (a, b, most) => a.every((v, i) => Math.abs(v - b[i]) <= most);

test("ground has the city's colours inside, goes on with those of its edge, and ends in their mean", () => {
    const map = mapGround(above({ frond: false }), false);
    const [north, outside, corner] = [texel(map, MIDDLE, MIDDLE + HALF * 0.8), texel(map, MIDDLE, MIDDLE + HALF * 1.15), texel(map, 0, 0)];
    assert.ok(near(north.slice(0, 3), GREEN, 1), String(north));
    assert.ok(near(outside.slice(0, 3), GREEN, 8), String(outside));
    assert.deepEqual(corner.slice(0, 3), map.far.map((v) => Math.round(255 * v)));
    assert.ok(near(corner.slice(0, 3), GREEN, 8), `the mean of the edge: ${corner}`);
    assert.ok(map.light[0] > map.far[0], "the middle is grey");
    const hole = texel(map, MIDDLE, MIDDLE);
    assert.ok(near(hole.slice(0, 3), GREY, 4), `a hole is filled: ${hole}`);
});

test("the edge and fronds fade, holes do not", () => {
    const map = mapGround(above(), false);
    const share = (x, y = MIDDLE) => texel(map, MIDDLE + HALF * x, y)[3];
    assert.deepEqual([share(0.5, MIDDLE + HALF * 0.5), share(0.1, MIDDLE + HALF * 0.1), share(0)], [255, 255, 255]);
    assert.equal(share(0.3, 2), 0, "outside");
    assert.ok(share(1.4) < 160, `a frond: ${share(1.4)}`);
    const across = [0.8, 0.9, 0.95, 0.99].map((x) => share(x, MIDDLE + HALF * 0.5));
    assert.ok(across.every((v, i) => i === 0 || v <= across[i - 1]), `falls to the edge: ${across}`);
    assert.ok(across[0] === 255 && across.at(-1) < 128, String(across));
});

test("objects keep their edges, and nothing is no ground", () => {
    assert.ok(texelsOf(mapGround(above(), true)).every((v, i) => i % 4 !== 3 || v === 255));
    assert.ok(isObject({ x: 10, y: 8, z: 12 }) && !isObject({ x: 100, y: 30, z: 80 }));
    assert.equal(mapGround(new Uint8Array(4 * MAP_PX ** 2), false), null);
});
const texelsOf = (map) => [...map.texels];

// Gaussians in metres: a slope that rises to the east, a roof over a few cells, a stray deep below.
function slope(rise) {
    const places = [];
    for (let x = -50; x <= 50; x += 1)
        for (let z = -50; z <= 50; z += 1) {
            const roof = Math.abs(x) < 3 && Math.abs(z) < 3;
            places.push([x, 100 + rise * x + (roof ? 20 : 0), z]);
        }
    places.push([20, 40, 20]); // the stray
    const count = places.length;
    const loose = {
        ...{ count, shDegree: 0, antialiased: false, unit: 2 ** -10, embedding: null },
        steps: Int32Array.from(places.flat(), (v) => Math.round(1024 * v)),
        colors: new Uint8Array(4 * count).fill(255),
        ...{ scales: new Uint8Array(3 * count), rotations: new Uint32Array(count), sh: new Uint8Array() },
    };
    return [{ splats: pack(loose, [0, 0, 0]) }];
}

test("terrain follows the lowest Gaussians, passes below roofs, and becomes level", () => {
    const square = { x: 0, z: 0, half: 50 * SPAN };
    const map = mapGround(above({ hole: false, frond: false }), false);
    const heights = findHeights(slope(0.1), square, map);
    const side = HEIGHT_CELLS + 1;
    assert.equal(heights.length, side * side);
    const at = (x, north = 0) => {
        const cell = (v) => Math.round(((v + square.half) / (2 * square.half)) * HEIGHT_CELLS);
        return heights[cell(north) * side + cell(x)];
    };
    const [west, middle, east] = [at(-30), at(0), at(30)];
    assert.ok(Math.abs(east - west - 6) < 1, `the slope rises by 6 m: ${west} to ${east}`);
    assert.ok(middle < 101 && middle > 98.5, `below the roof: ${middle}`);
    for (const x of [-30, 0, 30]) assert.ok(at(x) <= 100 + 0.1 * x + 0.1, `never above the ground: ${at(x)} at ${x}`);
    const rim = [heights[0], heights[side - 1], heights.at(-1), heights[HEIGHT_CELLS * side]];
    assert.ok(rim.every((v) => v === rim[0]), `level at the end: ${rim}`);
    assert.equal(findHeights([], square, map), null);
});

test("filling takes the nearest, and needs something", () => {
    const [size, values] = [8, new Float32Array(2 * 64)];
    values.set([3, 1], 0);
    values.set([7, 1], 2 * 63);
    assert.equal(fill(values, size, 1), true);
    assert.deepEqual([values[0], values[126]], [3, 7]);
    assert.ok(values[2 * 9] < 5 && values[2 * 54] > 5, "near ones count more");
    assert.ok([...values].every((v, i) => (i % 2 ? Math.abs(v - 1) < 1e-5 : v >= 3 - 1e-5 && v <= 7 + 1e-5)));
    assert.equal(fill(new Float32Array(2 * 64), size, 1), false);
});

test("tiles of a map cover an area, few and of the finest zoom", () => {
    const area = [13.39, 52.495, 13.41, 52.505];
    const pieces = piecesOf("https://m.example/{z}/{x}/{y}.png?k=1", ...area);
    const numbers = pieces.map(({ url }) => /^https:\/\/m\.example\/(\d+)\/(\d+)\/(\d+)\.png\?k=1$/.exec(url).slice(1).map(Number));
    const [zoom] = numbers[0];
    assert.ok(zoom === 15 || zoom === 16, `zoom ${zoom}`);
    assert.ok(pieces.length <= 36 && new Set(pieces.map(({ url }) => url)).size === pieces.length);
    const edges = (key, pick) => pick(...pieces.map((one) => one[key]));
    assert.ok(edges("west", Math.min) <= area[0] && edges("east", Math.max) >= area[2]);
    assert.ok(edges("south", Math.min) <= area[1] && edges("north", Math.max) >= area[3]);
    // Numbers as everybody counts them: Berlin's.
    assert.deepEqual([Math.floor(tileX(13.4, 12)), Math.floor(tileY(52.5, 12))], [2200, 1343]);
    assert.equal(piecesOf("{z}/{x}/{y}", -180, -89, 180, 89)[0].url, "2/0/0");
});
