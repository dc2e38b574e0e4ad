// Modules of the viewer's sources for Node.js, by the bundler that web/ has.
//
// SPDX-License-Identifier: Apache-2.0
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const WEB = fileURLToPath(new URL("../../../web/", import.meta.url));

// web/src/`name` with all that it imports.
export async function importSource(name) {
    const { buildSync } = createRequire(`${WEB}package.json`)("esbuild");
    const [built] = buildSync({
        entryPoints: [`${WEB}src/${name}`],
        bundle: true,
        format: "esm",
        write: false,
        target: "es2022",
    }).outputFiles;
    return import(`data:text/javascript;base64,${Buffer.from(built.text).toString("base64")}`);
}
