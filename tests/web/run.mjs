// Runs tests of this folder and says clearly when they cannot run.
//
//   node tests/web/run.mjs [NAME ...] [--tiles STORE] [--mock]
//
// CITYSPLAT_BIN names the program (not needed with --mock). --tiles runs against a given store:
// what only holds for the test city is skipped. Exit 0: passed; 1: failed; 77: something needed is
// missing (CTest's "skipped").
//
// SPDX-License-Identifier: Apache-2.0
import { spawnSync } from "node:child_process";
import { existsSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

const HERE = dirname(fileURLToPath(import.meta.url));
const BROWSER_TESTS = new Set(
    [
        ...["viewer", "ssim", "appearance", "away", "thin", "map", "embed", "layers", "shot", "module", "reach", "habits", "compare", "tasks", "fade", "wander", "mark", "visit"],
        ...["cesium", "engines", "recipes", "forms", "light", "three", "raster", "parts", "maplibre"],
    ],
);
const TESTS = ["api", "views", "decoder", "source", "pick", "walk", "pmtiles", "validate", "readers", "las", "writers", "seed", "ground", "tools", ...BROWSER_TESTS];
const SKIP = 77;

const { values, positionals } = parseArgs({
    allowPositionals: true,
    options: { tiles: { type: "string" }, mock: { type: "boolean", default: false } },
});
const wanted = positionals.length ? positionals : TESTS;
const unknown = wanted.find((name) => !TESTS.includes(name));
if (unknown) {
    console.error(`no test "${unknown}": choose from ${TESTS.join(", ")}`);
    process.exit(2);
}
const env = { ...process.env };
if (values.tiles) env.CITYSPLAT_TILES = resolve(values.tiles);
if (values.mock) env.CITYSPLAT_MOCK = "1";

async function findMissing() {
    if (Number(process.versions.node.split(".")[0]) < 20)
        return `Node.js ${process.versions.node} is older than 20`;
    if (!existsSync(join(HERE, "node_modules"))) return "run `npm ci` in tests/web first";
    if (!existsSync(join(HERE, "../../web/dist/index.html")))
        return "run `npm ci && npm run build` in web first";
    if (!env.CITYSPLAT_MOCK && !env.CITYSPLAT_BIN)
        return "CITYSPLAT_BIN is not set: it names the citysplat program";
    const { missingBrowser } = await import("./lib/browser.mjs");
    return wanted.some((name) => BROWSER_TESTS.has(name)) ? missingBrowser() : "";
}

const missing = await findMissing();
if (missing) {
    console.log(`SKIP ${wanted.join(", ")}: ${missing}`);
    process.exit(SKIP);
}
const files = wanted.map((name) => join(HERE, `${name}.test.mjs`));
const args = ["--test", "--test-concurrency=1", "--test-reporter=spec", ...files];
const run = spawnSync(process.execPath, args, { stdio: "inherit", env });
process.exit(run.status ?? 1);
