// Light and weather in the browser: colours are computed there, from tiles as they were trained. A
// change asks for no tile and shows nothing in between; the picture is that of tiles which the server
// baked; people choose by photographs, mix two, lay them side by side, or take what was photographed
// here.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { barePicture, closeAll, lookViewer, openPage, setControl, waitForViewer } from "./lib/browser.mjs";
import { importSource } from "./lib/bundle.mjs";
import { measureContent, rmsDifference } from "./lib/checks.mjs";
import { decodeDrc as decodeReference } from "./lib/drc.mjs";
import { loosen } from "./lib/packed.mjs";
import { decodePng } from "./lib/png.mjs";
import { getBytes, getJson, GIVEN_TILES, MOCK, openLitCity } from "./lib/source.mjs";
import { listContents } from "./lib/tileset.mjs";

const SIZE = { width: 720, height: 480 };
const NAME = "lit";
const THUMBNAIL_BYTES = 6144;
// Of 255: what the low bits that embeddings lack do to a colour (docs/formats.md). Beside the 1.8 that the
// rounding of everything else does, 2 % fewer channels are then within 2 (of a normal distribution).
const EMBEDDING_RMS = 0.56;
const NEAR_MARGIN = 0.025;
const skip = { skip: MOCK || GIVEN_TILES ? "needs a city trained with appearance" : false };

let source;
let viewer;
let page;
let table; // what the server tells of the photographs
let names; // of them
let folder; // of the revision
const asked = []; // addresses since it was emptied
before(async () => {
    if (skip.skip) return;
    source = await openLitCity();
    viewer = await openPage(`${source.url}/?scene=${NAME}`, SIZE);
    page = viewer.page;
    page.on("request", (request) => asked.push(request.url()));
    await waitForViewer(page);
    const { asset } = await getJson(`${source.url}/d/${NAME}/tileset.json`);
    folder = `${source.url}/d/${NAME}/r/${asset.tilesetVersion}`;
    table = await getJson(`${folder}/appearances.json`);
    names = table.photographs.map((one) => one.name);
    await page.waitForSelector("#photos-button:not([hidden])");
});
after(() => closeAll(viewer, source));

const picture = () => barePicture(page);
const state = (on = page) => on.evaluate(() => window.citysplat.state);

function brightness(png) {
    let sum = 0;
    for (let y = 0; y < png.height; y += 2)
        for (let x = 0; x < png.width; x += 2) for (const v of png.at(x, y).slice(0, 3)) sum += v;
    return sum;
}

async function wear(appearance, on = page) {
    await on.evaluate((text) => window.citysplat.viewer.setAppearance(text), appearance);
    await waitForViewer(on);
    assert.equal((await state(on)).appearance, appearance);
}

async function choose(id, value) {
    await setControl(page, id, value);
    await waitForViewer(page);
}

// The view as the server draws it, without rounding to the integers of tiles; null where it draws none.
async function serverPicture({ lon, lat, h, heading, pitch, fov }, appearance) {
    const place = `${lon.toFixed(7)},${lat.toFixed(7)},${h.toFixed(3)}`;
    const view = `${place}@${heading.toFixed(3)},${pitch.toFixed(3)},${fov}`;
    const query = appearance ? `?appearance=${encodeURIComponent(appearance)}` : "";
    const size = `${SIZE.width}x${SIZE.height}`;
    const response = await fetch(`${folder}/static/${view}/${size}.png${query}`);
    if (response.status === 503) return null;
    assert.equal(response.status, 200, response.url);
    return decodePng(Buffer.from(await response.arrayBuffer()));
}

// Largest difference of a channel, and the one that 99 % of them stay below, in 1/255.
function differences(a, b) {
    const counts = new Array(256).fill(0);
    for (let y = 0; y < a.height; y++)
        for (let x = 0; x < a.width; x++) {
            const [p, q] = [a.at(x, y), b.at(x, y)];
            for (let c = 0; c < 3; c++) counts[Math.abs(p[c] - q[c])]++;
        }
    const total = counts.reduce((sum, n) => sum + n, 0);
    let seen = 0;
    const most = counts.findLastIndex((n) => n > 0);
    const common = counts.findIndex((n) => (seen += n) >= 0.99 * total);
    const near = (counts[0] + counts[1] + counts[2]) / total; // the share within 2 of 255
    return { most, common, near };
}

