// Light and weather: two lists of photographs and a slider between them. The picture stays as it is
// until the new one is complete.
//
// SPDX-License-Identifier: Apache-2.0
import { element, setText } from "./dom";
import { text } from "./strings";
import type { Appearance, Viewer } from "./viewer";

const NAME_DEFAULT = "default";
const WAIT_MS = 250; // after the slider came to rest: every mix is a set of tiles of its own

interface Choice {
  from: string;
  to: string; // "" for none
  percent: number;
}

// "NAME", or "NAME:WEIGHT,NAME:WEIGHT"; "" for the default one.
export function formatAppearance({ from, to, percent }: Choice): string {
  if (!to || percent === 0) return from === NAME_DEFAULT ? "" : from;
  return percent === 100 ? to : `${from}:${(100 - percent) / 100},${to}:${percent / 100}`;
}

// The other way round, for links: null where the text is none of those two shapes.
export function parseAppearance(value: string, names: string[]): Choice | null {
  if (!value) return { from: NAME_DEFAULT, to: "", percent: 50 };
  const parts = value.split(",").map((part) => /^(.*?)(?::([\d.]+))?$/.exec(part)!);
  if (parts.length > 2 || parts.some((part) => !names.includes(part[1]!))) return null;
  const [a, b] = parts.map((part) => Number(part[2] ?? 1));
  const percent = b === undefined ? 50 : Math.round((100 * b) / (a! + b));
  return { from: parts[0]![1]!, to: parts[1]?.[1] ?? "", percent };
}

// Options in groups of a day, in the order of the day; without times one plain list.
function options(list: Appearance[]): (HTMLOptionElement | HTMLOptGroupElement)[] {
  const days = new Map<string, Appearance[]>();
  for (const one of [...list].sort((a, b) => a.time.localeCompare(b.time))) {
    const day = one.time.slice(0, 10);
    days.set(day, [...(days.get(day) ?? []), one]);
  }
  const option = (one: Appearance) => {
    const clock = one.time.slice(11, 16);
    return new Option(clock ? `${clock} · ${one.name}` : one.name, one.name);
  };
  return [...days].flatMap(([day, ones]) => {
    if (!day) return ones.map(option);
    const group = document.createElement("optgroup");
    group.label = day;
    group.append(...ones.map(option));
    return [group];
  });
}

export class AppearanceControl {
  private readonly from = element<HTMLSelectElement>("appearance-from");
  private readonly to = element<HTMLSelectElement>("appearance-to");
  private readonly mix = element<HTMLInputElement>("appearance-mix");
  private names: string[] = [];
  private timer = 0;

  constructor(private readonly viewer: Viewer) {
    this.from.onchange = this.to.onchange = () => this.apply(0);
    this.mix.oninput = () => this.apply(WAIT_MS);
    viewer.on("scene", () => void this.fill().catch(() => {}));
    viewer.on("frame", () => this.tell());
    viewer.on("appearance", () => this.tell());
    viewer.on("problem", () => this.choose());
  }

  private async fill() {
    const scene = this.viewer.scene;
    const list = await this.viewer.appearances(scene);
    if (scene !== this.viewer.scene) return;
    this.names = list.map((one) => one.name);
    const photographs = list.filter((one) => one.name !== NAME_DEFAULT);
    this.from.replaceChildren(
      new Option(text("appearance.all"), NAME_DEFAULT),
      ...options(photographs),
    );
    this.to.replaceChildren(
      new Option(text("appearance.none"), ""),
      ...options(photographs.filter((one) => !one.name.includes(","))),
    );
    element("appearance").hidden = list.length === 0;
    this.choose();
  }

  // The controls say what is wanted.
  private choose() {
    const choice = parseAppearance(this.viewer.state.wanted, this.names);
    if (!choice) return;
    this.from.value = choice.from;
    this.to.value = choice.to;
    this.mix.value = String(choice.percent);
    this.mix.hidden = !choice.to;
  }

  private apply(waitMs: number) {
    this.mix.hidden = !this.to.value;
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => {
      const choice = {
        from: this.from.value,
        to: this.to.value,
        percent: Number(this.mix.value),
      };
      void this.viewer.setAppearance(formatAppearance(choice));
    }, waitMs);
  }

  private tell() {
    const { appearance, wanted } = this.viewer.state;
    const changing = appearance !== wanted && this.names.length > 0;
    setText("appearance-text", changing ? text("appearance.changing") : "");
  }
}
