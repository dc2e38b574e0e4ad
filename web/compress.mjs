// Leaves x.js.br and x.js.gz beside the scripts and styles of dist/. citysplat's server sends the
// brotli form; other file servers (nginx: brotli_static, gzip_static) take either. index.html is for
// people to change, so it gets none: a server compresses it when it reads it.
//
// SPDX-License-Identifier: Apache-2.0
import { readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { promisify } from "node:util";
import { brotliCompress, constants, gzip } from "node:zlib";

const DIST = new URL("./dist/", import.meta.url).pathname;
const TEXT = /\.(js|mjs|css|svg|json)$/;
const LEAST = 1024; // bytes: smaller files fit into one packet anyway
const SLOW = 2 << 20; // from here on the last percents would take many seconds

async function compress(file) {
  const bytes = readFileSync(file);
  if (bytes.length < LEAST) return;
  const quality = bytes.length < SLOW ? constants.BROTLI_MAX_QUALITY : 9;
  const params = {
    [constants.BROTLI_PARAM_QUALITY]: quality,
    [constants.BROTLI_PARAM_MODE]: constants.BROTLI_MODE_TEXT,
    [constants.BROTLI_PARAM_SIZE_HINT]: bytes.length,
  };
  const br = promisify(brotliCompress)(bytes, { params }); // both in threads of their own
  writeFileSync(`${file}.gz`, await promisify(gzip)(bytes, { level: 9 }));
  writeFileSync(`${file}.br`, await br);
}

const files = [];
for (const name of readdirSync(DIST, { recursive: true })) {
  const file = join(DIST, name);
  if (/\.(br|gz)$/.test(name)) rmSync(file);
  else if (TEXT.test(name) && statSync(file).isFile()) files.push(file);
}
await Promise.all(files.map(compress));
