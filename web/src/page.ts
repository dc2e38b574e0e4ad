// The page around the viewer: buttons, keys, the address bar, settings.
//
// SPDX-License-Identifier: Apache-2.0
import { Vector3 } from "three";

import {
  formatView,
  parseComparison,
  parseSecondLight,
  parseView,
  writeComparison,
  writeSecondLight,
} from "./address";
import { AppearanceControl } from "./appearance";
import { store, stored, theme } from "./choices";
import { Compare } from "./compare";
import { copy, element, later, setText, toast } from "./dom";
import { freePart } from "./free";
import { LayerPanel } from "./layerpanel";
import { MeasureTool } from "./measure";
import type { EmbedDialog } from "./embeddialog";
import type { ShotDialog } from "./shotdialog";
import type { Walk } from "./pose";
import { Problem } from "./problem";
import { sceneCard } from "./scenecard";
import { isForScene } from "./stage";
import { banner, Status, unbanner } from "./status";
import { getLanguage, setLanguage, text, translate } from "./strings";
import { TOUCH } from "./touch";
import { compass, formatDays, formatPlace } from "./units";
import type { Mode, Viewer } from "./viewer";

// The slider position at which a typical Gaussian is one pixel. Touch screens begin with a step less. The size of the window
// does not count: fewer pixels already ask for fewer Gaussians.
const DETAIL_MIDDLE = 4;
const ADDRESS_MS = 300; // browsers refuse an address that changes too often

export class Page {
  private readonly appearance: AppearanceControl;
  private readonly compare: Compare;
  private readonly layers: LayerPanel;
  private readonly measure: MeasureTool;
  private shots: ShotDialog | null = null;
  private embeds: EmbedDialog | null = null;
  private addressTimer = 0;
  private offered = false;
  private problem: Error | null = null; // why no scene is open
  private used = false; // somebody has pressed, turned or typed something since the scene opened

  constructor(private readonly viewer: Viewer) {
    new Status(viewer);
    const query = new URLSearchParams(location.search);
    this.appearance = new AppearanceControl(viewer, parseSecondLight(query));
    this.appearance.onChange = () => this.address();
    this.appearance.onList = () => this.frame();
    this.layers = new LayerPanel(viewer);
    this.compare = new Compare(viewer, parseComparison(query));
    this.compare.onChange = () => this.address();
    this.measure = new MeasureTool(viewer);
    viewer.surface.setAttribute("role", "application");
    viewer.surface.dataset["tLabel"] = "surface.label";
    this.wireTools();
    this.wireSettings();
    this.wireKeys();
    this.wireViewer();
    this.translate();
    const use = () => (this.used = true);
    for (const name of ["pointerdown", "keydown", "wheel"]) window.addEventListener(name, use, { capture: true, passive: true });
    viewer.fitInto(freePart);
    this.showMode(viewer.mode);
  }

  // Home again in what is free, where the panels got what they show after the city came; not under somebody's hands.
  private frame() {
    if (!this.used) this.viewer.fitInto(freePart);
  }

  private translate() {
    document.documentElement.lang = getLanguage();
    translate(document);
    this.appearance.translate();
    this.layers.translate();
    this.compare.fill();
    this.applyDetail();
    this.nameWalk(this.viewer.stage.walk);
    this.showTitle();
    this.showFacts();
    this.showPlace();
  }

