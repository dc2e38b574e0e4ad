// Wanders through a viewer for a long time and says what it held: fails where that passes its bounds or grows.
//
//   CITYSPLAT_BIN=build/release/citysplat node tests/web/wander.mjs [--seconds 1200] [--every 20] [--memory MB] [--seed N]
//
// Serves a small city under changing light, the test city, and 16 copies of it with more Gaussians than the limit of
// memory (4 MB) holds. A line a sample: MB of tiles as the viewer counts them, of the card's textures, of the page's
// heap after a collection, of the processes that hold page and card. Exit 0: within bounds; 1: not.
//
// SPDX-License-Identifier: Apache-2.0
import { existsSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import { missingBrowser, openPage, waitForViewer } from "./lib/browser.mjs";
import { manyCities } from "./lib/city.mjs";
import { openLitCity } from "./lib/source.mjs";
import { beyond, growthOf, wander } from "./lib/wander.mjs";

const { values } = parseArgs({
    options: {
        seconds: { type: "string", default: "1200" },
        every: { type: "string", default: "20" },
        memory: { type: "string", default: "4" },
        seed: { type: "string", default: "1" },
    },
});
const SIZE = { width: 400, height: 260 };
const COPIES = 4; // a side
const APART_M = 180;

const built = existsSync(fileURLToPath(new URL("../../web/dist/index.html", import.meta.url)));
const why =
    missingBrowser() || (built ? "" : "run `npm ci && npm run build` in web first") || (process.env.CITYSPLAT_BIN ? "" : "CITYSPLAT_BIN is not set: it names the citysplat program");
if (why) {
    console.log(`SKIP wander: ${why}`);
    process.exit(77);
}
const source = await openLitCity({ many: manyCities(COPIES, APART_M) });
const viewer = await openPage(`${source.url}/?memory=${values.memory}&lang=en`, SIZE);
let faults = [];
try {
    await waitForViewer(viewer.page, 600_000);
    const line = (at, one, steps) =>
        console.log(
            `${at.toFixed(0).padStart(5)} s  ${one.scene}  ${one.gaussians} Gaussians  tiles ${one.memoryMb.toFixed(2)}  card ${one.cardMb.toFixed(2)}  ` +
                `heap ${one.heapMb.toFixed(2)}  page ${one.rendererMb.toFixed(0)}  gpu ${one.gpuMb.toFixed(0)} MB  ` +
                `${one.textures} textures  ${one.nodes} nodes  ${one.listeners} listeners  ` +
                `${(one.received / 1e6).toFixed(1)} MB came  ${JSON.stringify(steps)}`,
        );
    const { samples } = await wander(viewer.page, {
        ...{ seconds: Number(values.seconds), every: Number(values.every), seed: Number(values.seed) },
        onSample: line,
    });
    faults = [...growthOf(samples), ...beyond(samples, Number(values.memory))];
    faults.push(...viewer.log);
} finally {
    await viewer.close();
    await source.close();
}
faults.forEach((text) => console.log(`FAILED ${text}`));
if (!faults.length) console.log("within bounds, and nothing grew");
process.exit(faults.length ? 1 : 0);
