// Which scene is open and in which light: its documents are asked for, opened, and renewed after the
// server was away. What is shown meanwhile is a matter of the viewer.
//
// SPDX-License-Identifier: Apache-2.0
import type { City } from "./city";
import type { Pose } from "./geo";
import { isGone, type Link } from "./link";
import type { Network } from "./network";
import { Problem } from "./problem";
import { findFirst, findScenes, openScene, type SceneEntry, type SceneInfo } from "./source";
import { Tint } from "./tint";
import type { ViewerOptions } from "./types";

// How a scene is opened.
export interface Opened {
  pose: Pose | null; // to begin with
  same: boolean; // it was open before
  keep: boolean; // what is drawn stays until the new one is complete: another light
}

// What opening asks of the viewer.
export interface SceneHost {
  closed(): boolean;
  city(): City | null;
  shown(): string; // the appearance on the screen
  show(entry: SceneEntry, info: SceneInfo, how: Opened): void;
  renew(info: SceneInfo): void; // the same scene of another revision
  recolour(appearance: string, change: () => void): void; // computed here
  split(share: number | null): void;
  fail(error: unknown): void;
  tell(problem: Problem): void; // what is shown goes on
  clearProblem(): void;
}

async function makeTint({ network }: SceneInfo, appearance: string): Promise<Tint | null> {
  if (!network) return null;
  const tint = new Tint(network);
  tint.set(await network.find(appearance), appearance);
  return tint;
}

export class Scenes {
  all: SceneEntry[] = [];
  entry: SceneEntry | null = null;
  info: SceneInfo | null = null;
  tint: Tint | null = null; // computes the colours; null where the server does
  appearance: string; // that is wanted
  private second: string | null = null; // right of the line, wanted
  private ticket = 0;
  private describing = 0; // scenes whose documents are on their way

  constructor(
    private readonly host: SceneHost,
    private readonly link: Link,
    private readonly options: ViewerOptions,
  ) {
    this.appearance = options.appearance ?? "";
  }

  // Documents of a scene are on their way.
  get busy(): boolean {
    return this.describing > 0;
  }

  // Where it asks first, and where then.
  get urls(): URL[] {
    return [this.options.url ?? "./"].flat().map((one) => new URL(one, location.href));
  }

  async start() {
    const { link, options, urls } = this;
    const { scene: id } = options;
    try {
      link.watch(urls.length === 1 && /\.json$/.test(urls[0]!.pathname) ? urls[0]! : new URL("collections", urls[0]));
      this.all = urls.length > 1 ? await findFirst(link, urls) : await findScenes(link, urls[0]!);
      const entry = id === undefined ? this.all[0] : this.all.find((one) => one.id === id);
      if (!entry) throw new Problem(id === undefined ? "noScenes" : "noScene", { id: id ?? "" });
      await this.open(entry, options.pose ?? null, false);
    } catch (error) {
      this.host.fail(error);
    }
  }

  async open(entry: SceneEntry, pose: Pose | null, keep: boolean) {
    const { host } = this;
    const ticket = ++this.ticket;
    host.clearProblem();
    let info: SceneInfo;
    let tint: Tint | null;
    this.describing++;
    try {
      [info, tint] = await (keep ? this.read(entry) : this.readAnyhow(entry, ticket));
    } catch (error) {
      if (keep) this.refuse(error, ticket);
      else if (ticket === this.ticket) host.fail(error);
      return;
    } finally {
      this.describing--;
    }
    if (ticket !== this.ticket || host.closed()) return;
    this.tint = tint;
    this.second = null;
    host.split(null);
    this.info = info;
    this.link.watch(entry.tileset);
    const same = this.entry === entry;
    this.entry = entry;
    host.show(entry, info, { pose, same, keep });
  }

  private async read(entry: SceneEntry): Promise<[SceneInfo, Tint | null]> {
    const info = await this.describe(entry);
    return [info, await makeTint(info, this.appearance)];
  }

