// Build of the browser client: relative URLs, everything bundled, nothing from a CDN. CesiumJS is
// copied beside the example page, only the parts that page fetches.
//
// SPDX-License-Identifier: Apache-2.0
import { cpSync, mkdirSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { defineConfig, type Plugin } from "vite";

const CESIUM_PARTS = [
  "Cesium.js",
  "Workers",
  "Widgets/CesiumWidget/CesiumWidget.css",
  "ThirdParty/wasm_splats_bg.wasm",
  "Assets/approximateTerrainHeights.json",
  "Assets/IAU2006_XYS",
  "Assets/Images/ion-credit.png",
];

function copyCesium(): Plugin {
  let out = "";
  return {
    name: "copy-cesium",
    apply: "build",
    configResolved: (config) => void (out = join(config.root, config.build.outDir, "cesium")),
    closeBundle() {
      const from = join(
        dirname(createRequire(import.meta.url).resolve("cesium/package.json")),
        "Build/Cesium",
      );
      for (const part of CESIUM_PARTS) {
        mkdirSync(dirname(join(out, part)), { recursive: true });
        cpSync(join(from, part), join(out, part), { recursive: true });
      }
    },
  };
}

// `npm run dev` forwards the data to a running `citysplat serve`.
const server = process.env["CITYSPLAT_SERVER"] ?? "http://127.0.0.1:8080";

export default defineConfig({
  base: "./",
  plugins: [copyCesium()],
  build: { target: "es2022", chunkSizeWarningLimit: 8000, sourcemap: false },
  worker: { format: "es" },
  server: { proxy: { "/collections": server, "/d/": server } },
});
