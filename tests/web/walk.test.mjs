// On foot, without a browser: a wall that stands askew is walked along; one that is met head on ends the way; a curb is
// stepped on. A street is found beside a wide background, too, and the page is not held up meanwhile.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";

import { importSource } from "./lib/bundle.mjs";

const EYES_M = 1.7;
const ASKEW_DEG = 30; // the wall's direction from east to south
const STEP_M = 0.2;

// A street at height 0, and a wall through the origin; and Gaussians of a background, as wide as they come.
async function makeWalker(background = 0) {
    const places = [];
    for (let x = -24; x <= 24; x += 0.5) for (let z = -24; z <= 24; z += 0.5) places.push([x, 0, z]);
    const turn = (ASKEW_DEG * Math.PI) / 180;
    for (let along = -20; along <= 20; along += 0.2)
        for (let up = 0.2; up < 4; up += 0.2) places.push([along * Math.cos(turn), up, along * Math.sin(turn)]);
    const near = places.length;
    for (let i = 0; i < background; i++) places.push([300, 60, i]);
    return walkerAmong(places, near, (y) => (y ? 0.08 : 0.2));
}

const BLOCK = 60_000; // Gaussians of a tile, at most

// Gaussians at places, of which the first `near` are opaque, as wide as their height says, and the others a background.
async function walkerAmong(all, near, sigmaAt) {
    const { pack } = await importSource("pack.ts");
    const { Walker } = await importSource("walk.ts");
    const unit = 2 ** -8;
    const sizes = (sigma) => Math.round(16 * (Math.log(sigma) + 10));
    const blocks = [];
    for (let from = 0; from < all.length; from += BLOCK) {
        const places = all.slice(from, from + BLOCK);
        const count = places.length;
        const isNear = (i) => from + i < near;
        const splats = pack(
            {
                ...{ count, shDegree: 0, antialiased: false, unit, embedding: null },
                steps: Int32Array.from({ length: 3 * count }, (_, i) => Math.round(places[Math.floor(i / 3)][i % 3] / unit)),
                colors: Uint8Array.from({ length: 4 * count }, (_, i) => (i % 4 < 3 ? 128 : isNear(i >> 2) ? 250 : 3)),
                scales: new Uint8Array(3 * count).map((_, i) => (isNear(Math.floor(i / 3)) ? sizes(sigmaAt(places[Math.floor(i / 3)][1])) : 255)),
                rotations: new Uint32Array(count).fill(3 << 30), // none
                sh: new Uint8Array(0),
            },
            [0, 0, 0],
        );
        blocks.push({ id: blocks.length, splats });
    }
    return new Walker(() => blocks);
}

// The eyes after some steps in a direction, degrees from east to south.
async function walk(from, degrees, steps) {
    const walker = await makeWalker();
    const { Vector3 } = await importVector();
    const eye = new Vector3(from[0], EYES_M, from[1]);
    const [dx, dz] = [Math.cos, Math.sin].map((f) => STEP_M * f((degrees * Math.PI) / 180));
    for (let i = 0; i < steps; i++) walker.go(eye, dx, dz);
    return eye;
}

const importVector = () => import(new URL("../../web/node_modules/three/build/three.module.js", import.meta.url));

// From the wall's direction: how far along it, and how far off it on the side from which one comes.
function ofWall({ x, z }) {
    const turn = (ASKEW_DEG * Math.PI) / 180;
    return { along: x * Math.cos(turn) + z * Math.sin(turn), off: x * Math.sin(turn) - z * Math.cos(turn) };
}

for (const [name, degrees, least] of [["at 30 degrees", ASKEW_DEG + 30, 5], ["at 60 degrees", ASKEW_DEG + 60, 2.5], ["the other way", ASKEW_DEG + 130, -4]])
    test(`a wall askew is walked along, met ${name}`, async (t) => {
        const turn = (ASKEW_DEG * Math.PI) / 180;
        const start = [1.5 * Math.sin(turn), -1.5 * Math.cos(turn)]; // 1.5 m off its middle
        const eye = await walk(start, degrees, 60);
        const { along, off } = ofWall(eye);
        t.diagnostic(`${along.toFixed(2)} m along, ${off.toFixed(2)} m off`);
        assert.ok(least > 0 ? along > least : along < least, `${along} m along the wall`);
        assert.ok(off > 0.15 && off < 1, `${off} m off the wall`);
        assert.ok(Math.abs(eye.y - EYES_M) < 0.2, `eyes at ${eye.y} m`);
    });

