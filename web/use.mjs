// Makes dist/use.html of docs/clients.md: the page that a server shows at /d/NAME/use, where it fills the words in braces
// (server/documents/use_page.c). A recipe that is the body of a page stands there as a whole page. Packages get the versions
// that the recipes are tested with. The page has no script and loads nothing.
//
// SPDX-License-Identifier: Apache-2.0
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";

const at = (path) => new URL(path, import.meta.url);
const json = (path) => JSON.parse(readFileSync(at(path), "utf8"));
const locked = { ...json("../tests/web/package-lock.json").packages, ...json("package-lock.json").packages };
const text = readFileSync(at("../docs/clients.md"), "utf8");

const escape = (s) => s.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;").replace(/"/g, "&quot;");
const anchor = (heading) => heading.toLowerCase().replace(/[^\w -]/g, "").replace(/ /g, "-");

// Links to other documents are words here: they lie beside the program, not on the server.
const inline = (s) =>
  escape(s)
    .replace(/`([^`]+)`/g, "<code>$1</code>")
    .replace(/!\[[^\]]*\]\([^)]*\)/g, "")
    .replace(/\[([^\]]+)\]\((#[^)]+|https?:[^)]+)\)/g, '<a href="$2">$1</a>')
    .replace(/\[([^\]]+)\]\([^)]*\)/g, "$1")
    .replace(/\*([^*]+)\*/g, "<em>$1</em>");

function versioned(code) {
  return code.replace(/\{npm\}\/((?:@[\w.-]+\/)?[\w.-]+)\//g, (_, name) => {
    const { version } = locked[`node_modules/${name}`] ?? {};
    if (!version) throw new Error(`docs/clients.md: no lock file has a version of ${name}`);
    return `https://cdn.jsdelivr.net/npm/${name}@${version}/`;
  });
}

const parts = text.split(/^## /m).slice(1).map((part) => ({ heading: part.split("\n", 1)[0], body: part.slice(part.indexOf("\n") + 1) }));
const about = parts.findIndex(({ heading }) => heading === "The page of a recipe");
const [, frame] = /^```html\n([\s\S]*?)^```$/m.exec(parts[about].body);

function block(kind, code) {
  const whole = kind === "html" ? frame.replace("{recipe}\n", () => code) : code;
  return `<pre class="${kind}" tabindex="0"><code>${escape(versioned(whole))}</code></pre>\n`;
}

const prose = (s) => s.split(/\n{2,}/).map((p) => p.trim()).filter((p) => p && !p.startsWith("|") && inline(p)).map((p) => `<p>${inline(p)}</p>\n`).join("");

// Up to the last block a section is to be read; what follows are notes.
function section({ heading, body }) {
  const pieces = body.split(/^```(\w*)\n([\s\S]*?)^```$/m);
  let out = `<h2 id="${anchor(heading)}">${escape(heading)}</h2>\n`;
  for (let i = 0; i + 3 <= pieces.length; i += 3) out += prose(pieces[i]) + block(pieces[i + 1], pieces[i + 2]);
  const notes = prose(pieces.at(-1));
  return notes ? `${out}<details><summary>Notes</summary>\n${notes}</details>\n` : out;
}

const recipes = parts.slice(about + 1);
const page = `<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Use {ds}</title>
<link rel="icon" href="{host}/icon.svg">
<style>body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem}h2{margin:2.5rem 0 .5rem}
pre{overflow:auto;padding:.8rem;background:#f2f2ee;border-radius:4px;font-size:.85rem;line-height:1.4;user-select:all}
nav a{display:inline-block;padding:.6rem 1rem .6rem 0;white-space:nowrap}summary{cursor:pointer;padding:.65rem 0}
@media(prefers-color-scheme:dark){body{background:#111;color:#ddd}pre{background:#1d1f22}a{color:#8bf}}</style></head><body><main>
<h1>Use {ds}</h1>
<p>Code to paste, with the addresses and coordinates of this city. A click selects a block. {gaussians} Gaussians, attribution: {attribution}.
Heights in addresses and answers count from {heights}.</p>
<p><a href="{host}/?scene={ds}">The city</a> · <a href="{host}/d/{ds}/city.sog">in one file</a> (.sog, about {megabytes} MB) ·
<a href="{host}/d/{ds}/tileset.json">tileset.json</a> · <a href="{host}/api.html">all addresses</a></p>
<p>Our viewer in any page, in this version for ever (<code>{host}/viewer.js</code> is always the newest):</p>
${block("html", `<script type="module" src="{viewer}"></script>\n<city-splat src="{host}/" scene="{ds}"></city-splat>\n`)}
<nav>${recipes.map(({ heading }) => `<a href="#${anchor(heading)}">${escape(heading)}</a>`).join("\n")}</nav>
${recipes.map(section).join("")}</main></body></html>
`;
mkdirSync(at("dist/"), { recursive: true });
writeFileSync(at("dist/use.html"), page);
