// What the build of the module for other pages does: workers as text in it, whitespace out of it, the licences of what it
// holds beside it.
//
// SPDX-License-Identifier: Apache-2.0
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { buildSync, transformSync } from "esbuild";
import type { Plugin } from "vite";

const TARGET = "es2022";
const LICENCE = /^(licen[cs]e|copying|notice)(\.(md|txt))?$/i;

// The folder of the npm package that a source belongs to; null for our own.
function packageOf(source: string): string | null {
  const match = /^.*node_modules\/(?:@[^/]+\/)?[^/]+(?=\/)/.exec(source);
  return match ? match[0] : null;
}

// "*.worker.ts?text": the worker's whole script as a string, and the sources it was made of in `seen`.
export function inlineWorkers(seen: Set<string>): Plugin {
  const MARK = "\0worker-text:";
  return {
    name: "inline-workers",
    enforce: "pre",
    resolveId(source, importer) {
      if (source === "./workers" && importer) return join(dirname(importer), "workers.inline.ts");
      if (source.endsWith(".worker.ts?text") && importer)
        return MARK + join(dirname(importer), source.replace("?text", ""));
      return null;
    },
    load(id) {
      if (!id.startsWith(MARK)) return null;
      const { outputFiles, metafile } = buildSync({
        entryPoints: [id.slice(MARK.length)],
        bundle: true,
        minify: true,
        write: false,
        metafile: true,
        format: "iife",
        target: TARGET,
      });
      for (const input of Object.keys(metafile.inputs)) seen.add(join(process.cwd(), input));
      return `export default ${JSON.stringify(outputFiles[0]!.text)}`;
    },
  };
}

// Vite leaves whitespace in libraries, for bundlers that drop unused parts: this module is one part.
export function minifyWhole(version: string): Plugin {
  const banner = `/*! citysplat-viewer ${version}, Apache-2.0; LICENSES.txt lists what it holds of others */\n`;
  return {
    name: "minify-whole",
    apply: "build",
    generateBundle(_, bundle) {
      for (const file of Object.values(bundle))
        if (file.type === "chunk")
          file.code =
            banner + transformSync(file.code, { minify: true, target: TARGET, format: "esm", legalComments: "none" }).code;
    },
  };
}

// three.js' shaders are text, which no minifier touches: tabs at the beginning of lines are 1.3 kB of what is sent.
export function dropShaderIndent(): Plugin {
  return {
    name: "drop-shader-indent",
    apply: "build",
    generateBundle(_, bundle) {
      for (const file of Object.values(bundle)) if (file.type === "chunk") file.code = file.code.replace(/\n\t+/g, "\n");
    },
  };
}

function licenceOf(folder: string): string {
  const { name, version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8")) as Record<string, string>;
  const file = readdirSync(folder).find((one) => LICENCE.test(one));
  if (!file) throw new Error(`${name}: no licence in its package`);
  return `${name} ${version} (${license})\n\n${readFileSync(join(folder, file), "utf8").trim()}\n`;
}

// LICENSES.txt: our own licence, and that of every package of which something is in the module.
export function listLicences(seen: Set<string>, own: string): Plugin {
  return {
    name: "list-licences",
    apply: "build",
    generateBundle(_, bundle) {
      const sources = Object.values(bundle).flatMap((file) => (file.type === "chunk" ? Object.keys(file.modules) : []));
      const folders = [...sources, ...seen].map(packageOf).filter((one): one is string => one !== null && existsSync(one));
      const parts = [...new Set(folders)].sort().map(licenceOf);
      const ours = `citysplat-viewer (Apache-2.0)\n\n${readFileSync(own, "utf8").trim()}\n`;
      const source = [ours, ...parts].join(`\n${"-".repeat(78)}\n\n`);
      this.emitFile({ type: "asset", fileName: "LICENSES.txt", source });
    },
  };
}