  private wireViewer() {
    const { viewer } = this;
    viewer.on("scene", (scene) => {
      this.problem = null;
      this.used = false;
      this.showTitle();
      setText("attribution", [viewer.info?.attribution, viewer.basemapCredit].filter(Boolean).join(" · "));
      this.fillChooser();
      this.showFacts();
      // viewer.js is where a server serves this page.
      element("embed-button").hidden = !scene.catalogue;
      this.showPlace();
      this.frame();
      this.address();
    });
    viewer.on("move", () => {
      this.showPlace();
      this.address();
    });
    viewer.on("appearance", () => this.address());
    viewer.on("layers", () => this.address());
    viewer.on("mode", (mode) => this.showMode(mode));
    viewer.on("problem", (problem) => {
      this.problem = problem;
      this.showTitle();
    });
    viewer.on("link", (link) => {
      if (link === "ok") this.problem = null; // it is asked again
      this.showTitle();
    });
    viewer.on("slow", (fps) => void this.offer(fps));
    viewer.on("walk", (how) => this.showWalk(how));
    const bare = viewer.on("turn", () => {
      if (viewer.hasPoster) return;
      document.documentElement.style.removeProperty("--poster");
      bare();
    });
    viewer.on("sight", (sight) => {
      if (sight) unbanner("lost");
      else banner("lost", text("banner.lost"), [{ label: text("tool.home"), run: () => this.home() }]);
    });
  }

  // What is open, or why nothing is.
  private showTitle() {
    const { scene } = this.viewer;
    const { problem } = this;
    const failed = problem instanceof Problem ? problem.title : text("problem.other.title");
    const title = scene?.title ?? (problem ? failed : text("loading"));
    setText("title", title);
    document.title = `${title} – citysplat`;
  }

  // Where it is, when it was photographed or made, and whose it is.
  private showFacts() {
    const { scene, info, stage } = this.viewer;
    if (!scene) return setText("facts", "");
    const middle = stage.frame.placeOf(stage.extent.getCenter(new Vector3()));
    const days = scene.taken ? formatDays(...scene.taken) : formatDays(scene.created);
    const lines = [
      text("facts.place", { lat: middle.lat.toFixed(3), lon: middle.lon.toFixed(3) }),
      days && text(scene.taken ? "facts.taken" : "facts.made", { days }),
      info?.attribution,
    ];
    setText("facts", lines.filter(Boolean).join("\n"));
  }

  private fillChooser() {
    const { scenes, scene } = this.viewer;
    element("scene-list").replaceChildren(...scenes.map((one) => sceneCard(one, () => void this.viewer.openScene(one.id))));
    element("scenes-box").hidden = scenes.length < 2;
    const select = element<HTMLSelectElement>("dataset");
    select.replaceChildren(...scenes.map((one) => new Option(one.title, one.id, false, one === scene)));
    select.onchange = () => void this.viewer.openScene(select.value);
    element("chooser").hidden = scenes.length < 2;
  }

  private showPlace() {
    const { pose, scene } = this.viewer;
    element("north").querySelector("svg")!.style.transform = `rotate(${-pose.heading}deg)`;
    setText("where", scene ? formatPlace(pose, scene.heights, 5) : "");
    setText("bearing", scene ? ` · ${compass(pose.heading)}` : "");
  }

  // ---- slow machines ----

  private async offer(fps: number) {
    if (this.offered || this.viewer.mode === "pictures") return;
    this.offered = true;
    if (!(await this.viewer.canDrawPictures())) return;
    banner("slow", text("banner.slow", { fps: fps.toFixed(fps < 3 ? 1 : 0) }), [
      { label: text("banner.slow.yes"), run: () => this.viewer.setMode("pictures") },
      { label: text("banner.slow.no"), run: () => {} },
    ]);
  }

  private showMode(mode: Mode) {
    element<HTMLSelectElement>("mode").value = mode;
    element("detail-field").hidden = mode === "pictures";
    if (mode === "pictures" && this.offered) banner("drawn", text("banner.drawn"), [{ label: text("banner.drawn.no"), run: () => this.viewer.setMode("splats") }]);
    else unbanner("drawn");
    element<HTMLButtonElement>("server-button").disabled = mode === "pictures";
    if (mode === "pictures") unbanner("slow");
    this.address();
  }

  // ---- the address bar ----

  private url(): URL {
    const { viewer } = this;
    const url = new URL(location.href);
    for (const old of ["ds", "light", "overlay"]) url.searchParams.delete(old);
    if (viewer.scene && viewer.scenes.length > 1) url.searchParams.set("scene", viewer.scene.id);
    for (const layer of this.layers.links) url.searchParams.append("overlay", layer);
    writeComparison(url.searchParams, this.compare.link);
    writeSecondLight(url.searchParams, this.appearance.link);
    if (viewer.scene) url.hash = formatView({ pose: viewer.pose, appearance: viewer.state.wanted });
    return url;
  }

