// Makes dist/types/ of src/: what a page can reach from the entries, with the words of our comments. Sources have line
// comments, which the compiler drops from declarations; here they become documentation before it reads them. It fails where
// a declaration that a page sees has no words, and where one names a package: the module needs none to be compiled against.
//
// SPDX-License-Identifier: Apache-2.0
import { cpSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import ts from "typescript";

const here = (path) => new URL(path, import.meta.url).pathname;
const [SRC, COPY, TYPES] = ["./src/", "./dist/types-of/", "./dist/types/"].map(here);
const ENTRIES = ["module", "mapmodule"];

// ---- comments to documentation ----

// Lines of // above a declaration, and one behind a member.
function document(text) {
  const out = [];
  let words = [];
  for (const line of text.split("\n")) {
    const own = /^(\s*)\/\/ ?(.*)$/.exec(line);
    if (own && !/^ ?(eslint|@ts-)/.test(own[2])) {
      words.push(own);
      continue;
    }
    const [, indent = ""] = words[0] ?? [];
    const above = words.map(([, , one]) => one).join(`\n${indent} * `);
    if (words.some(([, , one]) => one.startsWith("SPDX"))) out.push(...words.map(([whole]) => whole)); // of the file
    else if (words.length) out.push(line.trim() ? `${indent}/** ${above} */` : `${indent}// ${above.replace(/\n\s*\* /g, " ")}`);
    words = [];
    const behind = /^(\s*)((?:readonly |static |abstract )*[\w"$]+\??(?:<[^>]*>)?(?::|\().*[;{]|(?:export )?type \w+ = .*;)\s*\/\/ (.*)$/.exec(line);
    if (behind) out.push(`${behind[1]}/** ${behind[3]} */`, behind[1] + behind[2]);
    else out.push(line);
  }
  return out.join("\n");
}

rmSync(COPY, { recursive: true, force: true });
rmSync(TYPES, { recursive: true, force: true });
mkdirSync(COPY, { recursive: true });
for (const name of readdirSync(SRC)) if (name.endsWith(".ts")) writeFileSync(join(COPY, name), document(readFileSync(join(SRC, name), "utf8")));

// ---- declarations ----

const { config } = ts.readConfigFile(here("./tsconfig.module.json"), ts.sys.readFile);
const { options } = ts.parseJsonConfigFileContent(config, ts.sys, here("./"));
const roots = [...ENTRIES, "build.d", "modules.d"].map((name) => join(COPY, `${name}.ts`));
const program = ts.createProgram(roots, { ...options, rootDir: COPY, outDir: TYPES });
const { diagnostics } = program.emit();
if (diagnostics.length) throw new Error(ts.formatDiagnostics(diagnostics, { getCanonicalFileName: (f) => f, getCurrentDirectory: () => "", getNewLine: () => "\n" }));
rmSync(COPY, { recursive: true });

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
for (const entry of ENTRIES) follow(`${entry}.d.ts`);
for (const name of readdirSync(TYPES)) if (!left.has(name)) rmSync(join(TYPES, name));
cpSync(here("./react.d.ts"), join(TYPES, "react.d.ts"));

// ---- words for all ----

const reader = ts.createProgram(ENTRIES.map((entry) => join(TYPES, `${entry}.d.ts`)), { ...options, noEmit: true });
const checker = reader.getTypeChecker();
const lacking = new Set();
const seen = new Set();
const isSeen = (node) => !(ts.getCombinedModifierFlags(node) & ts.ModifierFlags.Private) && !ts.isConstructorDeclaration(node);

function look(name, symbol, inner = false) {
  const of = symbol.flags & ts.SymbolFlags.Alias ? checker.getAliasedSymbol(symbol) : symbol;
  if (seen.has(of)) return;
  seen.add(of);
  const words = of.getDocumentationComment(checker).length > 0;
  if (!words) lacking.add(name);
  for (const node of inner ? [] : (of.declarations ?? [])) {
    const members = node.members ?? node.type?.members ?? [];
    for (const member of members) {
      if (!member.name || !isSeen(member)) continue;
      const symbolOf = checker.getSymbolAtLocation(member.name);
      if (symbolOf) look(`${name}.${member.name.getText()}`, symbolOf, true);
    }
  }
}
for (const entry of ENTRIES) {
  const file = checker.getSymbolAtLocation(reader.getSourceFile(join(TYPES, `${entry}.d.ts`)));
  for (const symbol of checker.getExportsOfModule(file)) look(symbol.name, symbol);
}
if (lacking.size) throw new Error(`declarations without words: write a comment above ${[...lacking].join(", ")}`);
