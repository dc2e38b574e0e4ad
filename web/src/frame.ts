// What <city-splat> shows around the picture: a bar of progress, closer, farther and home, what is wrong in words with a
// button, and how to move where the page around scrolls.
//
// SPDX-License-Identifier: Apache-2.0
import { text } from "./strings";
import type { Viewer } from "./viewer";

export const FRAME_STYLE =
  "nav{position:absolute;top:8px;right:8px;display:grid;gap:4px}nav button,section button{min-width:36px;min-height:36px;padding:0 10px;border:0;border-radius:8px;" +
  "background:rgb(8 11 16/72%);color:#fff;font:18px/1 system-ui,sans-serif;cursor:pointer}@media(pointer:coarse){nav button,section button{min-width:44px;min-height:44px}}" +
  "section{position:absolute;left:50%;top:50%;transform:translate(-50%,-50%);box-sizing:border-box;width:max-content;max-width:min(420px,100% - 24px);max-height:100%;overflow:auto;padding:12px 16px;" +
  "border-radius:10px;background:rgb(8 11 16/88%);color:#fff;font:14px/1.45 system-ui,sans-serif;overflow-wrap:anywhere}section button{background:rgb(255 255 255/18%);font-size:14px;margin-top:8px;display:block}" +
  "section.low{top:auto;bottom:26px;transform:translate(-50%,0)}" +
  "i{position:absolute;left:0;top:0;height:3px;background:#6cc7ff;transition:width .2s}" +
  "output{position:absolute;inset:0;display:grid;place-items:center;padding:16px;text-align:center;background:rgb(8 11 16/55%);color:#fff;font:18px/1.4 system-ui,sans-serif;opacity:0;transition:opacity .3s;pointer-events:none}" +
  "output.on{opacity:1}@media(prefers-reduced-motion:reduce){i,output{transition:none}}nav[hidden],section[hidden],i[hidden]{display:none}" +
  "button:focus-visible,:host div [tabindex]:focus-visible{outline:2px solid #6cc7ff;outline-offset:-2px}";

const HINT_MS = 1500;
const ABOUT = ["problem", "link", "sight"] as const;
type About = (typeof ABOUT)[number];
const MAC = typeof navigator === "object" && /Mac|iPhone|iPad/.test(navigator.platform);

export class ElementFrame {
  readonly nodes: HTMLElement[];
  private readonly bar = document.createElement("i");
  private readonly tools = document.createElement("nav");
  private readonly said = document.createElement("section");
  private readonly hint = document.createElement("output");
  private readonly told = new Map<About, { words: string; label: string; run: () => void }>(); // what is wrong now
  private timer = 0;
  private viewer: Viewer | null = null;

  constructor() {
    const { bar, tools, said, hint } = this;
    bar.setAttribute("role", "progressbar");
    bar.setAttribute("aria-label", text("loading"));
    bar.hidden = said.hidden = true;
    said.setAttribute("role", "alert");
    tools.setAttribute("aria-label", text("tools.label"));
    tools.append(
      button("+", text("tool.in"), () => this.viewer?.stage.zoom(0.7)),
      button("−", text("tool.out"), () => this.viewer?.stage.zoom(1 / 0.7)),
      button("⌂", text("tool.home"), () => this.viewer?.home()),
    );
    this.nodes = [bar, hint, tools, said];
  }

  // Of this viewer from here on.
  serve(viewer: Viewer, host: HTMLElement) {
    this.viewer = viewer;
    this.told.clear();
    this.say();
    const { stage } = viewer;
    stage.shares = () => scrolls(host);
    stage.onHeld = (wheel) => this.tellHow(wheel);
    viewer.on("turn", () => this.fill(viewer));
    viewer.on("scene", () => this.unsay("problem"));
    viewer.on("picture", () => this.unsay("problem"));
    viewer.on("link", (link) => {
      if (link !== "away") this.unsay("link");
      else if (viewer.scene) this.tell("link", text("banner.away"), text("banner.away.now"), () => viewer.retry());
    });
    viewer.on("sight", (sight) => (sight ? this.unsay("sight") : this.tell("sight", text("banner.lost"), text("tool.home"), () => viewer.home())));
    viewer.on("problem", (problem) => {
      if (!viewer.scene || problem.kind === "nothingDraws") this.tell("problem", problem.message, text("problem.retry"), () => viewer.retry());
    });
  }

  private fill(viewer: Viewer) {
    const { progress, link } = viewer.state;
    this.bar.hidden = !progress || link === "away";
    if (!progress) return;
    const { done, total } = progress;
    this.bar.style.width = total ? `${Math.round((100 * done) / total)}%` : "15%";
    this.bar.setAttribute("aria-valuemax", String(total || 1));
    this.bar.setAttribute("aria-valuenow", String(total ? done : 0));
  }

  private tell(about: About, words: string, label: string, run: () => void) {
    this.told.set(about, { words, label, run });
    this.say();
  }

  private unsay(about: About) {
    this.told.delete(about);
    this.say();
  }

  // The weightiest thing that is wrong: in the middle where nothing is to be seen, else below it.
  private say() {
    const about = ABOUT.find((one) => this.told.has(one));
    const one = about && this.told.get(about);
    this.said.hidden = !one;
    this.said.className = this.viewer?.scene ? "low" : "";
    this.tools.hidden = Boolean(one) && !this.viewer?.scene; // they would lie below the words, and nothing is there to move
    this.said.replaceChildren(one?.words ?? "");
    if (!one) return;
    this.said.append(
      button(one.label, "", () => {
        if (this.viewer?.state.link !== "away") this.unsay(about!); // else it stays until the server answers
        one.run();
      }),
    );
  }

  private tellHow(wheel: boolean) {
    this.hint.textContent = text(wheel ? (MAC ? "gestures.mac" : "gestures.wheel") : "gestures.touch");
    this.hint.className = "on";
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => (this.hint.className = ""), HINT_MS);
  }
}

function button(sign: string, name: string, run: () => void): HTMLButtonElement {
  const one = document.createElement("button");
  one.type = "button"; // not of a form around the element
  one.textContent = sign;
  if (name) one.title = name;
  if (name) one.setAttribute("aria-label", name);
  one.addEventListener("click", run);
  return one;
}

// Something around it can be scrolled: then a bare wheel and one finger are for that.
function scrolls(host: HTMLElement): boolean {
  if (document.fullscreenElement) return false;
  const long = (node: Element) => node.scrollHeight > node.clientHeight + 1;
  const way = (node: Element) => getComputedStyle(node).overflowY;
  const { documentElement: page, body } = document;
  // What the page has not said, its body says for it.
  const said = way(page) === "visible" ? way(body) : way(page);
  if (long(page) && said !== "hidden" && said !== "clip") return true;
  for (let node = host.parentElement; node && node !== page; node = node.parentElement)
    if (long(node) && /auto|scroll/.test(way(node))) return true;
  return false;
}
