// A tour and notes, at a desk and on a phone: made by what is visible, by hand and by keys, carried by the link to somebody else,
// played and paused there, and in a page of another host by the element. Links that somebody made to do harm.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { deflateRawSync } from "node:zlib";

import { closeAll, lookViewer, openPage, waitForViewer } from "./lib/browser.mjs";
import { importSource } from "./lib/bundle.mjs";
import { SOUTH } from "./lib/checks.mjs";
import { BLUE_TOP, ORIGIN } from "./lib/city.mjs";
import { serveFiles } from "./lib/files.mjs";
import { placeOfEnu, project } from "./lib/geo.mjs";
import { hostedBy, snippets } from "./lib/snippets.mjs";
import { GIVEN_TILES, MOCK, openSource } from "./lib/source.mjs";

const SCREENS = {
    desk: { width: 1000, height: 640 },
    phone: { width: 390, height: 844, hasTouch: true, isMobile: true },
};
const skip = { skip: MOCK || GIVEN_TILES ? "needs the test city" : false };
const HOSTILE = '<img src=x onerror="window.harmed=1">';
const STORY_MAX = 4000; // characters, as docs/viewer.md says
const TOP = [0, 0, BLUE_TOP[2] + 0.5];

let source;
before(async () => {
    if (!skip.skip) source = await openSource();
});
after(() => closeAll(source));

async function openAt(screen, address = source.url) {
    const opened = await openPage("about:blank", { ...SCREENS[screen], permissions: ["clipboard-read", "clipboard-write"] });
    await opened.page.goto(address);
    await waitForViewer(opened.page);
    return opened;
}

async function picture(page, name) {
    if (process.env.STORY_SHOTS) await page.screenshot({ path: join(process.env.STORY_SHOTS, `${name}.png`) });
}

const packed = (value) => deflateRawSync(JSON.stringify(value)).toString("base64url");
const labels = (page) => page.locator(".citysplat-label").allTextContents();
const headingOf = (page) => page.evaluate(() => window.citysplat.pose().heading);
const at = (heading) => ({ ...SOUTH, heading });

for (const screen of Object.keys(SCREENS))
    test(`a tour and notes go to somebody else by a link: ${screen}`, skip, async (t) => {
        const phone = screen === "phone";
        const { page, log, close } = await openAt(screen);
        const press = (what) => (phone ? page.tap(what) : page.click(what));
        const openBox = async () => {
            if (phone && (await page.locator("#panel.folded").count())) await press("#fold");
            if (!(await page.locator("#tour-box[open]").count())) await press("#tour-box summary");
        };
        const write = async (words) => {
            await page.waitForSelector("#note-form:not([hidden])");
            await page.fill("#note-text", words);
            await page.keyboard.press("Enter");
            await page.waitForSelector("#note[hidden]", { state: "attached" });
        };
        await openBox();
        for (const heading of [10, 340]) {
            await lookViewer(page, at(heading));
            await press("#tour-add");
        }
        await page.locator("#tour li").nth(1).locator("button").nth(1).press("Enter"); // by keys
        await write("The needle, from the south");
        // A note, by hand; on a phone the panel makes way. Nothing else happens at this press.
        await lookViewer(page, SOUTH);
        await openBox();
        await press("#note-add");
        const [x, y] = project(ORIGIN, SOUTH, TOP, SCREENS[screen].width, SCREENS[screen].height);
        await (phone ? page.touchscreen.tap(x, y) : page.mouse.click(x, y));
        await write(HOSTILE);
        assert.equal(await page.isVisible("#place"), false);
        // Another in the middle of the picture, by keys alone.
        await openBox();
        await page.locator("#note-add").press("Enter");
        await page.keyboard.press("Enter"); // "In the middle" has the focus
        await write("Middle");
        await openBox();
        await picture(page, `${screen}-made`);
        assert.deepEqual(await page.locator("#tour li > button:first-child").allTextContents(), ["View 1", "The needle, from the south"]);
        await press("#share");
        await page.waitForFunction(() => navigator.clipboard.readText().then((text) => text.includes("&story=")));
        const link = await page.evaluate(() => navigator.clipboard.readText());
        t.diagnostic(`${link.length} characters`);
        assert.deepEqual(log, []);
        await close();

        const other = await openAt(screen, link);
        const there = other.page;
        await there.waitForSelector("#tour-card:not([hidden])");
        assert.deepEqual((await labels(there)).sort(), [HOSTILE, "Middle"].sort());
        assert.equal(await there.evaluate(() => window.harmed), undefined);
        // The note lies where it was put.
        await lookViewer(there, SOUTH);
        const box = await there.locator(".citysplat-label", { hasText: "<img" }).boundingBox();
        assert.ok(Math.abs(box.x + box.width / 2 - x) < 12 && box.y < y && y - box.y < 120, JSON.stringify({ box, x, y }));
        await (phone ? there.tap("#tour-pause") : there.click("#tour-pause"));
        await there.waitForFunction(() => Math.abs(window.citysplat.pose().heading - 10) < 0.05);
        await picture(there, `${screen}-played`);
        assert.equal(await there.textContent("#tour-caption"), "View 1");
        // Paused on the way by its key; then on from there.
        await there.waitForFunction(() => document.getElementById("tour-caption").textContent.startsWith("The needle"));
        await there.keyboard.press("t");
        const stopped = await there.textContent("#tour-pause");
        assert.equal(stopped, "Play");
        await there.keyboard.press("t");
        await there.waitForFunction(() => Math.abs(window.citysplat.pose().heading - 340) < 0.05);
        await there.waitForFunction(() => document.getElementById("tour-pause").textContent === "Play"); // its end
        // What the other one has of his own is not touched by it.
        assert.equal(await there.evaluate(() => Object.keys(localStorage).some((key) => key.startsWith("citysplat.tour"))), false);
        assert.deepEqual(other.log, []);
        await other.close();
    });