test("every appearance of the server is offered, with its photographs' times", skip, async () => {
    const list = await getJson(`${source.url}/d/${NAME}/appearances`);
    const offered = await page.$$eval("#appearance-from option", (all) => all.map((one) => one.value));
    assert.deepEqual([...offered].sort(), list.appearances.map((one) => one.name).sort());
    assert.equal((await state()).appearance, "");
    assert.ok(names.length > 8, `${names.length} photographs`);
    const groups = await page.$$eval("#appearance-from optgroup", (all) => all.map((one) => one.label));
    assert.deepEqual(groups, ["June 1, 2024 · morning"]);
});

test("the browser's decoder of .drc gives what draco3d gives, and refuses damage", skip, async () => {
    const { decodeDrc } = await importSource("drc.ts");
    const draco = await createRequire(import.meta.url)("draco3d").createDecoderModule({});
    const [tile] = await listContents(`${source.url}/d/${NAME}/tileset.json`, getJson);
    for (const query of ["sh=0", "sh=1", "sh=2", "preset=near-lossless", "preset=preview", "preset=spz"]) {
        const file = await getBytes(tile.url.replace(/(\.lowpass)?\.glb.*$/, `.drc?appearance=none&${query}`));
        const want = decodeReference(draco, file);
        const got = decodeDrc(new Uint8Array(file), [0, 0, 0]);
        const fields = loosen(got);
        assert.deepEqual([got.count, got.shDegree], [want.count, want.shDegree], query);
        for (let i = 0; i < want.count; i++) {
            for (let k = 0; k < 3; k++) {
                const at = want.position[3 * i + k] / 2 ** want.fractionBits;
                assert.ok(Math.abs(fields.centres[3 * i + k] - at) < 1e-4, `${query} position ${i}`);
                assert.equal(fields.colors[4 * i + k], want.color[3 * i + k], `${query} colour ${i}`);
                assert.equal(fields.scales[3 * i + k], want.scale[3 * i + k], `${query} scale ${i}`);
            }
            assert.equal(fields.colors[4 * i + 3], want.alpha[i], `${query} opacity ${i}`);
            assert.equal(fields.rotations[i], want.rotation[i], `${query} rotation ${i}`);
        }
        assert.ok(Buffer.from(fields.sh.buffer).equals(Buffer.from(Uint8Array.from(want.sh).buffer)), `${query} harmonics`);
        const { embedding } = got;
        const own = new Uint8Array(embedding.planes[0].buffer);
        assert.equal(embedding.length, 16);
        for (let i = 0; i < 16 * want.count; i++)
            assert.equal(own[i], want.embedding[i], `${query} embedding ${i}`);
        for (let at = 0; at < file.length; at += 997) {
            const damaged = Uint8Array.from(file);
            damaged[at] ^= 16;
            assert.throws(() => decodeDrc(damaged), Error, `byte ${at} is damaged`);
            assert.throws(() => decodeDrc(damaged.subarray(0, at)), Error, `cut at ${at}`);
        }
    }
});

test("a change asks for nothing and never shows a gap", skip, async (t) => {
    await wear("");
    const looks = [brightness(await picture())];
    for (const name of names.slice(0, 4)) {
        await wear(name);
        looks.push(brightness(await picture()));
    }
    const least = Math.min(...looks);
    const bare = (on) =>
        page.evaluate((off) => {
            document.documentElement.dataset.ui = off ? "off" : "on";
            window.citysplat.viewer.backdrop = !off;
        }, on);
    await bare(true);
    await waitForViewer(page);
    asked.length = 0;
    let darkest = Infinity;
    let shots = 0;
    for (let round = 0; round < 2; round++)
        for (const name of ["", ...names.slice(0, 4)]) {
            await page.evaluate((text) => void window.citysplat.viewer.setAppearance(text), name);
            for (let i = 0; i < 2; i++, shots++) {
                const { gaussians } = await state();
                assert.ok(gaussians > 0, "nothing is drawn while the appearance changes");
                darkest = Math.min(darkest, brightness(decodePng(await page.screenshot())));
            }
        }
    await waitForViewer(page);
    await bare(false);
    const grounds = new Set();
    for (const name of names.slice(0, 3)) {
        await wear(name);
        grounds.add(await page.evaluate(() => String(window.citysplat.viewer.city.backdrop.mesh.material.uniforms.groundColor.value.toArray())));
    }
    assert.equal(grounds.size, 3, "ground and sky have the light of the city");
    t.diagnostic(`${shots} pictures, the darkest ${(darkest / least).toFixed(2)} of the darkest look`);
    assert.ok(darkest > 0.9 * least, "a picture is darker than every appearance");
    const tiles = asked.filter((url) => /\/t\/|tileset|appearance/.test(url));
    assert.deepEqual(tiles, [], "asked for on a change");
});

