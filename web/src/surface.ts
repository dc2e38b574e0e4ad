// What the viewer puts into its container: canvases of its own and of the server's pictures, and whose the city is.
//
// SPDX-License-Identifier: Apache-2.0
import { text } from "./strings";

function layer<Tag extends "div" | "canvas">(tag: Tag): HTMLElementTagNameMap[Tag] {
  const node = document.createElement(tag);
  Object.assign(node.style, { position: "absolute", inset: "0", width: "100%", height: "100%" });
  return node;
}

export class Surface {
  readonly node = layer("div"); // takes pointer and keys
  readonly canvas = layer("canvas");
  readonly pictures = layer("canvas");
  private readonly credit = document.createElement("small"); // of the city, and of the map on the ground
  private readonly positions: boolean; // the container, which had no position of its own

  constructor(private readonly container: HTMLElement) {
    const { node, canvas, pictures, credit } = this;
    pictures.hidden = true;
    pictures.className = "citysplat-picture";
    Object.assign(node.style, { overflow: "hidden", outline: "none" });
    node.tabIndex = 0;
    node.setAttribute("role", "application");
    node.setAttribute("aria-label", text("surface.label"));
    credit.className = "citysplat-credit";
    Object.assign(credit.style, { position: "absolute", right: "0", bottom: "0", padding: "0 6px", color: "#222", background: "rgb(255 255 255 / 75%)", font: "11px/1.6 system-ui, sans-serif", pointerEvents: "none" });
    credit.hidden = true;
    node.append(canvas, pictures, credit);
    this.positions = getComputedStyle(container).position === "static";
    if (this.positions) container.style.position = "relative";
    container.append(node);
  }

  // What is to be seen before anything is drawn.
  setTheme(theme: "dark" | "light") {
    this.node.style.background = theme === "dark" ? "#0b0e13" : "#dfe6ee";
  }

  setCredit(credit: string) {
    this.credit.textContent = credit;
    this.credit.hidden = !credit;
  }

  remove() {
    this.node.remove();
    if (this.positions) this.container.style.position = "";
  }
}
