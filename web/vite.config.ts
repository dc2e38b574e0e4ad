// Builds of the browser client: the page and, from the same sources, the module for other pages
// (`vite build --mode module` -> dist/viewer.js). Relative URLs, everything bundled, nothing from a
// CDN. CesiumJS is copied beside its example page, only the parts that page fetches.
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

// Scripts, styles and workers of this page alone. Tiles may come from another server where the
// address names one.
const POLICY = [
  "default-src 'self'",
  "script-src 'self'",
  "style-src 'self'",
  "img-src 'self' blob: data:",
  "worker-src 'self' blob:",
  "connect-src 'self' https: http:",
  "object-src 'none'",
  "base-uri 'self'",
].join("; ");

// Only in what is built: the development server injects scripts and styles.
function addPolicy(): Plugin {
  return {
    name: "add-policy",
    apply: "build",
    transformIndexHtml: () => [
      {
        tag: "meta",
        attrs: { "http-equiv": "Content-Security-Policy", content: POLICY },
        injectTo: "head-prepend",
      },
    ],
  };
}

// `npm run dev` forwards the data to a running `citysplat serve`.
const server = process.env["CITYSPLAT_SERVER"] ?? "http://127.0.0.1:8080";

export default defineConfig(({ mode }) => ({
  base: "./",
  plugins: mode === "module" ? [] : [copyCesium(), addPolicy()],
  publicDir: mode === "module" ? false : "public",
  build: {
    target: "es2022",
    sourcemap: false,
    ...(mode === "module"
      ? {
          emptyOutDir: false,
          lib: { entry: "src/viewer.ts", formats: ["es" as const], fileName: () => "viewer.js" },
        }
      : { chunkSizeWarningLimit: 1500 }),
  },
  worker: { format: "es" },
  server: { proxy: { "/collections": server, "/d/": server } },
}));