test("where frames take long an appearance shows roughly at once, and exactly when it rests", skip, async (t) => {
    await wear(names[0]);
    // As on a machine that draws slowly, whatever this one does.
    const slow = (ms) => page.evaluate((v) => (window.citysplat.viewer.pace.frameMs = v), ms);
    await slow(1000);
    await page.evaluate(() => {
        const { viewer } = window.citysplat;
        document.documentElement.dataset.ui = "off";
        viewer.backdrop = false;
    });
    await waitForViewer(page);
    await slow(1000);
    await page.evaluate(() => (window.citysplat.viewer.backdrop = false)); // a frame that is kept
    await waitForViewer(page);
    const old = decodePng(await page.screenshot());
    asked.length = 0;
    const seen = await page.evaluate(async (names) => {
        const { viewer } = window.citysplat;
        const out = [];
        let last = "";
        viewer.on("preview", (name) => (last = name));
        viewer.on("appearance", (name) => out.push(["exact", name]));
        for (const name of names) {
            await viewer.setAppearance(name);
            out.push(["rough", last, viewer.state.ready, viewer.state.appearance]);
        }
        return { out, png: viewer.canvas.toDataURL("image/png") };
    }, [names[3], names[5]]);
    assert.deepEqual(seen.out, [
        ["rough", names[3], false, names[0]],
        ["rough", names[5], false, names[0]],
    ]);
    const rough = decodePng(Buffer.from(seen.png.split(",")[1], "base64"));
    await waitForViewer(page);
    assert.equal((await state()).appearance, names[5]);
    const exact = decodePng(await page.screenshot());
    await page.evaluate(() => {
        document.documentElement.dataset.ui = "on";
        window.citysplat.viewer.backdrop = true;
    });
    const [near, far] = [rmsDifference(rough, exact), rmsDifference(old, exact)];
    t.diagnostic(`the rough picture is ${near.toFixed(2)} from the exact one, the old one ${far.toFixed(2)}`);
    assert.ok(near < 0.6 * far, `${near} of ${far}`);
    assert.deepEqual(asked.filter((url) => /\/t\/|tileset|appearance/.test(url)), []);
});

test("the picture is that of tiles which the server baked", skip, async (t) => {
    const baked = await openPage(`${source.url}/?scene=${NAME}&colours=server`, SIZE);
    try {
        await waitForViewer(baked.page);
        const pose = await page.evaluate(() => window.citysplat.pose());
        await baked.page.evaluate((p) => window.citysplat.look(p), pose);
        const mix = `${names[0]}:0.3,${names[5]}:0.7`;
        let far = 0;
        let before = null;
        for (const appearance of ["", names[5], mix]) {
            await wear(appearance);
            await wear(appearance, baked.page);
            const own = await picture();
            const theirs = await barePicture(baked.page);
            const percent = (share) => `${(100 * share).toFixed(2)} %`;
            const { most, common, near } = differences(own, theirs);
            t.diagnostic(
                `${appearance || "default"}: ${percent(near)} within 2, 99 % within ${common}, largest ${most} of 255`,
            );
            const exact = await serverPicture(pose, appearance);
            // Opacities and colours of both are rounded, each by itself, and Gaussians here are large. The
            // default light makes some brighter than white, which the server and the page cut, and tiles
            // with final colours cannot: there the server's picture alone is the measure.
            const bright = exact && rmsDifference(own, exact) < 0.85 * rmsDifference(theirs, exact);
            if (appearance || !bright)
                assert.ok(common <= 6 && most <= 16, `differs by ${common} (99 %), ${most} (largest)`);
            if (exact) {
                const [a, b] = [rmsDifference(own, exact), rmsDifference(theirs, exact)];
                t.diagnostic(`from the server's picture: ${a.toFixed(2)}, baked tiles ${b.toFixed(2)}`);
                const [mine, baked] = [own, theirs].map((one) => differences(one, exact).near);
                t.diagnostic(`within 2 of the server's picture: ${percent(mine)}, baked tiles ${percent(baked)}`);
                assert.ok(a < Math.hypot(b, EMBEDDING_RMS) + 0.2, `${a} from the server's picture, baked tiles ${b}`);
                assert.ok(mine > baked - NEAR_MARGIN, `${mine} within 2 of it, of baked tiles ${baked}`);
            }
            if (before) far = Math.max(far, rmsDifference(own, before));
            before = own;
        }
        assert.ok(far > 3, "all appearances look the same");
    } finally {
        await baked.close();
    }
});

