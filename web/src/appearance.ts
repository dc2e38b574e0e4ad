// Light and weather: photographs to choose by, a slider between two of them, both side by side, and
// the light in which the view at hand was photographed.
//
// SPDX-License-Identifier: Apache-2.0
import type { SecondLight } from "./address";
import { element, setText, toast } from "./dom";
import { NAME_DEFAULT } from "./network";
import { byTime, groupOf, nearestPhotograph, PhotoStrip } from "./photographs";
import { Split } from "./split";
import { text } from "./strings";
import type { Appearance, Viewer } from "./viewer";

const AGAIN_MS = 5000; // after the photographs could not be listed
const WAIT_MS = 250; // after the slider came to rest, where every mix is a set of tiles of its own

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

// Options in groups, in the order of time.
function options(list: Appearance[]): HTMLElement[] {
  const groups = new Map<string, HTMLOptGroupElement>();
  const option = (one: Appearance) => {
    const clock = one.time.slice(11, 16);
    return new Option(clock ? `${clock} · ${one.name}` : one.name, one.name);
  };
  const sorted = [...list].sort(byTime);
  if (sorted.every((one) => !one.time)) return sorted.map(option);
  for (const one of sorted) {
    const label = groupOf(one);
    const group = groups.get(label) ?? document.createElement("optgroup");
    group.label = label;
    group.append(option(one));
    groups.set(label, group);
  }
  return [...groups.values()];
}

export class AppearanceControl {
  onChange: () => void = () => {}; // what a link says of a second appearance is another thing now
  onList: () => void = () => {}; // photographs are listed, and the panel has its size
  private readonly from = element<HTMLSelectElement>("appearance-from");
  private readonly to = element<HTMLSelectElement>("appearance-to");
  private readonly mix = element<HTMLInputElement>("appearance-mix");
  private readonly strip = new PhotoStrip();
  private readonly split: Split;
  private list: Appearance[] = [];
  private names: string[] = [];
  private timer = 0;
  private listed = ""; // of which scene and revision photographs are listed, or asked for
  private again = 0; // the timer of another attempt

  // wish: the second appearance of the link, to be shown when the photographs are known.
  constructor(
    private readonly viewer: Viewer,
    private wish: SecondLight | null,
  ) {
    this.split = new Split(viewer);
    this.split.onChange = () => this.onChange();
    this.from.onchange = this.to.onchange = () => this.apply(0);
    this.mix.oninput = () => this.apply(viewer.computesColours ? 0 : WAIT_MS);
    viewer.on("scene", () => this.begin());
    viewer.on("frame", () => {
      this.tell();
      if (this.split.open && viewer.secondAppearance === null) this.tellSplit();
      this.fillSoon();
    });
    viewer.on("appearance", () => this.tell());
    viewer.on("problem", () => this.choose());
    viewer.on("picture", () => this.fillSoon());
    this.strip.onChoose = (name) => {
      const second = element<HTMLInputElement>("photos-second").checked;
      (second ? this.to : this.from).value = name;
      this.apply(0);
    };
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    click("photos-button", () => this.showPhotographs(!this.strip.open));
    click("photos-close", () => this.showPhotographs(false));
    click("appearance-here", () => this.chooseHere());
    click("appearance-split", () => void this.showSplit(!this.split.open));
    element("photos-ends").addEventListener("change", () => this.choose());
  }

  // False where there are none.
  showPhotographs(open: boolean): boolean {
    if (open && !this.list.some((one) => one.name !== NAME_DEFAULT)) return false;
    this.strip.show(open);
    this.choose();
    if (!open) element("photos-button").focus();
    return true;
  }

  get photographsOpen(): boolean {
    return this.strip.open;
  }

  // What a link has to say of it; null: there is no second appearance.
  get link(): SecondLight | null {
    const { secondAppearance: appearance } = this.viewer;
    if (this.wish || appearance === null) return this.wish;
    return { appearance, percent: 100 * this.split.share };
  }

  // The second appearance of the link beside the first one, which stays what it is.
  private async grant({ appearance, percent }: SecondLight) {
    this.wish = null;
    if (!this.viewer.computesColours) return toast(text("appearance.second.none"));
    this.split.share = percent / 100;
    await this.split.show(appearance);
    this.to.value = this.split.open ? appearance : "";
    this.tellSplit();
  }

