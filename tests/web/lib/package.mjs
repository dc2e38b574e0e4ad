// The npm package of the viewer, as somebody gets it: packed, and installed in a folder without anything else.
//
// SPDX-License-Identifier: Apache-2.0
import { execFileSync } from "node:child_process";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { writeFileSync } from "node:fs";

const WEB = fileURLToPath(new URL("../../../web/", import.meta.url));

const npm = (cwd, ...args) => execFileSync("npm", args, { cwd, encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });

// Packs it into dir and installs it there. Resolves with what `npm pack` says of it, and its folder.
export function installPackage(dir) {
    const [packed] = JSON.parse(npm(WEB, "pack", "--json", "--ignore-scripts", "--pack-destination", dir));
    writeFileSync(join(dir, "package.json"), '{ "type": "module", "private": true }');
    npm(dir, "install", "--offline", "--no-audit", "--no-fund", "--ignore-scripts", `./${packed.filename}`);
    return { packed, folder: join(dir, "node_modules/citysplat-viewer") };
}
