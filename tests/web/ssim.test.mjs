// The viewer's picture against the server's of the same pose, at seven poses of people who look at a city: SSIM.
// The poses follow from where the city's Gaussians are, so any store can be tried (run.mjs --tiles).
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { mkdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { bareBytes, closeAll, lookViewer, openViewer } from "./lib/browser.mjs";
import { placeOfEnu } from "./lib/geo.mjs";
import { decodePng } from "./lib/png.mjs";
import { firstDataSet, MOCK, openSource } from "./lib/source.mjs";
import { ssim } from "./lib/ssim.mjs";

const SIZE = { width: 480, height: 320 };
const SSIM_LEAST = 0.95; // of what is not background
const EYES_M = 2; // above the street
const KEPT = process.env.CITYSPLAT_PICTURES; // a folder for both pictures of each pose
let why = MOCK ? "the mock renders nothing" : "";

let source;
let viewer;
let page;
let id;
before(async () => {
    if (why) return;
    source = await openSource();
    id = await firstDataSet(source.url);
    viewer = await openViewer(source.url, SIZE);
    page = viewer.page;
});
after(() => closeAll(viewer, source));

// Where most Gaussians are: the middle, half of the width, and the ground.
function extent() {
    return page.evaluate(() => {
        const { frame, extent } = window.citysplat.viewer.stage;
        const middle = extent.min.clone().add(extent.max).multiplyScalar(0.5);
        const { lon, lat } = frame.placeOf(middle);
        const floor = frame.placeOf(middle.clone().setY(extent.min.y)).h;
        return { origin: { lon, lat, h: floor }, half: (extent.max.x - extent.min.x) / 2 };
    });
}

// The lowest place near the middle, as seen from above: nobody stands on roofs.
function street(origin, half) {
    const places = [];
    for (let e = -6; e <= 6; e++) for (let n = -6; n <= 6; n++) places.push(placeOfEnu(origin, [(e * half) / 15, (n * half) / 15, 0]));
    return page.evaluate(
        (all) =>
            all
                .map((one) => ({ ...one, h: window.citysplat.viewer.heightOf(one) }))
                .filter(({ h }) => h !== null)
                .reduce((a, b) => (b.h < a.h ? b : a)),
        places,
    );
}

// Multiples of half of the city's width: east, north, up; heading, pitch.
async function sevenPoses() {
    const { origin, half } = await extent();
    const at = (e, n, u, heading, pitch) => ({
        ...placeOfEnu(origin, [e * half, n * half, u * half]),
        ...{ heading, pitch, fov: 45 },
    });
    const low = await street(origin, half);
    return {
        overview: at(0, -2, 1.6, 0, -38),
        aslant: at(1.1, -1.1, 0.7, 315, -24),
        near: at(0.35, 0.35, 0.35, 225, -35),
        street: { ...low, h: low.h + EYES_M, heading: 30, pitch: 0, fov: 60 },
        down: at(0.1, -0.1, 1.2, 0, -90),
        far: at(-4, 3, 2, 127, -22),
        edge: at(-0.9, 0, 0.25, 180, -20),
    };
}

async function served({ lon, lat, h, heading, pitch, fov }) {
    const place = `${lon.toFixed(8)},${lat.toFixed(8)},${h.toFixed(4)}@${heading},${pitch},${fov}`;
    return fetch(`${source.url}/d/${id}/static/${place}/${SIZE.width}x${SIZE.height}.png?supersample=1`);
}

test("the viewer draws what the server draws, at seven poses", { skip: Boolean(why) }, async (t) => {
    const poses = await sevenPoses();
    const low = [];
    for (const [name, pose] of Object.entries(poses)) {
        const response = await served(pose);
        if (response.status === 501 || response.status === 503) return t.skip(`no pictures: ${response.status}`);
        assert.equal(response.status, 200, await response.clone().text());
        const bytes = Buffer.from(await response.arrayBuffer());
        await lookViewer(page, pose);
        const own = await bareBytes(page);
        if (KEPT) {
            mkdirSync(KEPT, { recursive: true });
            writeFileSync(join(KEPT, `${name}-server.png`), bytes);
            writeFileSync(join(KEPT, `${name}-viewer.png`), own);
        }
        const { covered, whole, share } = ssim(decodePng(own), decodePng(bytes));
        const { gaussians } = await page.evaluate(() => window.citysplat.state);
        t.diagnostic(
            `${name}: ${covered.toFixed(4)} of what is not background (${(100 * share).toFixed(0)} %), ` +
                `${whole.toFixed(4)} of all; ${gaussians} Gaussians`,
        );
        assert.ok(share > 0.02, `${name}: nothing is in sight`);
        if (covered < SSIM_LEAST) low.push(`${name} ${covered.toFixed(4)}`);
    }
    assert.deepEqual(low, []);
});