  translate() {
    this.strip.translate();
    if (this.list.length) this.fillLists();
  }

  // ---- the lists ----

  private begin() {
    this.listed = "";
    element("appearance").hidden = !this.viewer.scene?.appearances;
    this.fillSoon();
  }

  // Photographs are asked for when the first picture is there: it comes before everything else. Again
  // when the server came back with another revision, and after a while when there was no answer.
  private fillSoon() {
    const { viewer } = this;
    const wanted = `${viewer.scene?.id} ${viewer.info?.revision}`;
    if (!viewer.hasPicture || wanted === this.listed) return;
    this.listed = wanted;
    clearTimeout(this.again);
    void this.fill(wanted).catch(() => {
      this.again = window.setTimeout(() => {
        this.listed = "";
        this.fillSoon();
      }, AGAIN_MS);
    });
  }

  private async fill(wanted: string) {
    const list = await this.viewer.appearances();
    if (wanted !== this.listed) return;
    this.list = list;
    this.names = list.map((one) => one.name);
    element("appearance").hidden = list.length === 0;
    const here = list.some((one) => one.place);
    element("appearance-here").hidden = !here;
    element("photos-button").hidden = !list.some((one) => one.thumbnail);
    element("appearance-split").hidden = !this.viewer.computesColours;
    this.fillLists();
    this.onList();
    if (this.wish) await this.grant(this.wish);
  }

  private fillLists() {
    const photographs = this.list.filter((one) => one.name !== NAME_DEFAULT);
    const both = photographs.filter((one) => !one.name.includes(","));
    const chosen = [this.from.value, this.to.value] as const;
    this.from.replaceChildren(
      new Option(text("appearance.all"), NAME_DEFAULT),
      ...options(photographs),
    );
    this.to.replaceChildren(new Option(text("appearance.none"), ""), ...options(both));
    [this.from, this.to].forEach((select, k) => {
      if ([...select.options].some((one) => one.value === chosen[k])) select.value = chosen[k]!;
    });
    this.strip.photographs = both;
    this.choose();
  }

  // ---- choosing ----

  // The controls say what is wanted.
  private choose() {
    const choice = this.split.open ? null : parseAppearance(this.viewer.state.wanted, this.names);
    if (choice && !(choice.from === this.to.value && !choice.to && this.mix.value === "100")) {
      this.from.value = choice.from;
      if (choice.to || this.mix.value !== "0") this.to.value = choice.to;
      if (choice.to) this.mix.value = String(choice.percent);
    }
    this.showEnds();
  }

  private showEnds() {
    const { to, from, mix } = this;
    mix.hidden = !to.value || this.split.open;
    element<HTMLButtonElement>("appearance-split").disabled = !to.value;
    const second = element<HTMLInputElement>("photos-second").checked;
    this.strip.choose((second ? to : from).value);
  }

  private apply(waitMs: number) {
    if (this.split.open && !this.to.value) void this.showSplit(false);
    this.showEnds();
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.send(), waitMs);
  }

  private async send() {
    const { from, to, mix } = this;
    const choice = { from: from.value, to: to.value, percent: Number(mix.value) };
    if (!this.split.open) return this.viewer.setAppearance(formatAppearance(choice));
    await this.viewer.setAppearance(formatAppearance({ ...choice, to: "" }));
    await this.split.show(choice.to);
  }

  private async showSplit(open: boolean) {
    await this.split.show(open ? this.to.value : null);
    this.tellSplit();
    if (this.split.open === open) await this.send();
  }

  private tellSplit() {
    this.split.update();
    element("appearance-split").setAttribute("aria-pressed", String(this.split.open));
    this.showEnds();
    this.onChange();
  }

  private chooseHere() {
    const { viewer } = this;
    const name = nearestPhotograph(this.list, viewer.pose, viewer.heightAboveGround);
    if (!name) return;
    this.from.value = name;
    if (!this.split.open) this.to.value = "";
    toast(text("appearance.here.done", { name }));
    this.apply(0);
  }

  private tell() {
    const { appearance, wanted } = this.viewer.state;
    const changing = appearance !== wanted && this.names.length > 0;
    setText("appearance-text", changing ? text("appearance.changing") : "");
  }
}
