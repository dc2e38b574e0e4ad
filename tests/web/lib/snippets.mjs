// The examples of docs/, as they are printed.
//
// SPDX-License-Identifier: Apache-2.0
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

const DOCS = fileURLToPath(new URL("../../../docs/", import.meta.url));

const textOf = (document) => readFileSync(`${DOCS}${document}`, "utf8");
const blocksOf = (text) => [...text.matchAll(/^```(\w*)\n([\s\S]*?)^```$/gm)].map(([, kind, code]) => ({ kind, code }));

// All code blocks of a document: { kind, code }; kind: what stands behind the three backticks.
export const blocks = (document) => blocksOf(textOf(document));

// Code blocks of a kind below a heading of a document, down to the next heading.
export function snippets(document, heading, kind = "") {
    const text = textOf(document);
    const at = text.indexOf(`\n${heading}\n`);
    if (at < 0) throw new Error(`docs/${document} has no "${heading}"`);
    const [part] = text.slice(at + heading.length + 2).split(/^#+ /m, 1);
    const found = blocksOf(part).filter((one) => one.kind === kind).map(({ code }) => code);
    if (!found.length) throw new Error(`docs/${document}: no \`\`\`${kind} below "${heading}"`);
    return found;
}

// The host of the documents is the one that answers here.
export const hostedBy = (code, url) => code.replaceAll("https://city.example", url);
