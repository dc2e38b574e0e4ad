// What the page says about itself: banners, the problem box, the numbers. Nothing here covers the
// picture or takes the keys.
//
// SPDX-License-Identifier: Apache-2.0
import { element, setText, toast } from "./dom";
import { Problem } from "./problem";
import { sceneCard } from "./scenecard";
import { getLanguage, text } from "./strings";
import type { Progress, Viewer, ViewerState } from "./viewer";

const NUMBERS_EVERY_MS = 150;
const LINE_AFTER_MS = 400; // a wait shorter than this is not worth a line
const SAY_AFTER_MS = 2000;
const SAY_EVERY_MS = 10_000;
const AWAY_AFTER_MS = 300; // a hiccup shorter than this is not worth a banner

export interface BannerButton {
  label: string;
  run: () => void;
}

// One banner a kind; the same kind again changes its text.
export function banner(kind: string, value: string, buttons: BannerButton[] = [], wait = false) {
  const id = `banner-${kind}`;
  let box = document.getElementById(id);
  if (!box) {
    box = document.createElement("div");
    box.id = id;
    box.append(document.createElement("p"));
    element("banners").append(box);
  }
  box.className = wait ? "banner wait" : "banner";
  const line = box.querySelector("p")!;
  if (line.textContent !== value) line.textContent = value;
  for (const old of box.querySelectorAll("button")) old.remove();
  for (const { label, run } of buttons) {
    const button = document.createElement("button");
    button.textContent = label;
    button.onclick = () => {
      unbanner(kind);
      run();
    };
    box.append(button);
  }
}

export function unbanner(kind: string) {
  document.getElementById(`banner-${kind}`)?.remove();
}

function short(n: number): string {
  const whole = new Intl.NumberFormat(getLanguage());
  if (n >= 999_500) return `${(n / 1e6).toFixed(2)} M`;
  return n >= 10_000 ? `${Math.round(n / 1e3)} k` : whole.format(n);
}

function megabytes(n: number): string {
  return `${(n / 1e6).toFixed(n < 1e7 ? 2 : 1)} MB`;
}

// What the page waits for: a bar and a line for eyes, the bar's value for whoever asks, and few words
// aloud: when it takes long, now and then, and when it is over.
class ProgressLine {
  private since = 0; // 0: nothing is waited for
  private saidAt = 0; // 0: nothing was said yet
  private readonly bar = element("progress");

  show({ progress, link, ready, settled }: ViewerState) {
    const now = performance.now();
    const waits = progress !== null || link === "away";
    if (this.bar.hidden === waits) this.bar.hidden = !waits;
    if (!waits) {
      setText("progress-text", "");
      if (!settled) return; // it is being sorted and drawn
      if (this.saidAt) setText("progress-said", ready ? text("progress.done") : "");
      this.since = this.saidAt = 0;
      return;
    }
    this.since ||= now;
    const line = link === "away" ? text("link.away") : wordsOf(progress!);
    this.bar.setAttribute("aria-valuetext", line);
    this.fill(progress);
    setText("progress-text", link === "away" || now - this.since < LINE_AFTER_MS ? "" : line);
    const due = this.saidAt ? now - this.saidAt > SAY_EVERY_MS : now - this.since > SAY_AFTER_MS;
    if (link === "away") return setText("progress-said", ""); // a banner says that
    if (!due) return;
    this.saidAt = now;
    setText("progress-said", line);
  }

  private fill(progress: Progress | null) {
    const { done = 0, total = 0 } = progress ?? {};
    this.bar.classList.toggle("known", total > 0);
    const span = this.bar.querySelector("span")!;
    span.style.width = total ? `${Math.round((100 * done) / total)}%` : "";
    if (total) {
      this.bar.setAttribute("aria-valuemax", String(total));
      this.bar.setAttribute("aria-valuenow", String(done));
    } else this.bar.removeAttribute("aria-valuenow");
  }
}

function wordsOf({ phase, done, total, bytes }: Progress): string {
  const size = bytes >= 10_000 ? ` · ${megabytes(bytes)}` : "";
  const words = total && phase === "appearance" ? "appearanceTiles" : phase;
  return text(`progress.${words}`, { done, total }) + size;
}

export class Status {
  private timer = 0;
  private awayTimer = 0;
  private readonly progress = new ProgressLine();
  private readonly closed = new Set<string>(); // banners that the person closed

