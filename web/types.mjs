// Removes what no page can reach from dist/types/, and fails where a declaration that is left names a package: the
// module needs none to be compiled against. Imports get the ending that Node.js' own resolution wants.
//
// SPDX-License-Identifier: Apache-2.0
import { readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const TYPES = new URL("./dist/types/", import.meta.url).pathname;
const left = new Set();

function follow(name) {
  if (left.has(name)) return;
  left.add(name);
  const text = readFileSync(join(TYPES, name), "utf8");
  for (const [, from] of text.matchAll(/(?:from|import\()\s*"([^"]+)"/g)) {
    if (!from.startsWith("./")) throw new Error(`dist/types/${name} needs the package ${from}`);
    follow(`${from.slice(2)}.d.ts`);
  }
  writeFileSync(join(TYPES, name), text.replace(/((?:from|import\()\s*"\.\/\w+)"/g, '$1.js"'));
}

follow("module.d.ts");
for (const name of readdirSync(TYPES)) if (!left.has(name)) rmSync(join(TYPES, name));
