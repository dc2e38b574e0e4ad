// ArcGIS draws the test city, as the recipe of docs/clients.md says: SSIM to the server's picture, and whom it asked besides.
//
//   npm install --no-save --prefix DIR @arcgis/core@5.1.25
//   CITYSPLAT_BIN=build/release/citysplat node lab/web/arcgis.mjs DIR/node_modules [--shot picture.png] [--lower 39.6]
//
// --lower: metres from the heights of the tileset, which are above the ellipsoid, to those in which ArcGIS places a camera.
// The package has 390 MB and a licence of its own, so it is not among those of the tests: this prints, and is no test.
//
// SPDX-License-Identifier: Apache-2.0
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, normalize, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import { openPage, useWholeBrowser } from "../../tests/web/lib/browser.mjs";
import { SOUTH } from "../../tests/web/lib/checks.mjs";
import { serveFiles } from "../../tests/web/lib/files.mjs";
import { decodePng } from "../../tests/web/lib/png.mjs";
import { snippets } from "../../tests/web/lib/snippets.mjs";
import { firstDataSet, getBytes, openSource } from "../../tests/web/lib/source.mjs";
import { ssim } from "../../tests/web/lib/ssim.mjs";

const { values, positionals } = parseArgs({ allowPositionals: true, options: { shot: { type: "string" }, lower: { type: "string", default: "0" } } });
const [modules] = positionals;
if (!modules) {
    console.error("usage: CITYSPLAT_BIN=... node arcgis.mjs NODE_MODULES [--shot picture.png] [--lower METRES]");
    process.exit(2);
}
useWholeBrowser();
const HERE = dirname(fileURLToPath(import.meta.url));
const SIZE = { width: 640, height: 480 };
const TIMEOUT_MS = 240_000;

const source = await openSource({ antialiased: true });
const ds = await firstDataSet(source.url);
const dir = mkdtempSync(join(tmpdir(), "citysplat-arcgis-"));
const other = await serveFiles((path) => join(path.startsWith("/assets/") ? resolve(modules, "@arcgis/core") : dir, normalize(path)));
const { lon, lat, h, heading, pitch, fov } = SOUTH;
const tan = Math.tan((fov * Math.PI) / 360) * Math.hypot(1, SIZE.width / SIZE.height);
const words = { host: source.url, ds, eye_lon: lon, eye_lat: lat, eye_h: h - Number(values.lower), heading, pitch };
const [recipe] = snippets("clients.md", "## ArcGIS", "js");
const script = `${recipe.replace(/\{(\w+)\}/g, (word, name) => words[name] ?? word)}
view.ui.components = [];
view.when(() => {
    view.camera = Object.assign(view.camera.clone(), { fov: ${(2 * Math.atan(tan) * 180) / Math.PI} }); // of the diagonal
    return view.whenLayerView(layer);
}).then((one) => Object.assign(window, { view, layerView: one }), (error) => (window.failed = String(error)));
`;
try {
    const { buildSync } = createRequire(join(HERE, "../../web/package.json"))("esbuild");
    const loader = { ".wasm": "file", ".glsl": "text" };
    buildSync({ stdin: { contents: script, resolveDir: resolve(modules) }, nodePaths: [resolve(modules)], bundle: true, splitting: true, format: "esm", logLevel: "error", outdir: dir, entryNames: "city", loader });
    writeFileSync(join(dir, "index.html"), '<!doctype html><link rel="icon" href="data:,"><style>html,body,#city{margin:0;height:100%;background:#000}.esri-attribution{display:none!important}</style><link rel="stylesheet" href="/assets/esri/themes/dark/main.css"><div id="city"></div><script type="module" src="city.js"></script>');
    const { page, log, close } = await openPage("about:blank", SIZE);
    const asked = new Set();
    page.on("request", (request) => /^http/.test(request.url()) && asked.add(new URL(request.url()).origin));
    await page.goto(`${other.url}/index.html`);
    await page.waitForFunction(() => window.failed || (window.layerView && !window.layerView.updating && !window.view.updating), null, { timeout: TIMEOUT_MS, polling: 500 }).catch((error) => console.log(error.message.split("\n")[0]));
    await page.waitForTimeout(3000);
    const bytes = await page.screenshot({ timeout: TIMEOUT_MS, ...(values.shot && { path: values.shot }) });
    console.log("failed:", await page.evaluate(() => window.failed ?? null), "console:", log.slice(0, 5));
    const place = `${lon.toFixed(9)},${lat.toFixed(9)},${h.toFixed(4)}@${heading},${pitch},${fov}`;
    const want = decodePng(await getBytes(`${source.url}/d/${ds}/static/${place}/${SIZE.width}x${SIZE.height}.png`));
    const { covered, share } = ssim(decodePng(bytes), want);
    console.log(`SSIM ${covered.toFixed(3)} over ${(100 * share).toFixed(0)} % of the picture; asked ${[...asked].map((one) => (one === source.url ? "the server" : one === other.url ? "the page's host" : one)).join(", ")}`);
    await close();
} finally {
    other.close();
    rmSync(dir, { recursive: true, force: true });
    await source.close();
}