  private address(ms = ADDRESS_MS) {
    clearTimeout(this.addressTimer);
    this.addressTimer = window.setTimeout(() => {
      if (!this.viewer.scene) return;
      history.replaceState(null, "", this.url());
    }, ms);
  }

  private async share() {
    const url = this.url().href;
    history.replaceState(null, "", url);
    // Phones have a sheet for it. Closed without a choice, it rejects.
    if (TOUCH && navigator.canShare?.({ url })) await navigator.share({ title: document.title, url }).catch(() => {});
    else await copy(url, text("share.done"));
  }

  private async shot() {
    if (!this.viewer.scene) return;
    const module = await later(import("./shotdialog"));
    if (!module) return;
    this.shots ??= new module.ShotDialog(this.viewer);
    this.shots.open();
  }

  private async embed() {
    if (!this.viewer.scene) return;
    const module = await later(import("./embeddialog"));
    if (!module) return;
    this.embeds ??= new module.EmbedDialog(this.viewer);
    this.embeds.open();
  }

  // ---- controls ----

  private wireTools() {
    const { viewer } = this;
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    click("north", () => viewer.stage.northUp());
    click("home", () => this.home());
    click("zoom-in", () => viewer.stage.zoom(0.7));
    click("zoom-out", () => viewer.stage.zoom(1 / 0.7));
    click("walk", () => void this.nextWalk());
    click("walk-end", () => this.leaveWalk());
    this.nameWalk("orbit");
    click("help-button", () => this.help());
    // What these show is the picture.
    for (const id of ["photos-button", "appearance-here", "appearance-split", "server-button", "measure-button"]) click(id, () => this.clear());
    for (const id of ["appearance-from", "appearance-to"]) element(id).addEventListener("change", () => this.clear());
    click("share", () => void this.share());
    click("embed-button", () => void this.embed());
    click("shot-button", () => void this.shot());
    element("full").hidden = !document.fullscreenEnabled;
    click("full", () => void (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()));
    click("fold", () => this.fold(!element("panel").classList.contains("folded")));
    this.fold(this.isSmall);
  }

  private fold(folded: boolean) {
    element("panel").classList.toggle("folded", folded);
    const button = element("fold");
    const label = button.querySelector<HTMLElement>(".sr")!;
    button.setAttribute("aria-expanded", String(!folded));
    label.dataset["t"] = folded ? "panel.show" : "panel.hide";
    label.textContent = button.title = text(folded ? "panel.show" : "panel.hide");
    this.viewer.overlay.onWake(); // notes that lay below it
  }

  private get isSmall(): boolean {
    return TOUCH || innerWidth < 700 || innerHeight < 480;
  }

  // The picture is what counts now: on a small screen the panel makes way.
  private clear() {
    if (this.isSmall) this.fold(true);
  }

  private home() {
    this.clear();
    this.viewer.home();
  }

  private help() {
    element("help-p").hidden = element("photos-button").hidden;
    element("help-v").hidden = element("server-button").hidden;
    element<HTMLDialogElement>("help").showModal();
  }

  // ---- on foot ----

  private async nextWalk() {
    const kinds: Walk[] = ["orbit", "fly", "walk"];
    const { stage } = this.viewer;
    const next = kinds[(kinds.indexOf(stage.walk) + 1) % 3]!;
    this.clear();
    if (next === "walk" && !stage.walker) {
      const module = await later(import("./walk"));
      if (!module) return;
      stage.walker = new module.Walker(() => this.viewer.blocks);
    }
    if (next !== "walk") {
      stage.walk = next;
      return;
    }
    if (await stage.toStreet(stage.center())) return;
    stage.walk = "orbit";
    toast(text(this.viewer.mode === "pictures" ? "walk.pictures" : "walk.none"));
  }

