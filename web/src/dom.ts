// The page's elements, and small things that are done to them.
//
// SPDX-License-Identifier: Apache-2.0
import { text } from "./strings";

export function element<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no #${id}`);
  return found as T;
}

// Writes only what changed: an idle page must not touch the document.
export function setText(id: string, value: string) {
  const node = element(id);
  if (node.textContent !== value) node.textContent = value;
}

let toastTimer = 0;
export function toast(value: string) {
  const box = element("toast");
  box.textContent = value;
  box.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (box.hidden = true), 4000);
}

// A part of the page that comes when it is wanted; null, with words to the person, where it does not come.
export async function later<T>(part: Promise<T>): Promise<T | null> {
  try {
    return await part;
  } catch (error) {
    console.warn("citysplat: a part of the page did not come", error);
    toast(text("part.missing"));
    return null;
  }
}

// Where there is no clipboard (outside of secure contexts) the text itself is shown.
export async function copy(value: string, done: string) {
  try {
    await navigator.clipboard.writeText(value);
    toast(done);
  } catch {
    toast(value);
  }
}

export function download(name: string, type: string, content: string) {
  downloadBlob(name, new Blob([content], { type }));
}

export function downloadBlob(name: string, blob: Blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
