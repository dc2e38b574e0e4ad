// Builds of the browser client: the page, the page of `citysplat mark` (`vite build --mode mark` -> dist/mark.html), the module for other pages (`vite build --mode module` -> dist/viewer.js) and
// its layer for maps alone (`vite build --mode map` -> dist/map.js). Relative URLs,
// everything bundled, nothing from a CDN.
//
// SPDX-License-Identifier: Apache-2.0
import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { buildSync } from "esbuild";
import { defineConfig, type Plugin } from "vite";

import { dropShaderIndent, inlineWorkers, listLicences, minifyWhole } from "./build";

// For examples/maplibre.html.
const MAPLIBRE_PARTS = ["maplibre-gl.mjs", "maplibre-gl-worker.mjs", "maplibre-gl.css"];

// Files of an npm package into a folder of dist/.
function copyParts(name: string, below: string, parts: string[], folder: string): Plugin {
  let out = "";
  return {
    name: `copy-${folder}`,
    apply: "build",
    configResolved: (config) => void (out = join(config.root, config.build.outDir, folder)),
    closeBundle() {
      const from = join(
        dirname(createRequire(import.meta.url).resolve(`${name}/package.json`)),
        below,
      );
      for (const part of parts) {
        mkdirSync(dirname(join(out, part)), { recursive: true });
        cpSync(join(from, part), join(out, part), { recursive: true });
      }
    },
  };
}

// Draco's decoder is text that three.js' loader makes a worker of, when the first mesh needs it. Beside
// the scripts, and neither in them nor as WebAssembly, which the page's policy does not allow.
function copyDraco(): Plugin {
  let out = "";
  return {
    name: "copy-draco",
    apply: "build",
    configResolved: (config) => void (out = join(config.root, config.build.outDir, "assets")),
    transform: (code, id) =>
      /DRACOLoader\.js$/.test(id)
        ? code.replace(/new URL\( '[^']*', import\.meta\.url \)\.toString\(\)/g, "''")
        : null,
    closeBundle() {
      const three = dirname(createRequire(import.meta.url).resolve("three")); // its build/
      mkdirSync(out, { recursive: true });
      const name = "draco_decoder.js";
      cpSync(join(three, "../examples/jsm/libs/draco", name), join(out, name));
    },
  };
}

// 3d-tiles-renderer reads glTF by three.js' loader where nobody else says that he does. Tiles of the city
// are read by workers, models of others by src/models.ts with a loader of its own, so the page does
// without until there are such.
function leaveOutGltf(): Plugin {
  return {
    name: "leave-out-gltf",
    apply: "build",
    enforce: "pre",
    resolveId: (source, importer) =>
      source.endsWith("loaders/GLTFLoader.js") && importer?.includes("3d-tiles-renderer")
        ? "\0no-gltf"
        : null,
    load: (id) => (id === "\0no-gltf" ? "export class GLTFLoader {}" : null),
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
];
// Only in what is built: the development server injects scripts and styles.
function addPolicy(): Plugin {
  return {
    name: "add-policy",
    apply: "build",
    transformIndexHtml: () => [
      {
        tag: "meta",
        attrs: { "http-equiv": "Content-Security-Policy", content: POLICY.join("; ") },
        injectTo: "head-prepend",
      },
    ],
  };
}

// A script of its own before all others (src/first.ts), behind the styles that it asks. The server writes into its tag.
function addFirst(): Plugin {
  const { outputFiles } = buildSync({ entryPoints: ["src/first.ts"], bundle: true, minify: true, write: false, format: "iife", target: "es2022", legalComments: "none" });
  const source = outputFiles[0]!.contents;
  const fileName = `assets/first-${createHash("sha256").update(source).digest("hex").slice(0, 8)}.js`;
  return {
    name: "add-first",
    apply: "build",
    generateBundle() {
      this.emitFile({ type: "asset", fileName, source });
    },
    transformIndexHtml: {
      order: "post",
      handler: (html) => html.replace(/<link rel="stylesheet"[^>]*>/, `$&\n    <script data-first src="./${fileName}"></script>`),
    },
  };
}

// The page's lines without what they are indented by. It has no <pre>.
function dropIndent(): Plugin {
  return {
    name: "drop-indent",
    apply: "build",
    transformIndexHtml: { order: "post", handler: (html) => html.replace(/\n\s+/g, "\n") },
  };
}

// `npm run dev` forwards the data to a running `citysplat serve`.
const server = process.env["CITYSPLAT_SERVER"] ?? "http://127.0.0.1:8080";

const { version } = JSON.parse(readFileSync(new URL("package.json", import.meta.url), "utf8")) as {
  version: string;
};
const inWorkers = new Set<string>(); // sources of the module's workers

// Modes: the page alone, which empties the folder first; "mark", mark.html with nothing in common with the
// page, so that it loads none of it; "module", for other pages.
const builds = {
  page: { plugins: [leaveOutGltf(), copyDraco(), dropShaderIndent(), addFirst(), addPolicy(), dropIndent()], build: { chunkSizeWarningLimit: 1500 } },
  mark: {
    plugins: [addPolicy(), dropIndent()],
    build: { emptyOutDir: false, rollupOptions: { input: "mark.html" } },
  },
  module: {
    plugins: [
      leaveOutGltf(),
      copyDraco(),
      copyParts("maplibre-gl", "dist", MAPLIBRE_PARTS, "maplibre"),
      inlineWorkers(inWorkers),
      minifyWhole(version),
      dropShaderIndent(),
      listLicences(inWorkers, "../LICENSE"),
    ],
    build: {
      emptyOutDir: false,
      rollupOptions: { output: { inlineDynamicImports: true } }, // all of it in viewer.js
      lib: { entry: "src/module.ts", formats: ["es" as const], fileName: () => "viewer.js" },
    },
  },
  // The layer for MapLibre alone; what LICENSES.txt lists of the module holds for it.
  map: {
    plugins: [leaveOutGltf(), inlineWorkers(new Set()), minifyWhole(version)],
    build: {
      emptyOutDir: false,
      rollupOptions: { output: { inlineDynamicImports: true } },
      lib: { entry: "src/mapmodule.ts", formats: ["es" as const], fileName: () => "map.js" },
    },
  },
};

export default defineConfig(({ mode }) => {
  const { plugins, build } = builds[mode in builds ? (mode as keyof typeof builds) : "page"];
  return {
    base: "./",
    define: {
      __VERSION__: JSON.stringify(version),
      __ASSETS__: JSON.stringify(["module", "map"].includes(mode) ? "./assets/" : "./"), // from the script that needs them
    },
    plugins,
    publicDir: ["mark", "module", "map"].includes(mode) ? false : "public",
    build: { target: "es2022", sourcemap: false, ...build },
    worker: { format: "es" },
    server: { proxy: { "/collections": server, "/d/": server } },
  };
});
