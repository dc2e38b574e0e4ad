// A client of /api as a stranger writes one: types by openapi-typescript, requests by openapi-fetch. api.test.mjs compiles it
// under --strict, sees that it calls every operation, and runs it.
//
// SPDX-License-Identifier: Apache-2.0
import createClient from "openapi-fetch";

import type { components, paths } from "./api";

type Answer = { response: Response; error?: unknown };
type Problem = components["schemas"]["Problem"];

/** Calls every operation; resolves with the status of each, by "METHOD path". */
export async function callAll(baseUrl: string, operators: string, ds: string): Promise<Record<string, number>> {
    // No answer is waited for to its end where it has none (streams), and no redirect is followed.
    const api = createClient<paths>({ baseUrl, redirect: "manual" });
    const desk = createClient<paths>({ baseUrl: operators, redirect: "manual" });
    const statuses: Record<string, number> = {};
    const note = (what: string, { response }: Answer) => void (statuses[what] = response.status);
    const bytes = { parseAs: "arrayBuffer" } as const;
    const text = { parseAs: "text" } as const;
    const stream = { parseAs: "stream" } as const;

    // ---- the service ----
    note("GET /", await api.GET("/"));
    note("GET /viewer-{digest}.js", await api.GET("/viewer-{digest}.js", { params: { path: { digest: "0123456789ab" } }, ...text }));
    const conformance = await api.GET("/conformance");
    conformance.data?.conformsTo.map((one) => one.length);
    note("GET /conformance", conformance);
    const description = await api.GET("/api");
    description.data?.openapi.startsWith("3.0");
    note("GET /api", description);
    note("GET /api.html", await api.GET("/api.html", text));
    note("GET /healthz", await api.GET("/healthz"));
    const ready = await api.GET("/readyz");
    const state: "ok" | "ready" | "degraded" | "empty" | undefined = ready.data?.status;
    if (!state) throw new Error("no state");
    note("GET /readyz", ready);
    note("GET /version", await api.GET("/version"));
    note("GET /metrics", await desk.GET("/metrics", text));
    const reload = await desk.POST("/-/reload");
    reload.data?.failed.map(({ store, why }) => store + why);
    note("POST /-/reload", reload);
    note("GET /signed/{seal}{rest}", await api.GET("/signed/{seal}{rest}", { params: { path: { seal: "a.b", rest: "x" } }, ...text }));
    note("GET /session", await api.GET("/session", text));
    note("POST /session", await api.POST("/session", { body: { token: "none" }, ...text }));
    note("POST /session:end", await api.POST("/session:end", text));

    // ---- datasets ----
    const all = await api.GET("/collections", { params: { query: { bbox: "-180,-90,180,90" } } });
    note("GET /collections", all);
    const one = await api.GET("/collections/{ds}", { params: { path: { ds } } });
    note("GET /collections/{ds}", one);
    const splats = one.data?.splats;
    if (!splats) throw new Error("no dataset");
    const [lon, lat, h] = splats.origin as [number, number, number];
    const heights: string = splats.heights;
    if (!heights) throw new Error("heights above what?");
    note("GET /collections/{ds}/tiles.json", await api.GET("/collections/{ds}/tiles.json", { params: { path: { ds } } }));

    // ---- tiles ----
    const entry = await api.GET("/d/{ds}/tileset.json", { params: { path: { ds }, query: { sh: 0, preset: "preview" } } });
    entry.data?.root.children?.[0]?.content?.uri.toLowerCase();
    note("GET /d/{ds}/tileset.json", entry);
    const list = await api.GET("/d/{ds}/seed.ndjson", { params: { path: { ds }, query: { z: "0-24", f: "spz" } }, ...text });
    note("GET /d/{ds}/seed.ndjson", list);
    const [, rev, z, x, y] = /r\/([^/]+)\/t\/(\d+)\/(\d+)\/(\d+)\./.exec(String(list.data))!;
    const tile = { ds, z: Number(z), x: Number(x), y: Number(y) };
    const path = { ds, rev: rev! };
    note("GET /d/{ds}/r/{rev}/tileset.json", await api.GET("/d/{ds}/r/{rev}/tileset.json", { params: { path } }));
    note("GET /d/{ds}/r/{rev}/tileset/{z}/{x}/{y}.json", await api.GET("/d/{ds}/r/{rev}/tileset/{z}/{x}/{y}.json", { params: { path: { ...path, ...tile } } }));
    note("GET /d/{ds}/r/{rev}/t/{z}/{x}/{y}.{ext}", await api.GET("/d/{ds}/r/{rev}/t/{z}/{x}/{y}.{ext}", { params: { path: { ...path, ...tile, ext: "spz" }, query: { sh: 1 } }, ...bytes }));
    note("GET /d/{ds}/t/{z}/{x}/{y}.{ext}", await api.GET("/d/{ds}/t/{z}/{x}/{y}.{ext}", { params: { path: { ...tile, ext: "drc" } }, ...bytes }));
    note("GET /d/{ds}/r/{rev}/city.{fmt}", await api.GET("/d/{ds}/r/{rev}/city.{fmt}", { params: { path: { ...path, fmt: "sog" } }, ...bytes }));
    note("GET /d/{ds}/city.{fmt}", await api.GET("/d/{ds}/city.{fmt}", { params: { path: { ds, fmt: "spz" } }, ...bytes }));
    note("GET /d/{ds}/use", await api.GET("/d/{ds}/use", { params: { path: { ds } }, ...text }));
    note("GET /d/{ds}/r/{rev}/seed.ndjson", await api.GET("/d/{ds}/r/{rev}/seed.ndjson", { params: { path, query: { limit: 1 } }, ...text }));

    // ---- pictures ----
    const view = { ds, lon, lat, height: Math.round(h + 60), heading: 0, pitch: -60, fov: 50, roll: 0, w: 64, h: 48, s: 1, fmt: "jpg" as const };
    const pose = { lon, lat, height: h + 60, heading: 0, pitch: -60 };
    const size = { width: 64, height: 48 };
    note("GET /d/{ds}/r/{rev}/static/{lon},{lat},{height}@{heading},{pitch},{fov},{roll}/{w}x{h}@{s}x.{fmt}", await api.GET("/d/{ds}/r/{rev}/static/{lon},{lat},{height}@{heading},{pitch},{fov},{roll}/{w}x{h}@{s}x.{fmt}", { params: { path: { ...view, rev: rev! }, query: { background: "sky" } }, ...bytes }));
    note("GET /d/{ds}/static/{lon},{lat},{height}@{heading},{pitch},{fov},{roll}/{w}x{h}@{s}x.{fmt}", await api.GET("/d/{ds}/static/{lon},{lat},{height}@{heading},{pitch},{fov},{roll}/{w}x{h}@{s}x.{fmt}", { params: { path: view }, ...bytes }));
    note("POST /d/{ds}/render", await api.POST("/d/{ds}/render", { params: { path: { ds } }, body: { pose, ...size, format: "png" }, ...bytes }));
    const abort = new AbortController();
    const motion = await api.GET("/d/{ds}/motion/{stream}", { params: { path: { ds, stream: "0123456789abcdef" } }, signal: abort.signal, ...stream });
    note("GET /d/{ds}/motion/{stream}", motion);
    note("POST /d/{ds}/motion/{stream}", await api.POST("/d/{ds}/motion/{stream}", { params: { path: { ds, stream: "0123456789abcdef" } }, body: { number: 1, still: true, pose, ...size }, ...text }));
    abort.abort();

    // ---- maps ----
    const map = await api.GET("/d/{ds}/map.json", { params: { path: { ds } } });
    note("GET /d/{ds}/map.json", map);
    const zoom = map.data!.minzoom!;
    const turn = (lat * Math.PI) / 180;
    const cell = { z: zoom, x: Math.floor(((lon + 180) / 360) * 2 ** zoom), y: String(Math.floor(((1 - Math.asinh(Math.tan(turn)) / Math.PI) / 2) * 2 ** zoom)) };
    note("GET /d/{ds}/r/{rev}/map/{z}/{x}/{y}.{fmt}", await api.GET("/d/{ds}/r/{rev}/map/{z}/{x}/{y}.{fmt}", { params: { path: { ...path, ...cell, fmt: "webp" } }, ...bytes }));
    note("GET /d/{ds}/map/{z}/{x}/{y}.{fmt}", await api.GET("/d/{ds}/map/{z}/{x}/{y}.{fmt}", { params: { path: { ds, ...cell, fmt: "webp" } }, ...bytes }));
    note("GET /d/{ds}/r/{rev}/terrain/{z}/{x}/{y}.png", await api.GET("/d/{ds}/r/{rev}/terrain/{z}/{x}/{y}.png", { params: { path: { ...path, ...cell }, query: { encoding: "terrarium", ground: "true" } }, ...bytes }));
    note("GET /d/{ds}/terrain/{z}/{x}/{y}.png", await api.GET("/d/{ds}/terrain/{z}/{x}/{y}.png", { params: { path: { ds, ...cell } }, ...bytes }));
    const terrain = await api.GET("/d/{ds}/terrain.json", { params: { path: { ds } } });
    const datum: string | undefined = terrain.data?.verticalDatum;
    if (!datum) throw new Error("terrain above what?");
    note("GET /d/{ds}/terrain.json", terrain);
    const style = await api.GET("/d/{ds}/style.json", { params: { path: { ds } } });
    const version: 8 | undefined = style.data?.version;
    if (version !== 8) throw new Error("no style");
    note("GET /d/{ds}/style.json", style);
    note("GET /d/{ds}/wmts.xml", await api.GET("/d/{ds}/wmts.xml", { params: { path: { ds } }, ...text }));

    // ---- questions ----
    const place = await api.GET("/d/{ds}/height", { params: { path: { ds }, query: { lon, lat } } });
    note("GET /d/{ds}/height", place);
    const places = await api.POST("/d/{ds}/height", { params: { path: { ds } }, body: { places: [[lon, lat]] } });
    const high: number | null | undefined = places.data?.places[0]?.height_m;
    // @ts-expect-error: there may be no surface
    high?.toFixed().length - high;
    if (places.data?.vertical_datum !== place.data?.vertical_datum) throw new Error("heights above two things");
    note("POST /d/{ds}/height", places);
    const pick = await api.POST("/d/{ds}/pick", { params: { path: { ds } }, body: { pose, ...size, x: 30, y: 20 } });
    if (pick.data?.found) pick.data.lon?.toFixed(7);
    note("POST /d/{ds}/pick", pick);
    // @ts-expect-error: x and y are needed
    const lacks: Answer = await api.POST("/d/{ds}/pick", { params: { path: { ds } }, body: { pose, ...size } });
    const problem = lacks.error as Problem;
    if (lacks.response.status !== 422 || !problem.request_id?.length) throw new Error(`${lacks.response.status} ${problem.detail}`);
    const line = [[lon, lat], [lon + 1e-4, lat]];
    const profile = await api.POST("/d/{ds}/profile", { params: { path: { ds } }, body: { line } });
    profile.data?.samples.map(({ distance_m }) => distance_m.toFixed());
    note("POST /d/{ds}/profile", profile);
    const measured = await api.POST("/d/{ds}/measure", { params: { path: { ds } }, body: { line } });
    measured.data?.length_m?.toFixed();
    note("POST /d/{ds}/measure", measured);
    const visible = await api.POST("/d/{ds}/visible", { params: { path: { ds } }, body: { from: { lon, lat, above: 50 }, to: { lon: lon + 2e-4, lat, above: 2 } } });
    const blocked: number | undefined = visible.data?.blocked_at?.distance_m;
    if (visible.data?.visible && blocked) throw new Error("seen, and not seen");
    note("POST /d/{ds}/visible", visible);

    // ---- appearances ----
    const appearances = await api.GET("/d/{ds}/appearances", { params: { path: { ds } } });
    const { name } = appearances.data!.appearances[0]!;
    note("GET /d/{ds}/appearances", appearances);
    const looks = await api.GET("/d/{ds}/appearance", { params: { path: { ds }, query: { appearance: name } } });
    const { embedding } = looks.data!;
    note("GET /d/{ds}/appearance", looks);
    const mix = await api.POST("/d/{ds}/appearances:mix", { params: { path: { ds } }, body: { weights: { [name]: 1 } } });
    note("POST /d/{ds}/appearances:mix", mix);
    const keep = { params: { path: { ds, name: "evening" } } };
    note("PUT /d/{ds}/appearances/{name}", await desk.PUT("/d/{ds}/appearances/{name}", { ...keep, body: { embedding } }));
    const kept = await api.GET("/d/{ds}/appearances/{name}", keep);
    note("GET /d/{ds}/appearances/{name}", kept);
    note("DELETE /d/{ds}/appearances/{name}", await desk.DELETE("/d/{ds}/appearances/{name}", { ...keep, ...text }));
    const model = await api.GET("/d/{ds}/r/{rev}/appearance.json", { params: { path } });
    model.data?.weights.length.toFixed();
    note("GET /d/{ds}/r/{rev}/appearance.json", model);
    const photographs = await api.GET("/d/{ds}/r/{rev}/appearances.json", { params: { path } });
    photographs.data?.photographs.map((photograph) => photograph.name.length);
    note("GET /d/{ds}/r/{rev}/appearances.json", photographs);
    note("GET /d/{ds}/r/{rev}/appearances/{row}.jpg", await api.GET("/d/{ds}/r/{rev}/appearances/{row}.jpg", { params: { path: { ...path, row: 0 } }, ...bytes }));
    return statuses;
}
