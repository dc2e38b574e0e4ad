// The dialog for pictures of the view: size, format, background, who draws; then a download.
//
// SPDX-License-Identifier: Apache-2.0
import { downloadBlob, element, setText } from "./dom";
import { Problem } from "./problem";
import type { ShotFormat, ShotOptions } from "./shot";
import { text } from "./strings";
import type { Viewer } from "./viewer";

type Background = NonNullable<ShotOptions["background"]>;

export class ShotDialog {
  private readonly dialog = element<HTMLDialogElement>("shot");
  private working: AbortController | null = null;

  constructor(private readonly viewer: Viewer) {
    element("shot-size").addEventListener("change", () => this.choose());
    for (const id of ["shot-width", "shot-height"])
      element(id).addEventListener("input", () => (this.select("shot-size").value = "own"));
    for (const id of ["shot-format", "shot-by"]) element(id).addEventListener("change", () => this.limit());
    element("shot-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.make();
    });
    element("shot-close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener("close", () => this.working?.abort());
  }

  open() {
    const { viewer } = this;
    const by = this.select("shot-by");
    const server = viewer.scene?.questions != null;
    by.options[0]!.disabled = !server;
    by.options[1]!.disabled = viewer.mode === "pictures";
    by.value = server && !viewer.layers.list.some(({ visible }) => visible) ? "server" : "browser";
    if (viewer.mode === "pictures") by.value = "server";
    if (this.select("shot-size").value === "own") this.select("shot-size").value = "view";
    this.choose();
    setText("shot-text", "");
    this.dialog.showModal();
  }

  private select(id: string): HTMLSelectElement {
    return element<HTMLSelectElement>(id);
  }

  private input(id: string): HTMLInputElement {
    return element<HTMLInputElement>(id);
  }

  private choose() {
    const { value } = this.select("shot-size");
    const { width, height } = this.viewer.wantedView;
    const size = /^(\d+)x(\d+)$/.exec(value);
    if (value === "view" || size) {
      this.input("shot-width").value = size ? size[1]! : String(width);
      this.input("shot-height").value = size ? size[2]! : String(height);
    }
    this.limit();
  }

  // What goes together.
  private limit() {
    const background = this.select("shot-background");
    const clear = this.select("shot-by").value === "server" && this.select("shot-format").value !== "jpg";
    background.options[2]!.disabled = !clear;
    if (!clear && background.value === "transparent") background.value = "sky";
  }

  private async make() {
    const { viewer } = this;
    const working = new AbortController();
    this.working?.abort();
    this.working = working;
    const button = element<HTMLButtonElement>("shot-make");
    button.disabled = true;
    setText("shot-text", text("shot.wait"));
    const format = this.select("shot-format").value as ShotFormat;
    const options: ShotOptions = {
      width: this.input("shot-width").valueAsNumber,
      height: this.input("shot-height").valueAsNumber,
      format,
      background: this.select("shot-background").value as Background,
      by: this.select("shot-by").value as "server" | "browser",
      signal: working.signal,
      onPart: (done, total) => {
        if (total > 1) setText("shot-text", text("shot.part", { done, total }));
      },
    };
    try {
      const blob = await viewer.screenshot(options);
      const name = `${viewer.scene?.id ?? "city"}-${options.width}x${options.height}.${format}`;
      downloadBlob(name, blob);
      setText("shot-text", text("shot.done", { name, size: sizeOf(blob.size) }));
    } catch (error) {
      if (working.signal.aborted) return;
      setText("shot-text", error instanceof Problem ? `${error.title}. ${error.message}` : (error as Error).message);
    } finally {
      if (this.working === working) button.disabled = false;
    }
  }
}

function sizeOf(bytes: number): string {
  return bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}