test("a wall that is met head on ends the way", async () => {
    const turn = (ASKEW_DEG * Math.PI) / 180;
    const eye = await walk([3 * Math.sin(turn), -3 * Math.cos(turn)], ASKEW_DEG + 90, 60);
    const { along, off } = ofWall(eye);
    assert.ok(Math.abs(along) < 0.5 && off > 0.3 && off < 1, `${along} m along, ${off} m off`);
});

test("a street is found beside a wide background, and as soon", async (t) => {
    const { Vector3 } = await importVector();
    const middle = new Vector3(-10, 0, 10);
    const walkers = [await makeWalker(), await makeWalker(40)];
    const found = [];
    for (const walker of walkers) {
        const start = performance.now();
        const street = await walker.street(middle, 100);
        found.push({ street, seconds: (performance.now() - start) / 1000 });
    }
    const [plain, wide] = found;
    t.diagnostic(`${plain.seconds.toFixed(2)} s, with the background ${wide.seconds.toFixed(2)} s`);
    assert.ok(plain.street && wide.street && plain.street.distanceTo(wide.street) < 0.1, `${wide.street} in place of ${plain.street}`);
    assert.ok(wide.seconds < 10 * plain.seconds + 1, `${wide.seconds} s in place of ${plain.seconds}`);
});

// A street, and from x = 0 on what is higher: as wide as Gaussians of pavements are, so that they reach above it.
async function eyesBehindStep(height) {
    const { Vector3 } = await importVector();
    const places = [];
    for (let x = -6; x <= 6; x += 0.15) for (let z = -3; z <= 3; z += 0.15) places.push([x, x < 0 ? 0 : height, z]);
    for (let up = 0.1; up < height; up += 0.1) for (let z = -3; z <= 3; z += 0.15) places.push([0, up, z]);
    const walker = await walkerAmong(places, places.length, () => 0.22);
    const eye = new Vector3(-4, EYES_M, 0);
    for (let i = 0; i < 30; i++) walker.go(eye, STEP_M, 0);
    return eye;
}

for (const height of [0.12, 0.25, 0.4])
    test(`a curb of ${height} m is stepped on`, async () => {
        const eye = await eyesBehindStep(height);
        assert.ok(eye.x > 1.5, `it ends at ${eye.x} m`);
        assert.ok(Math.abs(eye.y - EYES_M - height) < 0.15, `eyes at ${eye.y} m`);
    });

for (const height of [1, 2.5])
    test(`a wall of ${height} m is not`, async () => {
        const eye = await eyesBehindStep(height);
        assert.ok(eye.x < 0 && Math.abs(eye.y - EYES_M) < 0.2, `it ends at ${eye.x} m, eyes at ${eye.y} m`);
    });

test("the search for a street holds the page up for a moment at a time", async (t) => {
    const MOST_MS = 200;
    const { Vector3 } = await importVector();
    const places = [];
    for (let x = -100; x <= 100; x += 0.18) for (let z = -100; z <= 100; z += 0.18) places.push([x, 0, z]);
    const walker = await walkerAmong(places, places.length, () => 0.2);
    // Of the processor: other programs take their part of the time.
    const passed = () => {
        const { user, system } = process.cpuUsage();
        return (user + system) / 1000;
    };
    let most = 0;
    let last = passed();
    let on = true;
    const tick = () => {
        most = Math.max(most, passed() - last);
        last = passed();
        if (on) setTimeout(tick);
    };
    setTimeout(tick);
    const began = passed();
    const street = await walker.street(new Vector3(0, 0, 0), 100);
    const all = passed() - began;
    on = false;
    t.diagnostic(`${all.toFixed(0)} ms in all, at most ${most.toFixed(0)} ms at once`);
    assert.ok(street && street.y < 0.3);
    assert.ok(all > 1.5 * MOST_MS, `a search of ${all} ms tells nothing`);
    assert.ok(most < MOST_MS, `${most} ms at once`);
});