test("a mix lies between its two ends, and the address keeps it", skip, async () => {
    const seen = [];
    for (const name of [names[0], names[1], names[5]]) {
        await wear(name);
        seen.push({ name, light: brightness(await picture()) });
    }
    seen.sort((a, b) => a.light - b.light);
    const [dark, light] = [seen[0], seen.at(-1)];
    await choose("appearance-from", dark.name);
    await choose("appearance-to", light.name);
    assert.equal(await page.isVisible("#appearance-mix"), true);
    const mixed = await picture();
    const between = brightness(mixed);
    assert.ok(dark.light < between && between < light.light, "not between");
    const { appearance } = await state();
    assert.match(appearance, /:0\.5,.*:0\.5$/);
    await page.waitForFunction((text) => decodeURIComponent(location.hash).includes(text), appearance);
    await page.reload();
    await waitForViewer(page);
    assert.equal((await state()).appearance, appearance);
    await page.waitForFunction(() => document.getElementById("appearance-to").value !== "");
    assert.ok(rmsDifference(mixed, await picture()) < 2, "the address shows another picture");
    await choose("appearance-to", "");
});

test("photographs show, are small, and are chosen by mouse and by keys", skip, async (t) => {
    await page.click("#photos-button");
    await page.waitForFunction(() => {
        const images = [...document.querySelectorAll("#photo-list img")].slice(0, 3);
        return images.length === 3 && images.every((one) => one.complete && one.naturalWidth >= 96);
    });
    const group = await page.getAttribute("#photo-list [role=group]", "aria-label");
    assert.equal(group, "June 1, 2024 · morning");
    let most = 0;
    for (const { thumbnail } of table.photographs)
        most = Math.max(most, (await getBytes(`${folder}/${thumbnail}`)).length);
    t.diagnostic(`thumbnails of at most ${most} bytes`);
    assert.ok(most <= THUMBNAIL_BYTES);
    await page.click("#photo-list label:nth-of-type(2)");
    await waitForViewer(page);
    assert.equal((await state()).appearance, names[1]);
    assert.equal(await page.inputValue("#appearance-from"), names[1]);
    await page.keyboard.press("ArrowRight");
    await waitForViewer(page);
    assert.equal((await state()).appearance, names[2]);
    await page.keyboard.press("Escape");
    await page.click("#photos-close");
    assert.equal(await page.isVisible("#photos"), false);
});

// The server was away for a moment, and is back with the same city in another revision.
async function comeBackAsAnother() {
    const revision = "0123456789ab";
    const old = folder.split("/").at(-1);
    const tileset = (url) => url.pathname.endsWith(`/${NAME}/tileset.json`);
    const network = (url) => url.pathname.includes(`/r/${revision}/`);
    await page.route(tileset, async (route) => {
        const response = await route.fetch();
        const json = await response.json();
        json.asset.tilesetVersion = revision;
        await route.fulfill({ response, json });
    });
    await page.route(network, async (route) => {
        const response = await route.fetch({ url: route.request().url().replace(revision, old) });
        await route.fulfill({ response });
    });
    await page.evaluate(() => window.citysplat.viewer.link.lose());
    await page.waitForFunction((id) => window.citysplat.viewer.info.revision === id, revision);
    await waitForViewer(page);
    await page.unroute(tileset);
    await page.unroute(network);
}

