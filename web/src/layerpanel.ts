// Layers on the page: files are dropped or chosen, addresses typed; a list shows what is there, where it
// stands and what went wrong. Layers by address are kept in the link.
//
// SPDX-License-Identifier: Apache-2.0
import { element, toast } from "./dom";
import type { Layer, LayerChange, LayerOptions, ModelPlace } from "./layers";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const LINKED_MAX = 16;

// An address and, behind its "#", how it is shown: at=lon,lat,h,heading,scale; up=metres; drape=0 or 1;
// hidden. That part is of this page, and never sent.
export function formatLayer({ url, place, up, drape, visible }: Layer): string {
  const out = new URL(url!);
  const parts: string[] = [];
  if (place) {
    const { lon, lat, h, heading, scale } = place;
    const turn = Number(heading.toFixed(2));
    parts.push(`at=${[lon.toFixed(7), lat.toFixed(7), h.toFixed(2), turn, Number(scale.toPrecision(5))].join()}`);
  }
  if (up) parts.push(`up=${Number(up.toFixed(2))}`);
  if (drape !== null) parts.push(`drape=${Number(drape)}`);
  if (!visible) parts.push("hidden");
  out.hash = parts.join("&");
  return out.href;
}

export function parseLayer(value: string, base: string): LayerOptions | null {
  if (!URL.canParse(value, base)) return null;
  const url = new URL(value, base);
  const how = new URLSearchParams(url.hash.slice(1));
  url.hash = "";
  if (!/^https?:$/.test(url.protocol)) return null;
  const [lon, lat, h, heading = 0, scale = 1] = (how.get("at") ?? "").split(",").filter(Boolean).map(Number);
  const numbers = [lon, lat, h, heading, scale];
  const place = numbers.every((v) => Number.isFinite(v)) && scale > 0 && Math.abs(lat!) <= 90;
  const up = Number(how.get("up") ?? 0);
  return {
    url,
    visible: !how.has("hidden"),
    ...(place ? { place: { lon, lat, h, heading, scale } as ModelPlace } : {}),
    ...(Number.isFinite(up) ? { up } : {}),
    ...(how.has("drape") ? { drape: how.get("drape") === "1" } : {}),
  };
}

export class LayerPanel {
  private waiting: string[]; // of the address the page came with, until a scene is there
  private count = 0;
  private moving = 0; // the next click puts this model there

  constructor(private readonly viewer: Viewer) {
    this.waiting = new URLSearchParams(location.search).getAll("overlay").slice(0, LINKED_MAX);
    viewer.on("layers", () => this.list());
    viewer.on("scene", () => this.begin());
    viewer.on("click", ({ place }) => this.put(place));
    this.wireDrop();
    this.wireForm();
  }

  // For the address bar; those that did not open yet are kept as they were given.
  get links(): string[] {
    return [...this.waiting, ...this.viewer.layers.list.filter(({ url }) => url !== null).map(formatLayer)];
  }

  translate() {
    this.list();
  }

  private begin() {
    const given = this.waiting.splice(0);
    for (const value of given) {
      const options = parseLayer(value, location.href);
      if (options) void this.add(options);
      else toast(text("layer.failed", { name: value.slice(0, 80), why: text("layer.address") }));
    }
  }

  private async add(options: LayerOptions): Promise<boolean> {
    try {
      const { name, state, id } = await this.viewer.layers.add(options);
      if (state !== "shown") return false;
      const count = this.viewer.layers.countOf(id);
      toast(count ? text("overlay.added", { count, file: name }) : text("layer.added", { name }));
      return true;
    } catch (error) {
      const name = options.file?.name ?? String(options.url);
      toast(text("layer.failed", { name, why: (error as Error).message }));
      return false;
    }
  }

  // ---- asking for them ----

  private wireDrop() {
    const over = (on: boolean) => document.body.classList.toggle("dropping", on);
    window.addEventListener("dragover", (event) => {
      event.preventDefault();
      over(true);
    });
    window.addEventListener("dragleave", () => over(false));
    window.addEventListener("drop", (event) => {
      event.preventDefault();
      over(false);
      const { files } = event.dataTransfer ?? {};
      const address = event.dataTransfer?.getData("text/uri-list").split(/[\r\n]+/)[0] ?? "";
      const box = this.viewer.surface.getBoundingClientRect();
      const place = this.viewer.pick(event.clientX - box.left, event.clientY - box.top);
      const at = place ? { place: { ...place, heading: 0, scale: 1 } } : {};
      for (const file of files ?? []) void this.add({ file, ...at });
      if (!files?.length && /^https?:/.test(address)) void this.add({ url: address, ...at });
    });
  }

  private wireForm() {
    const file = element<HTMLInputElement>("layer-file");
    const address = element<HTMLInputElement>("layer-url");
    element("layer-choose").addEventListener("click", () => file.click());
    file.addEventListener("change", () => {
      for (const one of file.files ?? []) void this.add({ file: one });
      file.value = "";
    });
    element("layer-form").addEventListener("submit", (event) => {
      event.preventDefault();
      const options = parseLayer(address.value.trim(), location.href);
      if (!options || !address.value.trim()) toast(text("layer.address"));
      else void this.add(options).then((done) => done && (address.value = ""));
    });
  }

