// The strip of photographs: light and weather by looking. Radio buttons with pictures, in groups of a
// day and a time of day, so arrow keys, screen readers and fingers all work as everywhere.
//
// SPDX-License-Identifier: Apache-2.0
import { element } from "./dom";
import type { Pose } from "./geo";
import { getLanguage, text, type TextKey } from "./strings";
import type { Appearance } from "./viewer";

const M_PER_DEGREE = 111_320;
const HEIGHT_LEAST_M = 10;

// Hours at which a part of the day begins.
const PARTS: [number, TextKey][] = [
  [22, "photos.night"],
  [18, "photos.evening"],
  [14, "photos.afternoon"],
  [11, "photos.midday"],
  [5, "photos.morning"],
  [0, "photos.night"],
];

function direction({ heading, pitch }: { heading: number; pitch: number }): number[] {
  const [turn, tilt] = [(heading * Math.PI) / 180, (pitch * Math.PI) / 180];
  return [Math.sin(turn) * Math.cos(tilt), Math.cos(turn) * Math.cos(tilt), Math.sin(tilt)];
}

// The photograph taken nearest to a view: metres between the cameras, and the angle between them
// times the height, as evaluation does it.
export function nearestPhotograph(list: Appearance[], view: Pose, heightM: number): string | null {
  const ahead = direction(view);
  let best: string | null = null;
  let least = Infinity;
  for (const { name, place } of list) {
    if (!place) continue;
    const east = (place.lon - view.lon) * M_PER_DEGREE * Math.cos((view.lat * Math.PI) / 180);
    const north = (place.lat - view.lat) * M_PER_DEGREE;
    const cosine = direction(place).reduce((sum, v, i) => sum + v * ahead[i]!, 0);
    const angle = Math.acos(Math.min(1, Math.max(-1, cosine)));
    const apart = Math.hypot(east, north, place.h - view.h);
    const cost = apart + angle * Math.max(HEIGHT_LEAST_M, heightM);
    if (cost < least) [best, least] = [name, cost];
  }
  return best;
}

export function byTime(a: Appearance, b: Appearance): number {
  return a.time.localeCompare(b.time) || a.name.localeCompare(b.name);
}

// "1 June 2024 · morning" of a photograph.
export function groupOf({ time }: Appearance): string {
  if (!time) return text("photos.undated");
  const day = new Date(`${time.slice(0, 10)}T12:00:00`);
  const hour = Number(time.slice(11, 13));
  const part = PARTS.find(([from]) => hour >= from)![1];
  const date = Number.isNaN(day.getTime())
    ? time.slice(0, 10)
    : day.toLocaleDateString(getLanguage(), { day: "numeric", month: "long", year: "numeric" });
  return `${date} · ${text(part)}`;
}

export class PhotoStrip {
  onChoose: (name: string) => void = () => {};
  private list: Appearance[] = [];
  private chosen = "";

  get open(): boolean {
    return !element("photos").hidden;
  }

  show(open: boolean) {
    element("photos").hidden = !open;
    element("photos-button").setAttribute("aria-pressed", String(open));
    if (open) {
      if (!element("photo-list").childElementCount) this.build();
      this.markChosen(true);
    }
  }

  // Photographs alone.
  set photographs(list: Appearance[]) {
    this.list = [...list].sort(byTime);
    element("photo-list").replaceChildren();
    if (this.open) this.build();
  }

  // Which one is on.
  choose(name: string) {
    if (name === this.chosen) return;
    this.chosen = name;
    this.markChosen(this.open);
  }

  // In the language of now.
  translate() {
    if (element("photo-list").childElementCount) this.build();
  }

  private build() {
    const groups = new Map<string, HTMLElement>();
    for (const one of this.list) {
      const title = groupOf(one);
      let group = groups.get(title);
      if (!group) {
        group = document.createElement("div");
        group.setAttribute("role", "group");
        group.setAttribute("aria-label", title);
        const heading = document.createElement("p");
        heading.textContent = title;
        heading.setAttribute("aria-hidden", "true");
        group.append(heading, document.createElement("div"));
        groups.set(title, group);
      }
      group.lastElementChild!.append(this.card(one));
    }
    element("photo-list").replaceChildren(...groups.values());
    this.markChosen(false);
  }

  private card(one: Appearance): HTMLElement {
    const label = document.createElement("label");
    const input = document.createElement("input");
    const clock = one.time.slice(11, 16);
    Object.assign(input, { type: "radio", name: "photograph", value: one.name });
    input.setAttribute("aria-label", clock ? `${clock} ${one.name}` : one.name);
    input.addEventListener("change", () => this.onChoose(one.name));
    const caption = document.createElement("span");
    caption.textContent = clock || one.name;
    label.title = one.name;
    label.append(input);
    if (one.thumbnail) {
      const image = document.createElement("img");
      Object.assign(image, { alt: "", loading: "lazy", decoding: "async", src: one.thumbnail });
      label.append(image);
    }
    label.append(caption);
    return label;
  }

  private markChosen(scroll: boolean) {
    for (const input of document.querySelectorAll<HTMLInputElement>('#photo-list input[type="radio"]')) {
      input.checked = input.value === this.chosen;
      if (input.checked && scroll)
        input.parentElement!.scrollIntoView({ block: "nearest", inline: "center" });
    }
  }
}
