// Asks every operation of /api with generated parameters and bodies, valid and invalid, and holds each answer against the
// description: its status and media type are there, JSON has the shape of its schema, and nothing is 500.
//
//   node openapi.mjs URL [REQUESTS [SEED]]
//
// It uses no package: what is generated has to know the server's addresses, else nearly every answer is 404, and the rest
// is short.
//
// SPDX-License-Identifier: Apache-2.0
const url = process.argv[2], requests = Number(process.argv[3] ?? 1200);
let seed = Number(process.argv[4] ?? 1) >>> 0;

function random(n) { // mulberry32
    seed = (seed + 0x6d2b79f5) >>> 0;
    let t = Math.imul(seed ^ (seed >>> 15), seed | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) % n;
}
const pick = (list) => list[random(list.length)];

const get = async (path) => (await fetch(url + path)).json();
const api = await get("/api");
const [first] = (await get("/collections")).collections;
const line = JSON.parse((await (await fetch(`${url}/d/${first.id}/seed.ndjson`)).text()).split("\n")[0]);
const [z, x, y] = /\/t\/(\d+)\/(\d+)\/(\d+)\./.exec(line.url).slice(1);
const [lon, lat] = first.splats.origin;

// ---- values ----

const there = { // by name: what leads to something
    ds: [first.id], rev: [first.splats.revision], z: [z], x: [x], y: [y], lon: [lon, lon + 1e-4], lat: [lat, lat - 1e-4], height: [200], pitch: [-60, -90], heading: [0, 90],
    w: [64], h: [64], fov: [60], bbox: [`${lon - 1},${lat - 1},${lon + 1},${lat + 1}`], clip: [`${lon - 0.01},${lat - 0.01},${lon + 0.01},${lat - 0.01},${lon},${lat + 0.01}`],
    stream: ["abcdefghijklmnop"], name: ["evening"], seal: ["a.b"], rest: ["/collections"], file: ["favicon.ico"], appearance: ["none"], size: ["640x360"], near: [`${lon},${lat}`], hours: ["6-18"],
};
const wild = ["", "0", "-1", "1e9", "99999999999999999999", "nan", "a", "A-_", "%00", "%2F..%2F", "é", "a".repeat(3000), "1,2,3", "{}", "'\"<>", "0x10", " 1", "null", "-0", ".5", "1.", "+1"];

function valid(p) {
    const s = p.schema;
    if (there[p.name] && random(4)) return String(pick(there[p.name]));
    if (s.enum) return pick(s.enum);
    if (s.type === "integer" || s.type === "number") {
        const low = s.minimum ?? 0, high = Math.min(s.maximum ?? 1e6, low + 1e6);
        return String(s.type === "integer" ? low + random(high - low + 1) : (low + (high - low) * random(1001) / 1000).toFixed(3));
    }
    return there[p.name] ? String(pick(there[p.name])) : pick(["a", "x-1", "12", "2026-01-02"]);
}
const value = (p) => (random(8) ? valid(p) : pick(wild));

function made(schema, depth = 0) { // a body that may be valid
    const s = schema?.$ref ? resolve(schema.$ref) : schema ?? {};
    if (!random(10) || depth > 6) return pick([null, 0, -1, "", "a", [], {}, true, 1e300, [[[[]]]]]);
    if (s.enum) return pick(s.enum);
    switch (s.type) {
    case "object": {
        const o = {};
        for (const [name, of] of Object.entries(s.properties ?? {}))
            if (s.required?.includes(name) ? random(12) : random(2)) o[name] = made(of, depth + 1);
        if (typeof s.additionalProperties === "object") o[pick(["a", "default", "none"])] = made(s.additionalProperties, depth + 1);
        if (!random(10)) o.unknown = 1;
        return o;
    }
    case "array": return [...Array((s.minItems ?? 1) + random(2))].map(() => made(s.items, depth + 1));
    case "integer": return (s.minimum ?? 0) + random(100);
    case "number": return pick([lon, lat, 0, 1, -1, 60, 200, 0.5]);
    case "boolean": return Boolean(random(2));
    default: return pick(["a", "evening", "jpg", first.id]);
    }
}

// ---- shapes ----

const resolve = (ref) => ref.slice(2).split("/").reduce((o, k) => o[k], api);
const kinds = {
    object: (v) => typeof v === "object" && v !== null && !Array.isArray(v), array: Array.isArray, string: (v) => typeof v === "string", number: (v) => typeof v === "number",
    integer: Number.isInteger, boolean: (v) => typeof v === "boolean",
};
const words = new Set(["type", "properties", "required", "items", "$ref", "enum", "minItems", "maxItems", "minProperties", "maxProperties", "additionalProperties", "description", "format",
    "minimum", "maximum", "pattern", "nullable", "default"]);

