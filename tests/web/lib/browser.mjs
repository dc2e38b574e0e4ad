// Debian's Chromium, headless, drawing WebGL in software: what a page must be opened in here.
//
// SPDX-License-Identifier: Apache-2.0
import { existsSync } from "node:fs";

import { decodePng } from "./png.mjs";

const CHROMIUM = process.env.CHROMIUM ?? "/usr/bin/chromium";
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

// Why the browser tests cannot run, or "".
export function missingBrowser() {
    if (!existsSync(CHROMIUM))
        return `no browser at ${CHROMIUM} (apt-get install chromium, or set CHROMIUM)`;
    return "";
}

// Opens url in a fresh profile. { page, log, close }: log collects console errors and uncaught
// exceptions.
export async function openPage(url, { width = 800, height = 600 } = {}) {
    const { chromium } = await import("playwright-core");
    const browser = await chromium.launch({
        executablePath: CHROMIUM,
        headless: true,
        args: FLAGS,
    });
    const page = await browser.newPage({ viewport: { width, height }, deviceScaleFactor: 1 });
    const log = [];
    page.on("console", (m) => m.type() === "error" && log.push(m.text()));
    page.on("pageerror", (e) => log.push(`uncaught: ${e.message}`));
    page.on("requestfailed", (r) => log.push(`failed: ${r.url()} ${r.failure()?.errorText}`));
    try {
        await page.goto(url, { waitUntil: "load" });
    } catch (error) {
        await browser.close();
        throw new Error(`${url} does not open: ${error.message.split("\n")[0]}`);
    }
    return { page, log, close: () => browser.close() };
}

// Waits until the viewer has drawn everything its view needs. Throws with what it knows after the
// timeout.
export async function waitForViewer(page, timeoutMs = 120000) {
    const ready = () =>
        page.evaluate(() => window.citysplat?.ready === true || window.citysplat?.error != null);
    const until = Date.now() + timeoutMs;
    for (let seen = 0; seen < 2;) {
        if (Date.now() > until) {
            const state = await page.evaluate(() => JSON.stringify(window.citysplat ?? null));
            throw new Error(`viewer not settled after ${timeoutMs / 1000} s: ${state}`);
        }
        seen = (await ready()) ? seen + 1 : 0;
        await page.waitForTimeout(200);
    }
    const error = await page.evaluate(() => window.citysplat.error);
    if (error) throw new Error(`viewer: ${error}`);
}

// The viewer's page without its panels.
const HIDE_PANELS = "#panel,#tools,#compare,#toast,#progress,footer{display:none!important}";
export async function barePicture(page) {
    const style = await page.addStyleTag({ content: HIDE_PANELS });
    const png = decodePng(await page.screenshot());
    await style.evaluate((tag) => tag.remove());
    return png;
}

// The viewer's camera to a pose { lon, lat, h, heading, pitch, fov }; waits for the new picture.
export async function lookViewer(page, pose) {
    await page.evaluate((p) => window.citysplat.look(p), pose);
    await page.waitForTimeout(300);
    await waitForViewer(page);
}