test("a note is whole inside of the picture, and goes where the city is in front of it", skip, async () => {
    const words = "A long note that is wider than what is left of the picture at its edge";
    const { width, height } = SCREENS.desk;
    const link = (...enu) => `&story=${packed([[], enu.map((p, i) => [...["lon", "lat", "h"].map((k) => placeOfEnu(ORIGIN, p)[k]), `${i} ${words}`])])}`;
    const { page, log, close } = await openAt("desk", `${source.url}/#13.4,52.5,300,0,-30${link(TOP, [TOP[0], TOP[1], -40])}`);
    await lookViewer(page, SOUTH);
    // One is on a roof, the other is deep below it.
    await page.waitForFunction(() => [...document.querySelectorAll(".citysplat-label")].map((one) => one.hidden).join() === "false,true");
    // Turned until the label is at the right edge.
    const edge = await page.evaluate(async ([pose, w]) => {
        const { viewer } = window.citysplat;
        for (let heading = pose.heading; heading > pose.heading - 60; heading -= 0.25) {
            viewer.lookAt({ ...pose, heading });
            await new Promise((done) => { const end = viewer.on("frame", () => (end(), done())); });
            const [note] = document.querySelectorAll(".citysplat-label");
            const box = note.getBoundingClientRect();
            if (note.hidden) return { none: heading };
            if (box.right >= w - 5) return { left: box.left, right: box.right, top: box.top, bottom: box.bottom };
        }
        return null;
    }, [SOUTH, width]);
    assert.ok(edge && edge.right <= width - 3 && edge.left > 0 && edge.top > 0 && edge.bottom < height, JSON.stringify(edge));
    assert.deepEqual(log, []);
    await close();
});

const noteAt = (enu, text) => [...["lon", "lat", "h"].map((k) => placeOfEnu(ORIGIN, enu)[k]), text];

test("a note keeps out of the panel, and goes when the panel is in front of it", skip, async () => {
    const { height } = SCREENS.desk;
    const { page, log, close } = await openAt("desk", `${source.url}/#13.4,52.5,300,0,-30&story=${packed([[], [noteAt(TOP, "A note that is wide enough to reach below the panel")]])}`);
    const panel = await page.locator("#panel").boundingBox();
    const note = () => page.evaluate(() => {
        const label = document.querySelector(".citysplat-label");
        const { left, right } = label.getBoundingClientRect();
        return { hidden: label.hidden, left, right };
    });
    // The place beside the panel, then below it: turned so that it is there.
    const turnTo = async (x) => {
        for (let heading = SOUTH.heading; heading < SOUTH.heading + 60; heading += 0.5) {
            if (project(ORIGIN, { ...SOUTH, heading }, TOP, SCREENS.desk.width, height)[0] > x) continue;
            await lookViewer(page, { ...SOUTH, heading });
            return;
        }
        assert.fail(`the needle does not come to ${x}`);
    };
    await turnTo(panel.x + panel.width + 30);
    const beside = await note();
    assert.ok(!beside.hidden && beside.left >= panel.x + panel.width, JSON.stringify({ beside, panel }));
    await picture(page, "beside");
    await turnTo(panel.x + panel.width / 2);
    await page.waitForFunction(() => document.querySelector(".citysplat-label").hidden);
    await picture(page, "below");
    await page.click("#fold");
    await page.waitForFunction(() => !document.querySelector(".citysplat-label").hidden);
    await picture(page, "folded");
    assert.deepEqual(log, []);
    await close();
});