function wrong(schema, v, at) { // what is wrong with a value; "": nothing
    if (schema.$ref) return wrong(resolve(schema.$ref), v, at);
    const strange = Object.keys(schema).find((k) => !words.has(k));
    if (strange) return `${at}: this test does not know '${strange}' of schemas`;
    if (v === null && schema.nullable) return "";
    if (schema.type && !kinds[schema.type](v)) return `${at}: ${JSON.stringify(v)?.slice(0, 60)} is no ${schema.type}`;
    if (schema.enum && !schema.enum.includes(v)) return `${at}: ${v} is none of ${schema.enum}`;
    if (v < schema.minimum || v > schema.maximum) return `${at}: ${v} is out of range`;
    if (schema.pattern && !new RegExp(schema.pattern).test(v)) return `${at}: ${v} is not ${schema.pattern}`;
    if (Array.isArray(v)) {
        if (v.length < (schema.minItems ?? 0) || v.length > (schema.maxItems ?? Infinity)) return `${at}: ${v.length} elements`;
        return schema.items ? v.map((e, i) => wrong(schema.items, e, `${at}[${i}]`)).find(Boolean) ?? "" : "";
    }
    if (!kinds.object(v)) return "";
    const lacks = schema.required?.find((k) => !(k in v));
    if (lacks) return `${at}: ${lacks} is missing`;
    for (const [k, e] of Object.entries(v)) {
        const of = schema.properties?.[k] ?? (schema.additionalProperties === false ? null : schema.additionalProperties);
        if (of === null) return `${at}: ${k} is not described`;
        const bad = typeof of === "object" ? wrong(of, e, `${at}.${k}`) : "";
        if (bad) return bad;
    }
    return "";
}

// ---- asking ----

const operations = Object.entries(api.paths).flatMap(([path, methods]) => Object.entries(methods).map(([method, o]) => ({ path, method: method.toUpperCase(), o })));
const bad = [], statuses = {}, answered = new Map(operations.map((op) => [op.o.operationId, new Set()]));

async function ask({ path, method, o }) {
    const query = new URLSearchParams();
    let target = path, body;
    for (const p of o.parameters)
        if (p.in === "path") target = target.replace(`{${p.name}}`, () => encodeURIComponent(value(p)).replaceAll("%2B", "+"));
        else if (random(3) === 0) query.append(p.name, value(p));
    if (!random(20)) query.append("unknown", "1");
    const schema = o.requestBody?.content?.["application/json"]?.schema;
    if (o.requestBody) body = random(8) ? JSON.stringify(made(schema)) : pick(["", "{", "[]", "\u0000", "[".repeat(5000), "{\"a\":1,\"a\":2}"]);
    const full = url + target + (query.size ? `?${query}` : ""), what = `${method} ${full.slice(url.length, url.length + 300)} ${body?.slice(0, 200) ?? ""}`;
    const abort = new AbortController(), timer = setTimeout(() => abort.abort(), 60000);
    try {
        const r = await fetch(full, { method, body, redirect: "manual", signal: abort.signal, headers: body ? { "Content-Type": "application/json" } : {} });
        statuses[r.status] = (statuses[r.status] ?? 0) + 1;
        answered.get(o.operationId).add(r.status);
        const type = (r.headers.get("content-type") ?? "").split(";")[0];
        const said = o.responses[r.status] ?? o.responses[`${Math.floor(r.status / 100)}XX`];
        if (r.status === 500) bad.push(`${what}: 500 ${(await r.text()).slice(0, 200)}`);
        else if (!said) bad.push(`${what}: ${r.status} is not described`);
        else if (/multipart/.test(type)) abort.abort();
        else {
            const text = await r.text(), media = said.content ?? {};
            const [of] = Object.entries(media).filter(([name]) => name.split(";")[0] === type || name === "*/*").map(([, m]) => m);
            if (Object.keys(media).length && !of) bad.push(`${what}: ${r.status} as ${type}`);
            else if (/json$/.test(type) && of?.schema && method !== "HEAD") {
                const each = type === "application/x-ndjson" ? text.split("\n").filter(Boolean) : [text];
                const why = each.map((one) => wrong(of.schema, JSON.parse(one), "answer")).find(Boolean);
                if (why) bad.push(`${what}: ${r.status}: ${why}`);
            }
        }
    } catch (e) {
        if (!abort.signal.aborted || e.name !== "AbortError") bad.push(`${what}: ${e.message}: ${e.cause?.message ?? ""}`);
    }
    clearTimeout(timer);
}

for (let n = 0; n < requests; n += 8) await Promise.all([...Array(8)].map((_, i) => ask(operations[(n + i) % operations.length])));
console.log(`${requests} requests to ${operations.length} operations; statuses ${JSON.stringify(statuses)}`);
for (const b of bad.slice(0, 20)) console.log(`NOT AS DESCRIBED ${b}`);
console.log(`${bad.length} answers are not as described`);
process.exit(bad.length ? 1 : 0);