  private put(place: { lon: number; lat: number; h: number } | null) {
    const id = this.moving;
    const layer = this.viewer.layers.list.find((one) => one.id === id);
    this.moving = 0;
    if (layer?.place && place) this.viewer.layers.change(id, { place: { ...layer.place, ...place } });
    else if (id) this.list();
  }

  // ---- the list ----

  private list() {
    const { list } = this.viewer.layers;
    const box = element("layers");
    const focused = (document.activeElement as HTMLElement | null)?.dataset["part"];
    box.replaceChildren(...list.map((layer) => this.row(layer)));
    box.hidden = !list.length;
    if (focused) box.querySelector<HTMLElement>(`[data-part="${focused}"]`)?.focus();
    if (list.length > this.count) element<HTMLDetailsElement>("layers-box").open = true;
    this.count = list.length;
  }

  private row(layer: Layer): HTMLElement {
    const { layers, stage } = this.viewer;
    const { id, name, state, why } = layer;
    const row = document.createElement("li");
    const head = document.createElement("div");
    head.append(this.check(layer, name, layer.visible, "visible", (visible) => ({ visible })));
    const see = this.button(layer, "layer.see", "◎", () => {
      const extent = layers.extentOf(id);
      if (!extent) return;
      stage.home(extent);
      this.viewer.lookAt(this.viewer.pose);
    });
    see.hidden = state !== "shown";
    head.append(see, this.button(layer, "layer.remove", "×", () => layers.remove(id)));
    row.append(head);
    if (state === "loading") row.append(line("soft", text("layer.loading")));
    if (state === "failed") {
      row.append(line("warn", why));
      if (layer.url !== null) row.append(this.again(layer));
    }
    if (state === "shown") row.append(this.controls(layer));
    return row;
  }

  private again(layer: Layer): HTMLElement {
    const button = document.createElement("button");
    button.textContent = text("problem.retry");
    button.dataset["part"] = `${layer.id} retry`;
    button.onclick = () =>
      void this.viewer.layers
        .retry(layer.id)
        .catch((error: Error) => toast(text("layer.failed", { name: layer.name, why: error.message })));
    return button;
  }

  // What can be said about where it stands.
  private controls(layer: Layer): HTMLElement {
    const box = document.createElement("div");
    box.className = "how";
    const { place, drape, up } = layer;
    if (drape !== null) box.append(this.check(layer, text("layer.drape"), drape, "drape", (on) => ({ drape: on })));
    if (!drape) box.append(this.number(layer, "layer.up", up, 0.5, (value) => ({ up: value })));
    if (place) {
      const set = (change: Partial<ModelPlace>): LayerChange => ({ place: { ...place, ...change } });
      box.append(
        this.number(layer, "layer.heading", place.heading, 5, (heading) => set({ heading })),
        this.number(layer, "layer.scale", place.scale, 0.1, (scale) => (scale > 0 ? set({ scale }) : {})),
      );
      const move = this.button(layer, "layer.move", text("layer.move"), () => {
        this.moving = this.moving === layer.id ? 0 : layer.id;
        this.list();
        if (this.moving) toast(text("layer.move.hint", { name: layer.name }));
      });
      move.setAttribute("aria-pressed", String(this.moving === layer.id));
      box.append(move);
    }
    return box;
  }

  private button(layer: Layer, key: "layer.see" | "layer.remove" | "layer.move", value: string, run: () => void) {
    const button = document.createElement("button");
    button.textContent = value;
    button.dataset["part"] = `${layer.id} ${key}`;
    button.setAttribute("aria-label", `${text(key)}: ${layer.name}`);
    button.title = text(key);
    button.onclick = run;
    return button;
  }

  private check(layer: Layer, value: string, on: boolean, part: string, to: (on: boolean) => LayerChange) {
    const label = document.createElement("label");
    const box = document.createElement("input");
    const name = document.createElement("span");
    label.className = "check";
    box.type = "checkbox";
    box.checked = on;
    box.disabled = layer.state !== "shown";
    box.dataset["part"] = `${layer.id} ${part}`;
    box.onchange = () => this.viewer.layers.change(layer.id, to(box.checked));
    name.textContent = value;
    label.append(box, name);
    return label;
  }

  private number(
    layer: Layer,
    key: "layer.up" | "layer.heading" | "layer.scale",
    value: number,
    step: number,
    to: (value: number) => LayerChange,
  ) {
    const label = document.createElement("label");
    const box = document.createElement("input");
    label.className = "number";
    label.textContent = text(key);
    Object.assign(box, { type: "number", step: String(step), value: String(Number(value.toFixed(3))) });
    box.dataset["part"] = `${layer.id} ${key}`;
    box.onchange = () => {
      if (box.value !== "" && Number.isFinite(box.valueAsNumber))
        this.viewer.layers.change(layer.id, to(box.valueAsNumber));
    };
    label.append(box);
    return label;
  }
}

function line(className: string, value: string): HTMLElement {
  const node = document.createElement("p");
  node.className = className;
  node.textContent = value;
  return node;
}
