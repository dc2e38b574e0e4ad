// Every text of the viewer, in English and German. A language that lacks a text falls back to
// English.
//
// SPDX-License-Identifier: Apache-2.0
import { own, page, type TextKey } from "./strings.en";

export type { TextKey };

export type Language = "en" | "de";
let language: Language = "en";
let table: Partial<Record<TextKey, string>> = own; // the module's, until a page sets its language

export function getLanguage(): Language {
  return language;
}

// Resolves when its texts are there: other languages than English are a file of their own.
export async function setLanguage(wanted: string): Promise<void> {
  const en = { ...own, ...page };
  if (!wanted.toLowerCase().startsWith("de")) return void ([language, table] = ["en", en]);
  if (table === own) table = en; // until they come
  try {
    [language, table] = ["de", { ...en, ...(await import("./strings.de")).de }];
  } catch (error) {
    console.warn("citysplat: the German texts did not come", error);
  }
}

export function text(key: TextKey, values: Record<string, string | number> = {}): string {
  return fill(table[key] ?? key, values);
}

// "{name}" in a text becomes that value.
export function fill(raw: string, values: Record<string, string | number>): string {
  return raw.replace(/\{(\w+)\}/g, (_, name: string) => String(values[name] ?? ""));
}

// Every element with data-t, data-t-title or data-t-label says it in the language of now.
export function translate(root: ParentNode) {
  translateBy(root, (key) => text(key as TextKey));
}

// As translate, with the texts of another page.
export function translateBy(root: ParentNode, say: (key: string) => string) {
  for (const node of root.querySelectorAll<HTMLElement>("[data-t]")) node.textContent = say(node.dataset["t"]!);
  for (const node of root.querySelectorAll<HTMLElement>("[data-t-title]"))
    node.title = say(node.dataset["tTitle"]!) + (node.dataset["key"] ? ` (${node.dataset["key"]})` : "");
  for (const node of root.querySelectorAll<HTMLElement>("[data-t-label]"))
    node.setAttribute("aria-label", say(node.dataset["tLabel"]!));
}
