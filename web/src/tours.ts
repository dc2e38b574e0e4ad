// Saved views, played in order. They are kept in this browser, one list a scene, and go to and from
// JSON files: {"type": "citysplat-tour", "views": [{"name", "view", "seconds"}]}.
//
// SPDX-License-Identifier: Apache-2.0
import { formatView, parseView } from "./address";
import { download, element, toast } from "./dom";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const STAY_MS = 1500;
const FLY_S = 3;
const VIEWS_MAX = 500;

export interface Stop {
  name: string;
  view: string; // as in the address bar
  seconds: number; // of the way there
}

// Throws when the text holds none.
export function parseTour(source: string): Stop[] {
  const root = JSON.parse(source) as { type?: string; views?: Partial<Stop>[] };
  if (root.type !== "citysplat-tour" || !Array.isArray(root.views)) throw new Error("no tour");
  return root.views.slice(0, VIEWS_MAX).map(({ name, view, seconds }, i) => {
    if (typeof view !== "string" || !parseView(view)) throw new Error(`view ${i} cannot be read`);
    const way = Number(seconds);
    return {
      name: String(name ?? view).slice(0, 80),
      view,
      seconds: Number.isFinite(way) ? Math.min(60, Math.max(0, way)) : FLY_S,
    };
  });
}

export function formatTour(views: Stop[]): string {
  return JSON.stringify({ type: "citysplat-tour", views }, null, 1);
}

export class Tours {
  private stops: Stop[] = [];
  private playing = 0; // counts, so that a stop ends the run that it belongs to

  constructor(private readonly viewer: Viewer) {
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    const file = element<HTMLInputElement>("tour-file");
    click("tour-add", () => this.add());
    click("tour-play", () => (this.playing % 2 ? this.stop() : void this.play()));
    click("tour-export", () => download("tour.json", "application/json", formatTour(this.stops)));
    click("tour-import", () => file.click());
    file.addEventListener("change", () => void this.read(file));
    viewer.on("scene", () => this.load());
    viewer.on("touch", () => this.stop());
  }

  private key(): string {
    return `citysplat.tour.${this.viewer.scene?.id ?? ""}`;
  }

  private load() {
    try {
      this.stops = parseTour(localStorage.getItem(this.key()) ?? "");
    } catch {
      this.stops = [];
    }
    this.list();
  }

  private keep() {
    try {
      localStorage.setItem(this.key(), formatTour(this.stops));
    } catch {
      // no storage: the list lives as long as the page
    }
    this.list();
  }

  private add() {
    const { pose, state } = this.viewer;
    const name = text("tour.name", { number: this.stops.length + 1 });
    this.stops.push({ name, view: formatView({ pose, appearance: state.wanted }), seconds: FLY_S });
    this.keep();
  }

  private list() {
    element("tour").replaceChildren(
      ...this.stops.map((stop, i) => {
        const row = document.createElement("li");
        const go = document.createElement("button");
        go.textContent = stop.name;
        go.onclick = () => void this.goTo(stop);
        const drop = document.createElement("button");
        drop.textContent = "×";
        drop.setAttribute("aria-label", text("tour.remove", { name: stop.name }));
        drop.onclick = () => {
          this.stops.splice(i, 1);
          this.keep();
        };
        row.append(go, drop);
        return row;
      }),
    );
    for (const id of ["tour-play", "tour-export"])
      element<HTMLButtonElement>(id).disabled = this.stops.length === 0;
  }

  private goTo(stop: Stop): Promise<void> {
    const view = parseView(stop.view)!;
    void this.viewer.setAppearance(view.appearance);
    return this.viewer.flyTo(view.pose, stop.seconds);
  }

  async play() {
    const run = (this.playing += 1 + (this.playing % 2)); // odd while playing
    element("tour-play").textContent = text("tour.stop");
    for (const stop of this.stops) {
      await this.goTo(stop);
      if (this.playing !== run) return;
      await new Promise((resolve) => setTimeout(resolve, STAY_MS));
      if (this.playing !== run) return;
    }
    this.stop();
  }

  private stop() {
    if (this.playing % 2) this.playing++;
    element("tour-play").textContent = text("tour.play");
  }

  private async read(input: HTMLInputElement) {
    const file = input.files?.[0];
    input.value = "";
    if (!file) return;
    try {
      this.stops = parseTour(await file.text());
      this.keep();
    } catch {
      toast(text("tour.bad", { file: file.name }));
    }
  }
}