  // A scene that was trained again may lack the light of an older link: then it opens in its default light.
  private async readAnyhow(entry: SceneEntry, ticket: number): Promise<[SceneInfo, Tint | null]> {
    const name = this.appearance;
    try {
      return await this.read(entry);
    } catch (error) {
      if (!name || !isGone(error) || ticket !== this.ticket) throw error;
      this.appearance = "";
      const both = await this.read(entry);
      this.host.tell(new Problem("noAppearance", { name }));
      return both;
    }
  }

  private describe(entry: SceneEntry): Promise<SceneInfo> {
    const city = this.host.city();
    const here = city && this.options.colours !== "server";
    const compute = here ? (network: Network) => city.canTint(network) : null;
    return openScene(this.link, entry, this.appearance, compute);
  }

  // ---- light ----

  async setAppearance(appearance: string): Promise<void> {
    const { host, entry, tint } = this;
    if (appearance === this.appearance || !entry) return;
    this.appearance = appearance;
    if (!tint) return this.open(entry, null, true);
    const ticket = ++this.ticket;
    host.clearProblem();
    try {
      const image = await tint.network.find(appearance);
      if (ticket !== this.ticket || tint !== this.tint || host.closed()) return;
      host.recolour(appearance, () => tint.set(image, appearance));
    } catch (error) {
      if (tint === this.tint) this.refuse(error, ticket);
    }
  }

  private refuse(error: unknown, ticket: number) {
    if (ticket !== this.ticket || this.host.closed()) return;
    const wanted = this.appearance;
    this.appearance = this.host.shown();
    this.failOrTell(error, wanted);
  }

  private failOrTell(error: unknown, name: string) {
    if (isGone(error)) this.host.tell(new Problem("noAppearance", { name }));
    else this.host.fail(error);
  }

  async setSecond(appearance: string | null, share: number): Promise<void> {
    const { host, tint } = this;
    if (!tint) return;
    this.second = appearance;
    host.clearProblem();
    const late = () => tint !== this.tint || appearance !== this.second || host.closed();
    try {
      const image = appearance === null ? null : await tint.network.find(appearance);
      if (late()) return;
      tint.setSecond(image, appearance);
      host.split(image ? share : null);
    } catch (error) {
      if (late()) return;
      this.second = tint.names[1];
      this.failOrTell(error, appearance ?? "");
    }
  }

  // ---- after the server was away ----

  // Where it came back with another revision, the tiles of the old one are gone: opened anew, with the
  // picture kept.
  async comeBack() {
    const { host, entry: scene, info } = this;
    if (!scene || !info) return;
    try {
      const next = await this.renew(scene, info.revision);
      if (!next || this.info !== info || host.closed()) return;
      const { fresh, tint, entry, all } = next;
      [this.all, this.entry, this.info, this.tint] = [all, entry, fresh, tint];
      this.second = tint?.names[1] ?? null; // null where the new revision has not that photograph
      if (this.second === null) host.split(null);
      host.renew(fresh);
    } catch {
      // it is gone again, and the link says so
    }
  }

  // The scene as it is now, in the appearances that are wanted when it is there: they may be changed
  // on the way. null: it is of that revision still.
  private async renew(scene: SceneEntry, revision: string) {
    for (;;) {
      const { appearance: first, second } = this;
      const fresh = await this.describe(scene);
      if (fresh.revision === revision) return null;
      const tint = await makeTint(fresh, first);
      const image = second === null ? null : await fresh.network?.find(second).catch(() => null);
      tint?.setSecond(image ?? null, second);
      const all = scene.catalogue
        ? await findScenes(this.link, scene.catalogue).catch(() => this.all)
        : this.all;
      const entry = all.find((one) => one.id === scene.id) ?? scene;
      if (first === this.appearance && second === this.second) return { fresh, tint, entry, all };
    }
  }
}