  private leaveWalk() {
    this.viewer.stage.walk = "orbit";
    element("walk").focus();
  }

  private showWalk(how: Walk) {
    element("walk-card").hidden = how === "orbit";
    setText("walk-text", how === "orbit" ? "" : text(`walk.${how}`));
    this.nameWalk(how);
  }

  private nameWalk(how: Walk) {
    const button = element("walk");
    button.dataset["walk"] = how;
    button.setAttribute("aria-pressed", String(how !== "orbit"));
    button.querySelector(".sr")!.textContent = text(`walk.${how}.name`);
    button.title = `${text(`walk.${how}.name`)} (G)`;
  }

  // A step of the slider is a factor of two.
  private applyDetail() {
    const slider = element<HTMLInputElement>("detail");
    const px = 2 ** (DETAIL_MIDDLE - Number(slider.value));
    const size = text("detail.value", { px: Number(px.toPrecision(2)) });
    slider.setAttribute("aria-valuetext", size);
    setText("detail-value", size);
    this.viewer.detail = px;
  }

  private wireSettings() {
    const { viewer } = this;
    const detail = element<HTMLInputElement>("detail");
    detail.value = String(TOUCH ? DETAIL_MIDDLE - 1 : DETAIL_MIDDLE);
    detail.addEventListener("input", () => this.applyDetail());
    const select = (id: string, value: string, run: (value: string) => void) => {
      const field = element<HTMLSelectElement>(id);
      field.value = value;
      field.addEventListener("change", () => run(field.value));
    };
    select("mode", viewer.mode, (value) => viewer.setMode(value as Mode));
    select("theme", theme(), (value) => {
      store("theme", value);
      document.documentElement.dataset["theme"] = value;
    });
    select("language", getLanguage(), (value) => {
      store("language", value);
      void setLanguage(value).then(() => this.translate());
    });
    const developer = element<HTMLInputElement>("developer");
    const show = () => {
      for (const node of document.querySelectorAll<HTMLElement>("[data-developer]")) node.hidden = !developer.checked;
      this.compare.developer = developer.checked;
      this.compare.fill();
    };
    developer.checked = new URLSearchParams(location.search).has("developer") || stored("developer") === "yes";
    developer.addEventListener("change", () => {
      store("developer", developer.checked ? "yes" : "no");
      show();
    });
    show();
    const backdrop = element<HTMLInputElement>("backdrop");
    backdrop.addEventListener("change", () => (viewer.backdrop = backdrop.checked));
  }

  private wireKeys() {
    const { viewer } = this;
    const shortcuts: Record<string, () => void> = {
      KeyN: () => viewer.stage.northUp(),
      KeyH: () => this.home(),
      Home: () => this.home(),
      KeyG: () => void this.nextWalk(),
      KeyM: () => {
        this.clear();
        this.measure.show(!this.measure.open);
      },
      KeyP: () => this.appearance.showPhotographs(!this.appearance.photographsOpen) || toast(text("photos.none")),
      KeyV: () => (element("server-button").hidden ? toast(text("compare.nothing")) : this.compare.show(!this.compare.open)),
      KeyX: () => (this.compare.open ? this.compare.swap() : toast(text("compare.closed"))),
      KeyI: () => void this.shot(),
      KeyL: () => void this.share(),
      Escape: () => {
        if (this.measure.open) this.measure.show(false);
        else if (viewer.stage.walk !== "orbit") this.leaveWalk();
      },
    };
    window.addEventListener("keydown", (event) => {
      if (!isForScene(event)) return;
      if (event.key === "?") return this.help();
      const run = shortcuts[event.code];
      if (run && !viewer.scene && event.code !== "Escape") toast(viewer.state.error ?? text("loading"));
      else run?.();
    });
    window.addEventListener("hashchange", () => {
      const view = parseView(location.hash);
      if (!view) return;
      viewer.lookAt(view.pose);
      void viewer.setAppearance(view.appearance);
    });
  }
}