// The tour of the documents' example, which the other host has as a file.
const TOUR = {
    type: "citysplat-tour",
    views: [10, 340].map((heading, i) => {
        const { lon, lat, h, pitch } = SOUTH;
        return { name: ["From the south-west", "The needle, from the south-east"][i], view: [lon, lat, h, heading, pitch].join(), seconds: 1 };
    }),
    notes: [{ ...placeOfEnu(ORIGIN, TOP), text: HOSTILE }],
};

for (const [screen, shape] of Object.entries(SCREENS))
    test(`the element plays a tour and shows notes in a page of another host: ${screen}`, skip, async (t) => {
        const dir = mkdtempSync(join(tmpdir(), "citysplat-story-"));
        const other = await serveFiles((path) => join(dir, normalize(path)));
        t.after(() => (other.close(), rmSync(dir, { recursive: true, force: true })));
        const example = snippets("viewer.md", "### The element", "html")[1];
        const head = '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>x</title><link rel="icon" href="data:,">';
        writeFileSync(join(dir, "index.html"), head + hostedBy(example, source.url));
        writeFileSync(join(dir, "tour.json"), JSON.stringify(TOUR));
        const { page, log, close } = await openPage(`${other.url}/index.html`, shape);
        await page.waitForFunction(() => document.getElementById("city").viewer?.state.ready);
        const press = (label) => page.locator("city-splat").getByRole("button", { name: label })[shape.hasTouch ? "tap" : "click"]();
        const heading = (to) => page.waitForFunction((to) => Math.abs(document.getElementById("city").viewer.pose.heading - to) < 0.05, to);
        const out = (words) => page.waitForFunction((words) => document.getElementById("out").textContent === words, words);
        assert.deepEqual(await page.locator("city-splat .citysplat-label").allTextContents(), [HOSTILE]);
        await out("1 of 2: From the south-west");
        await page.evaluate(() => {
            window.clicks = 0;
            document.getElementById("city").addEventListener("click", () => window.clicks++);
        });
        await press("Play");
        await heading(10);
        await out("2 of 2: The needle, from the south-east");
        await press("Pause");
        await picture(page, `${screen}-element`);
        await press("View before");
        await heading(10);
        await press("Play");
        await heading(340);
        await page.waitForFunction(() => !document.getElementById("city").player.state.playing);
        assert.equal(await page.evaluate(() => window.clicks), 0, "a press on the card is no click of the city");
        assert.equal(await page.evaluate(() => window.harmed), undefined);
        // By a link's text; then none; then one that cannot be read.
        const set = (text) => page.evaluate((text) => (document.getElementById("city").tour = text), text);
        await set(packed([[["Link", TOUR.views[0].view, 0]], []]));
        await out("1 of 1: Link");
        assert.equal(await page.locator("city-splat .citysplat-label").count(), 0);
        await page.evaluate(() => document.getElementById("city").addEventListener("problem", ({ detail }) => (window.told = detail.kind)));
        await set("nonsense");
        await page.waitForFunction(() => window.told === "badTour");
        assert.equal(await page.locator("city-splat").getByRole("button", { name: "Play" }).count(), 0);
        assert.deepEqual(log, []);
        await close();
    });