test("two appearances lie side by side", skip, async () => {
    await wear(names[0]);
    const left = await picture();
    await wear(names[5]);
    const right = await picture();
    await choose("appearance-from", names[0]);
    await choose("appearance-to", names[5]);
    asked.length = 0;
    await page.click("#appearance-split");
    assert.match(await page.$eval("#appearance-divider", (node) => getComputedStyle(node).backgroundImage), /gradient/); // a line is seen
    await page.focus("#appearance-divider");
    await page.keyboard.press("ArrowLeft");
    await waitForViewer(page);
    const both = await picture();
    const line = 0.48 * SIZE.width;
    const part = (png, from, to) => ({
        width: to - from,
        height: png.height,
        at: (x, y) => png.at(from + x, y),
    });
    const check = (png, how) => {
        const compare = (other, from, to) => differences(part(png, from, to), part(other, from, to)).common;
        assert.ok(compare(left, 0, line - 24) <= 1, `${how}the left is not the first one`);
        assert.ok(compare(right, line + 24, SIZE.width) <= 1, `${how}the right is not the second one`);
        assert.ok(compare(left, line + 24, SIZE.width) > 4, `${how}both sides look the same`);
    };
    check(both, "");
    assert.equal(await page.getAttribute("#appearance-divider", "aria-valuenow"), "48");
    assert.deepEqual(asked.filter((url) => /\/t\//.test(url)), []);
    // The link says both, and where the line is.
    await page.waitForFunction(() => new URLSearchParams(location.search).get("split") === "48");
    assert.equal(await page.evaluate(() => new URLSearchParams(location.search).get("second")), names[5]);
    const pose = await page.evaluate(() => window.citysplat.pose());
    await page.reload();
    await page.waitForFunction((name) => window.citysplat?.viewer.secondAppearance === name, names[5]);
    await waitForViewer(page);
    check(await picture(), "from the link: ");
    await lookViewer(page, pose); // with all its digits
    const again = await picture();
    await comeBackAsAnother();
    assert.equal(await page.evaluate(() => window.citysplat.viewer.secondAppearance), names[5]);
    assert.ok(rmsDifference(again, await picture()) < 0.5, "another revision shows other appearances");
    await page.evaluate(() => window.citysplat.viewer.setSecondAppearance("no-such-photograph.jpg"));
    assert.match(await page.textContent("#banner-notice"), /no-such-photograph/);
    assert.equal(await page.evaluate(() => window.citysplat.viewer.secondAppearance), names[5]);
    await page.click("#banner-notice button");
    await page.click("#appearance-split");
    await choose("appearance-to", "");
    assert.ok(rmsDifference(left, await picture()) < 0.5, "the first one does not come back");
});

test("as photographed here is the photograph that was taken here", skip, async () => {
    for (const row of [3, names.length - 1]) {
        const { lon, lat, h, heading, pitch, name } = table.photographs[row];
        await page.evaluate((pose) => window.citysplat.look(pose), { lon, lat, h, heading, pitch, fov: 45 });
        await waitForViewer(page);
        await page.click("#appearance-here");
        await waitForViewer(page);
        assert.equal((await state()).appearance, name);
    }
    // A cached document that is asked for again in the background may be cut off by the reload.
    assert.deepEqual(viewer.log, []);
});

test("an appearance that is not there leaves the picture and the choice", skip, async () => {
    const { appearance } = await state();
    await page.evaluate(() => window.citysplat.viewer.setAppearance("no-such-photograph.jpg"));
    assert.match(await page.textContent("#banner-notice"), /no-such-photograph/);
    assert.equal(await page.isVisible("#problem"), false);
    const now = await state();
    assert.deepEqual([now.appearance, now.wanted], [appearance, appearance]);
    assert.ok(now.gaussians > 0);
});

test("a link to a light that is gone opens in the default light, and says so", skip, async () => {
    const opened = async (query) => {
        await page.goto(`${source.url}/?${query}`);
        await page.waitForSelector("#banner-notice");
        assert.match(await page.textContent("#banner-notice"), /no light and weather "gone\.jpg"/);
        await waitForViewer(page);
        const { appearance, error, ready } = await state();
        assert.deepEqual([appearance, error, ready], ["", null, true]);
        assert.equal(await page.isVisible("#problem"), false);
    };
    await opened(`scene=${NAME}&appearance=gone.jpg`);
    await opened(`scene=${source.plain}&appearance=gone.jpg`); // which has one light
});

test("a scene without appearance is asked for as before", skip, async () => {
    asked.length = 0;
    await page.evaluate((id) => window.citysplat.viewer.openScene(id), source.plain);
    await waitForViewer(page);
    const tiles = asked.filter((url) => url.includes("/t/"));
    assert.ok(tiles.length > 0 && tiles.every((url) => /\.drc(\?|$)/.test(url)), tiles.join(" "));
    assert.deepEqual(asked.filter((url) => /appearance/.test(url)), []);
    assert.equal(await page.isVisible("#appearance"), false);
    assert.ok((await state()).gaussians > 0);
    const { share } = measureContent(await picture());
    assert.ok(share > 0.1, `only ${(100 * share).toFixed(1)} % of the picture is not background`);
    await page.evaluate((id) => window.citysplat.viewer.openScene(id), NAME);
    await waitForViewer(page);
    assert.ok(measureContent(await picture()).share > 0.1, "the first scene does not come back");
});