  constructor(private readonly viewer: Viewer) {
    viewer.on("problem", (error) => this.showProblem(error));
    viewer.on("link", () => this.tellLink());
    viewer.on("context", (lost) => {
      if (lost) banner("context", text("banner.context"), [], true);
      else unbanner("context");
    });
    viewer.on("scene", () => {
      this.hideProblem();
      this.closed.clear();
      for (const kind of ["memory", "broken"]) unbanner(kind);
    });
    viewer.on("picture", () => this.hideProblem());
    viewer.on("turn", () => this.soon());
    element("statistics").addEventListener("toggle", () => this.soon());
    this.soon();
    element("problem-retry").addEventListener("click", () => {
      this.hideProblem();
      viewer.retry();
    });
  }

  // Not for every turn of the viewer's loop, and once more after its last.
  private soon() {
    this.timer ||= window.setTimeout(() => {
      this.timer = 0;
      const { state } = this.viewer;
      this.show(state);
      const waits = state.progress !== null || state.link !== "ok" || !state.settled;
      if (waits || state.framesPerSecond) this.soon();
    }, NUMBERS_EVERY_MS);
  }

  private tellLink() {
    clearTimeout(this.awayTimer);
    const { link } = this.viewer.state;
    if (link === "away") {
      this.awayTimer = window.setTimeout(
        () => banner("link", text("banner.away"), [{ label: text("banner.away.now"), run: () => this.tryNow() }], true),
        AWAY_AFTER_MS,
      );
    } else if (link === "busy") banner("link", text("banner.busy"), [], true);
    else if (document.getElementById("banner-link")) {
      banner("link", text("banner.back"));
      this.awayTimer = window.setTimeout(() => unbanner("link"), 4000);
    }
  }

  // The banner stays until the server answers.
  private tryNow() {
    this.viewer.retry();
    this.tellLink();
  }

  private showProblem(error: Error) {
    const kind = error instanceof Problem ? error.kind : null;
    if (kind === "no3d" || kind === "noVideo") return toast(error.message); // the server's pictures come
    if (kind === "noAnswer") return; // a banner says that
    if (kind === "noAppearance" || kind === "badBasemap") // the city is shown all the same
      return banner("notice", error.message, [{ label: text("banner.close"), run: () => {} }]);
    // Of a link to a scene that is not there: those that are.
    const others = kind === "noScene" ? this.viewer.scenes : [];
    element("problem-scenes").replaceChildren(...others.map((scene) => sceneCard(scene, () => void this.viewer.openScene(scene.id))));
    element("problem-title").textContent =
      error instanceof Problem ? error.title : text("problem.other.title");
    element("problem-text").textContent = error.message;
    element("problem").hidden = false;
  }

  private hideProblem() {
    element("problem").hidden = true;
  }

  // A banner that stays while something is so, unless the person closed it.
  private keep(kind: string, value: string | null) {
    if (value === null) {
      unbanner(kind);
      return;
    }
    if (this.closed.has(value) || document.querySelector(`#banner-${kind} p`)?.textContent === value)
      return;
    banner(kind, value, [{ label: text("banner.close"), run: () => this.closed.add(value) }]);
  }

  private show(state: ViewerState) {
    const first = state.broken[0];
    this.keep("broken", first ? text("banner.broken", { name: first.name, why: first.why }) : null);
    this.keep("memory", state.heldBack && state.settled ? text("banner.memory") : null);
    this.progress.show(state);
    if (!element<HTMLDetailsElement>("statistics").open) return;
    setText("stat-gaussians", short(state.gaussians));
    setText("stat-tiles", state.pending ? `${state.tiles} + ${state.pending}` : String(state.tiles));
    setText("stat-bytes", megabytes(state.received));
    setText("stat-memory", megabytes(state.memory));
    setText("stat-fps", state.framesPerSecond ? state.framesPerSecond.toFixed(0) : text("stat.idle"));
    const { computesColours, scene } = this.viewer;
    const by = computesColours ? "splats" : "pictures";
    setText("stat-colours", scene?.appearances ? text(`settings.${by}`) : "–");
    setText("stat-link", text(`link.${state.link}`));
    const names = state.broken.map((one) => `${one.name}: ${one.why}`).join("; ");
    element("stat-broken").hidden = !names;
    setText("stat-broken", names ? `${text("stat.broken")}: ${names}` : "");
  }
}
