// <city-splat src="https://city.example/">: the viewer as an element. What the viewer tells become its events.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import { ElementFrame, FRAME_STYLE } from "./frame";
import { Problem, type ProblemKind } from "./problem";
import type { Mode, ViewerEvents, ViewerOptions } from "./types";
import { createViewer, type Viewer } from "./viewer";

const EVENTS = ["ready", "scene", "problem", "move", "click", "unclick", "appearance", "link"] as const;
type EventName = (typeof EVENTS)[number];
// Events of <city-splat> by name; `detail` is what the viewer tells.
export type CitySplatEvents = { [Name in EventName]: CustomEvent<ViewerEvents[Name]> };

const ATTRIBUTES = ["src", "scene", "view", "appearance", "mode", "theme", "detail", "memory", "backdrop", "basemap", "basemap-credit"] as const;
// Attributes of <city-splat>.
export type Attribute = (typeof ATTRIBUTES)[number];

const STYLE = ":host{display:block;position:relative;aspect-ratio:16/9;overflow:hidden}:host([hidden]){display:none}div{position:absolute;inset:0}" + FRAME_STYLE;

// A page that is made on a server imports this, too, and has no elements there.
const Base = typeof HTMLElement === "function" ? HTMLElement : (class {} as unknown as typeof HTMLElement);

export class CitySplatElement extends Base {
  // Attributes that count when they change.
  static readonly observedAttributes: readonly string[] = ATTRIBUTES;
  private own: Viewer | null = null;
  private readonly box: HTMLDivElement;
  private readonly frame = new ElementFrame();

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    const sheet = new CSSStyleSheet(); // a page's policy for styles does not concern it
    sheet.replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    this.box = document.createElement("div");
    root.append(this.box, ...this.frame.nodes);
    // The element has a click of its own, with the place.
    for (const node of [this.box, ...this.frame.nodes]) node.addEventListener("click", (event) => event.stopPropagation());
  }

  // All that the module can do; null while the element is in no document.
  get viewer(): Viewer | null {
    return this.own;
  }

  // For the browser to call.
  connectedCallback() {
    this.own ??= this.start();
  }

  // For the browser to call.
  disconnectedCallback() {
    // Moved to another place of the document, it is there again at the end of this turn.
    queueMicrotask(() => this.isConnected || this.stop());
  }

  // For the browser to call.
  attributeChangedCallback(name: Attribute, before: string | null, now: string | null) {
    if (this.own && before !== now) this.change(this.own, name, now ?? "");
  }

  private change(viewer: Viewer, name: Attribute, now: string) {
    if (name === "scene" && viewer.scenes.length) {
      void viewer.openScene(now || viewer.scenes[0]!.id, this.pose, this.appearance);
    } else if (name === "src" || name === "scene") {
      this.stop();
      this.own = this.start();
    } else if (name === "view") {
      const { pose } = this;
      if (pose) viewer.lookAt(pose);
      else if (!now) viewer.home();
    } else if (name === "appearance") void viewer.setAppearance(now);
    else if (name === "mode") viewer.setMode(now === "pictures" ? now : "splats");
    else if (name === "theme") viewer.setTheme(this.coloured);
    else if (name === "detail") viewer.detail = Number(now) || 1;
    else if (name === "memory" && Number(now) > 0) viewer.memoryMb = Number(now);
    else if (name === "backdrop") viewer.backdrop = now !== "off";
    else if (name === "basemap" || name === "basemap-credit") viewer.setBasemap(this.basemap);
  }

  private start(): Viewer {
    const text = (name: Attribute) => this.getAttribute(name) ?? "";
    const [scene, mode] = [text("scene"), text("mode")];
    const options: ViewerOptions = {
      url: text("src") || "./",
      pose: this.pose,
      appearance: this.appearance,
      theme: this.coloured,
      backdrop: text("backdrop") !== "off",
      basemap: this.basemap,
      detail: Number(text("detail")) || 1,
      keyboard: "focus", // the page's keys are the page's
      ...(scene ? { scene } : {}),
      ...(mode ? { mode: mode as Mode | "auto" } : {}),
      ...(Number(text("memory")) > 0 ? { memoryMb: Number(text("memory")) } : {}),
    };
    const viewer = createViewer(this.box, options);
    this.frame.serve(viewer, this);
    for (const name of EVENTS) viewer.on(name, (value) => this.tell(name, value));
    return viewer;
  }

  private stop() {
    this.own?.dispose();
    this.own = null;
  }

  private warn(kind: ProblemKind, values: Record<string, string>) {
    const problem = new Problem(kind, values);
    console.warn(`citysplat: ${problem.message}`);
    queueMicrotask(() => this.tell("problem", problem));
  }

  // A click rises through the document, as clicks do; what the viewer tells besides does not.
  private tell(name: EventName, detail: unknown) {
    const rises = name === "click";
    this.dispatchEvent(new CustomEvent(name, { detail, bubbles: rises, composed: rises }));
  }

  // null where the attribute is not there, or is none.
  private get pose() {
    const { view } = this;
    if (!view) return null;
    const parsed = parseView(view);
    if (!parsed) this.warn("badView", { view });
    return parsed?.pose ?? null;
  }

  private get basemap() {
    const tiles = this.getAttribute("basemap");
    return tiles ? { tiles, attribution: this.getAttribute("basemap-credit") ?? "" } : null;
  }

  private get coloured(): "dark" | "light" {
    return this.getAttribute("theme") === "dark" ? "dark" : "light";
  }

  // ---- attributes as properties, which is what frameworks set ----

  // A citysplat server's folder, or a tileset.json.
  get src(): string {
    return this.getAttribute("src") ?? "";
  }
  set src(value: string) {
    this.setAttribute("src", value);
  }
  // The id of a scene; "": the first.
  get scene(): string {
    return this.getAttribute("scene") ?? "";
  }
  set scene(value: string) {
    this.setAttribute("scene", value);
  }
  // longitude,latitude,height,heading,pitch, as a link of the viewer has them.
  get view(): string {
    return this.getAttribute("view") ?? "";
  }
  set view(value: string) {
    this.setAttribute("view", value);
  }
  // The attribute, or what the view names.
  get appearance(): string {
    return this.getAttribute("appearance") ?? parseView(this.view)?.appearance ?? "";
  }
  set appearance(value: string) {
    this.setAttribute("appearance", value);
  }
}

// Its own events, with what comes with each.
export interface CitySplatElement {
  // As of every element; its own events are typed.
  addEventListener<Name extends keyof CitySplatEvents>(
    name: Name,
    listener: (this: CitySplatElement, event: CitySplatEvents[Name]) => void,
    options?: boolean | AddEventListenerOptions,
  ): void;
  addEventListener(name: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | AddEventListenerOptions): void;
  // As of every element; its own events are typed.
  removeEventListener<Name extends keyof CitySplatEvents>(
    name: Name,
    listener: (this: CitySplatElement, event: CitySplatEvents[Name]) => void,
    options?: boolean | EventListenerOptions,
  ): void;
  removeEventListener(name: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | EventListenerOptions): void;
}

declare global {
  interface HTMLElementTagNameMap {
    "city-splat": CitySplatElement;
  }
}
