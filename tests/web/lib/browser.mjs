// Debian's Chromium, headless, drawing WebGL in software: what a page must be opened in here.
//
// SPDX-License-Identifier: Apache-2.0
import { existsSync } from "node:fs";
import { after } from "node:test";

import { decodePng } from "./png.mjs";

// The shell is the same engine without the windows around it: a third less of the processor's time.
const BROWSERS = ["/usr/bin/chromium-headless-shell", "/usr/bin/chromium"];
let chromiumPath = process.env.CHROMIUM ?? BROWSERS.find(existsSync) ?? BROWSERS[1];
const FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
];
// The canvas is laid into its page without GL: a quarter less for a page that rests, and twice as much for one that draws
// without end.
let flags = [...FLAGS, "--disable-gpu-compositing"];

// For pages of others, which draw without end: the shell's pictures of them take minutes or never come. Before the first
// page.
export function useWholeBrowser() {
    if (!process.env.CHROMIUM) chromiumPath = BROWSERS[1];
    flags = FLAGS;
}

// Why the browser tests cannot run, or "".
export function missingBrowser() {
    if (!existsSync(chromiumPath))
        return `no browser at ${chromiumPath} (apt-get install chromium, or set CHROMIUM)`;
    return "";
}

const CALM_FRAMES = 6;
const PATIENCE_MS = 120_000; // of each step: a busy machine takes long, and that is no fault of a page
let waits = 0;
let shared = null; // one browser for all pages: its start and the drivers' first picture take seconds
let users = 0;
const testing = Boolean(process.env.NODE_TEST_CONTEXT); // of a file of tests; else of a tool

async function takeBrowser() {
    const { chromium } = await import("playwright-core");
    users++;
    shared ??= chromium.launch({ executablePath: chromiumPath, headless: true, args: flags });
    return shared;
}

async function leaveBrowser() {
    if (--users > 0 || testing) return;
    await endBrowser();
}

async function endBrowser() {
    const browser = await shared;
    shared = null;
    await browser?.close();
}

// Of a file of tests the browser goes with the last test.
if (testing) after(endBrowser);

// Opens url in a fresh profile. { page, log, close }: log collects console errors and uncaught
// exceptions, and failed requests. init: a function that runs in the page before its scripts.
export async function openPage(url, { width = 800, height = 600, init = null, ...more } = {}) {
    const browser = await takeBrowser();
    const context = await browser.newContext({
        viewport: { width, height },
        deviceScaleFactor: 1,
        ...more,
    });
    context.setDefaultTimeout(PATIENCE_MS);
    const page = await context.newPage();
    if (init) await page.addInitScript(init);
    const close = async () => {
        if (shared) await context.close(); // else it went with the browser
        await leaveBrowser();
    };
    const log = [];
    page.on("console", (m) => m.type() === "error" && log.push(m.text()));
    page.on("pageerror", (e) => log.push(`uncaught: ${e.message}`));
    // The page takes back what it no longer needs, and asks again where a busy server is silent.
    page.on("requestfailed", (r) => {
        const why = r.failure()?.errorText;
        if (why !== "net::ERR_ABORTED") log.push(`failed: ${r.url()} ${why}`);
    });
    try {
        await page.goto(url, { waitUntil: "load" });
    } catch (error) {
        await close();
        throw new Error(`${url} does not open: ${error.message.split("\n")[0]}`);
    }
    return { page, log, close };
}

// Waits until the viewer has drawn everything its view needs, and means it: for some frames on end.
// Throws with what it knows after the timeout.
export async function waitForViewer(page, timeoutMs = 120000) {
    const token = ++waits; // what was ready before is not counted
    try {
        await page.waitForFunction(
            ([token, frames]) => {
                const own = window.citysplat;
                const ready = own?.ready === true || own?.error != null;
                if (window.waitedFor?.token !== token) window.waitedFor = { token, frames: 0 };
                window.waitedFor.frames = ready ? window.waitedFor.frames + 1 : 0;
                return window.waitedFor.frames >= frames;
            },
            [token, CALM_FRAMES],
            { timeout: timeoutMs, polling: "raf" },
        );
    } catch (error) {
        const state = await page.evaluate(() => JSON.stringify(window.citysplat?.state ?? null));
        throw new Error(`viewer not settled after ${timeoutMs / 1000} s: ${state}`, { cause: error });
    }
    const error = await page.evaluate(() => window.citysplat.error);
    if (error) throw new Error(`viewer: ${error}`);
}

// Two frames: whatever an event changed at once is on the screen.
export function nextFrames(page) {
    return page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
}

// The viewer's picture alone: no panels, and black instead of sky and ground, as the server draws. As PNG.
export async function bareBytes(page) {
    const bare = (on) =>
        page.evaluate(async (off) => {
            const { viewer } = window.citysplat;
            document.documentElement.dataset.ui = off ? "off" : "on";
            await new Promise((drawn) => {
                const end = viewer.on("frame", () => (end(), drawn()));
                viewer.backdrop = !off; // asks for a frame
            });
            await new Promise(requestAnimationFrame);
        }, on);
    await bare(true);
    const png = await page.screenshot();
    await bare(false);
    return png;
}

export async function barePicture(page) {
    return decodePng(await bareBytes(page));
}

// The viewer at url, when all that its view wants is drawn: that of `pose`, if there is one. As openPage.
export async function openViewer(url, size, pose) {
    const viewer = await openPage(url, size);
    await waitForViewer(viewer.page);
    if (pose) await lookViewer(viewer.page, pose);
    return viewer;
}

// What tests have opened; undefined where they were skipped.
export async function closeAll(...opened) {
    for (const one of opened) await one?.close();
}

// As if a person had set the control.
export function setControl(page, id, value) {
    return page.evaluate(
        ([name, v]) => {
            const control = document.getElementById(name);
            control.value = v;
            control.dispatchEvent(new Event(control.type === "range" ? "input" : "change"));
        },
        [id, value],
    );
}

// The viewer's camera to a pose { lon, lat, h, heading, pitch, fov }; waits for the new picture.
export async function lookViewer(page, pose) {
    await page.evaluate((p) => window.citysplat.look(p), pose);
    await waitForViewer(page);
}
