// The card by which a tour is played in a page of somebody else: words, back, play, on. Its looks are the element's own.
//
// SPDX-License-Identifier: Apache-2.0
import { text } from "./strings";
import type { Tour } from "./tour";

export const TOUR_STYLE =
  "section{position:absolute;left:8px;right:8px;bottom:8px;max-width:420px;margin:auto;display:flex;flex-wrap:wrap;gap:4px 6px;align-items:center;" +
  "box-sizing:border-box;padding:8px 10px;border-radius:10px;background:rgb(8 11 16/82%);color:#fff;font:14px/1.4 system-ui,sans-serif}" +
  "section[hidden]{display:none}p{flex:1 1 130px;margin:0;max-height:4.2em;overflow:auto;overflow-wrap:anywhere}" +
  "small{margin-right:auto;color:#b9c0cb}" +
  "button{min-width:36px;min-height:32px;padding:0 10px;border:0;border-radius:6px;background:rgb(255 255 255/16%);color:inherit;font:inherit;cursor:pointer}" +
  "button:disabled{opacity:.4;cursor:default}@media(pointer:coarse){button{min-width:44px;min-height:44px}}" +
  ".citysplat-label{padding:2px 7px;border-radius:6px;background:rgb(8 11 16/82%);color:#fff;font:12.5px/1.5 system-ui,sans-serif}";

export class TourCard {
  readonly node = document.createElement("section");
  private readonly words = document.createElement("p");
  private readonly where = document.createElement("small");
  private readonly back: HTMLButtonElement;
  private readonly play: HTMLButtonElement;
  private readonly next: HTMLButtonElement;
  private tour: Tour | null = null;

  constructor() {
    const button = (sign: string, run: (tour: Tour) => void) => {
      const one = document.createElement("button");
      one.type = "button"; // not of a form around the element
      one.textContent = sign;
      one.addEventListener("click", () => this.tour && run(this.tour));
      return one;
    };
    this.back = button("‹", (tour) => void tour.step(-1));
    this.play = button("", (tour) => (tour.state.playing ? tour.pause() : void tour.play()));
    this.next = button("›", (tour) => void tour.step(1));
    this.words.setAttribute("role", "status");
    this.node.setAttribute("part", "tour");
    this.node.setAttribute("aria-label", text("tour.label"));
    this.back.setAttribute("aria-label", text("tour.back"));
    this.next.setAttribute("aria-label", text("tour.next"));
    this.node.append(this.words, this.where, this.back, this.play, this.next);
    this.show(null);
  }

  // null: there is none.
  show(tour: Tour | null) {
    this.tour = tour;
    const { at, count, name, playing } = tour?.state ?? { at: 0, count: 0, name: "", playing: false };
    this.node.hidden = count === 0;
    this.words.textContent = name;
    this.where.textContent = count ? text("tour.at", { number: at + 1, count }) : "";
    this.play.textContent = text(playing ? "tour.stop" : "tour.play");
    this.back.disabled = at === 0;
    this.next.disabled = at >= count - 1;
  }
}
