// A picture of a viewer page, taken when its splats are complete and sorted.
//
//   node tests/web/shot.mjs URL OUT.png [--width 1280] [--height 720] [--wait SECONDS] [--bare] [--click ID]...
//
// --wait: longest time to wait for the tiles (120). --bare: hide panels. --click: press a button of
// the page first.
//
// SPDX-License-Identifier: Apache-2.0
import { parseArgs } from "node:util";

import { openPage, waitForViewer } from "./lib/browser.mjs";

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        width: { type: "string", default: "1280" },
        height: { type: "string", default: "720" },
        wait: { type: "string", default: "120" },
        bare: { type: "boolean", default: false },
        click: { type: "string", multiple: true, default: [] },
    },
});
const [url, out] = positionals;
if (!url || !out) {
    console.error(
        "usage: node shot.mjs URL OUT.png [--width W] [--height H] [--wait S] [--bare] [--click ID]",
    );
    process.exit(2);
}

const size = { width: Number(values.width), height: Number(values.height) };
const { page, log, close } = await openPage(url, size).catch((error) => {
    console.error(error.message);
    process.exit(1);
});
try {
    await waitForViewer(page, 1000 * Number(values.wait));
    for (const id of values.click)
        await page.evaluate((name) => document.getElementById(name).click(), id);
    if (values.click.includes("server-button"))
        await page.waitForSelector("#server-image.fresh", { timeout: 60000 });
    if (values.bare)
        await page.evaluate(() => void (document.documentElement.dataset.ui = "off"));
    await page.screenshot({ path: out });
    const state = await page.evaluate(() => window.citysplat.state);
    const { gaussians, tiles: tilesLoaded, bytes } = state;
    console.log(
        `${out}: ${gaussians} Gaussians in ${tilesLoaded} tiles, ${(bytes / 1e6).toFixed(2)} MB received`,
    );
} catch (error) {
    await page.screenshot({ path: out });
    console.error(`${error.message}\n${log.join("\n")}\nthe page as it is: ${out}`);
    process.exitCode = 1;
} finally {
    await close();
}