// From the highest card down to the edge, of the picture's height; nothing of the page may lie over a card or a tool.
const COVERED_MOST = 0.28;
const LONG = "A caption as long as one may be. ".repeat(9).slice(0, 200);
const PHONES = { upright: SCREENS.phone, across: { ...SCREENS.phone, width: 844, height: 390 } };
for (const [name, screen] of Object.entries(PHONES))
    test(`on a phone the longest caption leaves the picture free, and so does a note: ${name}`, skip, async (t) => {
        const view = [SOUTH.lon, SOUTH.lat, SOUTH.h, SOUTH.heading, SOUTH.pitch].join();
        const { page, log, close } = await openPage(`${source.url}/#${view}&story=${packed([[[LONG, view, 0], [LONG, view, 0]], []])}`, screen);
        t.after(close);
        await waitForViewer(page);
        await page.waitForSelector("#tour-card:not([hidden])");
        const seen = () => page.evaluate(() => {
            const shown = [...document.querySelectorAll("#dock > .card, #tools, footer, #toast, .banner, #progress-text")]
                .filter((node) => node.checkVisibility() && node.getBoundingClientRect().height > 0)
                .filter((node, _, all) => !all.some((other) => other !== node && other.contains(node)))
                .map((node) => ({ what: node.id || node.localName, box: node.getBoundingClientRect() }));
            const over = shown.flatMap((a, i) => shown.slice(i + 1).filter(({ box: b }) =>
                a.box.left < b.right && a.box.right > b.left && a.box.top < b.bottom - 0.5 && a.box.bottom > b.top + 0.5).map((b) => `${a.what} over ${b.what}`));
            const cards = shown.filter(({ what }) => !["tools", "toast"].includes(what)).map(({ box }) => box.top);
            return { over, covered: 1 - Math.min(...cards) / innerHeight };
        });
        const check = async (what) => {
            const { over, covered } = await seen();
            t.diagnostic(`${what}: ${(100 * covered).toFixed(0)} % of the height`);
            assert.deepEqual(over, [], what);
            assert.ok(covered <= COVERED_MOST, `${what}: ${(100 * covered).toFixed(0)} % of the height is covered`);
        };
        await picture(page, `longest-${name}`);
        await check("the tour");
        // All of the caption can be read.
        const [all, room] = await page.$eval("#tour-caption", (node) => {
            node.scrollTop = 1e6;
            return [node.scrollHeight, node.scrollTop + node.clientHeight];
        });
        assert.ok(room >= all - 1, `${room} of ${all} px of the caption`);
        // A note is written in the place of the tour, and what is told does not lie over it.
        await page.evaluate(() => document.getElementById("note-add").click());
        await page.waitForSelector("#note:not([hidden])");
        await page.evaluate((p) => window.citysplat.look({ ...p, pitch: 60 }), SOUTH); // into the sky
        await page.tap("#note-middle");
        await page.waitForSelector("#toast:not([hidden])");
        await picture(page, `note-${name}`);
        await check("a note");
        await page.tap("#note-close");
        await page.tap("#tour-close");
        assert.ok(await page.isVisible("#tools"));
        assert.deepEqual(log, []);
    });

test("links that do harm open the view, and say what is wrong", skip, async () => {
    const hash = `#${placeOfEnu(ORIGIN, [0, -200, 160]).lon.toFixed(7)},52.498,240,20,-36`;
    const bad = {
        "not deflated": "abcdef",
        "no list": packed({ a: 1 }),
        "a view that is none": packed([[["x", "javascript:alert(1)", 3]], []]),
        "a note on no place": packed([[], [[900, 0, 0, "x"]]]),
        "a bomb": packed([[["x".repeat(1_000_000), "13.4,52.5,300,0,-30", 3]], []]),
    };
    const { page, log, close } = await openAt("desk");
    for (const [what, story] of Object.entries(bad)) {
        await page.goto("about:blank");
        await page.goto(`${source.url}/${hash}&story=${story}`);
        await waitForViewer(page);
        await page.waitForFunction(() => /cannot be read/.test(document.getElementById("toast").textContent), null, { timeout: 20000 }).catch(() => assert.fail(what));
        assert.ok(Math.abs((await headingOf(page)) - 20) < 0.05, what);
        await page.waitForFunction(() => !location.hash.includes("story"));
        assert.equal(await page.isVisible("#tour-card"), false, what);
    }
    assert.deepEqual(log, []);
    await close();
});

test("what a link carries is bounded, and comes back as it was", skip, async () => {
    const { LINK_MAX, makeNote, makeStop, packStory, parseStory, formatStory, unpackStory } = await importSource("story.ts");
    assert.equal(LINK_MAX, STORY_MAX);
    const views = [makeStop("One\u0000 \n two", "13.4,52.5,300,0,-30"), makeStop("x".repeat(999), "13.4,52.5,300,0,-30", 1e9)];
    assert.deepEqual([views[0].name, views[1].name.length, views[1].seconds], ["One two", 200, 60]);
    const story = { views, notes: [makeNote(13.4, 52.5, 80, "Straße 🚲 <b>")] };
    assert.deepEqual(await unpackStory(await packStory(story)), story);
    assert.deepEqual(parseStory(formatStory(story)), story);
    assert.equal(await packStory({ views: [], notes: [] }), "");
    let seed = 1;
    const noise = () => Array.from({ length: 200 }, () => String.fromCharCode(97 + ((seed = (seed * 48271) % 2147483647) % 26))).join("");
    const notes = Array.from({ length: 100 }, () => makeNote(13.4, 52.5, 80, noise()));
    assert.equal(await packStory({ views: [], notes }), null);
    for (const source of ["1", "null", "{}", '{"type":"citysplat-tour","views":3}']) assert.throws(() => parseStory(source));
});
