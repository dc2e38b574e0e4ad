// Sends generated requests to two servers that have the same files, and compares the answers. Each difference must be in
// the table of differ_table.mjs, which says why. A row that none of 1,500 requests or more needs is an error too.
//
//   node differ.mjs OUR-PORT NGINX-PORT TILE DOCUMENT LIBRARY [REQUESTS [SEED]]    paths that both have; libmicrohttpd's version
//
// A request is sent with a plain one behind it on the same connection. So servers that disagree about where a request ends
// answer a different number of times. Both servers cut a request that is not complete after two seconds.
//
// SPDX-License-Identifier: Apache-2.0
import { createHash } from "node:crypto";
import net from "node:net";
import { gunzipSync } from "node:zlib";

import { table as rows } from "./differ_table.mjs";

const [ours, nginx, tile, doc] = [Number(process.argv[2]), Number(process.argv[3]), process.argv[4], process.argv[5]];
const table = rows.filter((row) => !row.alone || !/^0\./.test(process.argv[6]));
const requests = Number(process.argv[7] ?? 1500);
let seed = Number(process.argv[8] ?? 1) >>> 0;

function random(n) { // mulberry32
    seed = (seed + 0x6d2b79f5) >>> 0;
    let t = seed;
    t = Math.imul(t ^ (t >>> 15), t | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) % n;
}
const pick = (list) => list[random(list.length)];

// ---- what is sent ----

// ETAG and DATE stand for what the server itself said about the file.
const headers = {
    range: [
        "bytes=0-99", "bytes=100-", "bytes=-100", "bytes=0-", "bytes=100-50", "bytes=0-0", "bytes=-0", "bytes=99999999-", "bytes=0-99999999",
        "bytes=18446744073709551616-", "bytes=-18446744073709551616", "bytes=0-18446744073709551616", "bytes=5-9,20-29", "bytes=5-9,", "bytes=,5-9",
        "bytes= 5-9", "bytes=5 - 9", "bytes=5-9 ", "Bytes=5-9", "bytes:5-9", "bytes=", "bytes", "items=0-5", "bytes=a-b", "bytes=5-x", "bytes=-", "bytes=--5",
        "bytes=0-4,10-14,20-24,30-34", "bytes=0-9,0-9", "bytes=99999999-,-5", "",
    ].map((v) => [`Range: ${v}`]),
    ifrange: ["ETAG", "W/ETAG", "\"other\"", "DATE", "Thu, 01 Jan 1970 00:00:00 GMT", "nonsense", ""].map((v) => ["Range: bytes=5-9", `If-Range: ${v}`]),
    nonematch: ["ETAG", "W/ETAG", "\"other\"", "\"other\", ETAG", "\"a\" , W/ETAG ,\"b\"", "*", "\"other\", \"more\"", "", ",ETAG", "\"oth,er\", ETAG"]
        .map((v) => [`If-None-Match: ${v}`]),
    match: ["ETAG", "W/ETAG", "\"other\"", "\"other\", ETAG", "*", "\"other\", \"more\"", ""].map((v) => [`If-Match: ${v}`]),
    since: ["DATE", "Thu, 01 Jan 1970 00:00:00 GMT", "Thu, 31 Dec 2099 23:59:59 GMT", "nonsense", ""].map((v) => [`If-Modified-Since: ${v}`]),
    unmodified: ["DATE", "Thu, 01 Jan 1970 00:00:00 GMT", "Thu, 31 Dec 2099 23:59:59 GMT", "nonsense"].map((v) => [`If-Unmodified-Since: ${v}`]),
    both: [["If-None-Match: \"other\"", "If-Modified-Since: DATE"], ["If-None-Match: ETAG", "If-Modified-Since: Thu, 01 Jan 1970 00:00:00 GMT"]],
    coding: ["gzip", "gzip;q=0", "gzip;q=0.000", "gzip;q=0.001", "*", "*;q=0", "gzip, *;q=0", "identity", "identity;q=0", "br", "deflate, gzip;q=0.5", "x-gzip", "GZIP", "",
        "gzip; q=1", "gzip ;q=1", "gzip;q=2", "gzip;q=", "gzipx"].map((v) => [`Accept-Encoding: ${v}`]),
    accept: ["*/*", "text/html", "image/png, */*;q=0.1", "text/html;q=0", "nonsense", ""].map((v) => [`Accept: ${v}`]),
    connection: ["close", "keep-alive", "Keep-Alive, close", "upgrade", "nonsense", ""].map((v) => [`Connection: ${v}`]),
    expect: ["100-continue", "100-Continue", "200-ok"].map((v) => [`Expect: ${v}`]),
    many: [["X-A: 1", "X-A: 2", "X-B:", "X-C: \t a \t"], [...Array(30)].map((_, i) => `X-${i}: ${i}`)],
    long: [[`X-Long: ${"a".repeat(3000)}`], [`X-Long: ${"a".repeat(7000)}`], [`X-Long: ${"a".repeat(60000)}`]],
    name: [["X Y: 1"], ["X-A : 1"], [": 1"], ["X-A"], ["X\u0001: 1"], ["X(: 1"], ["X_under: 1"]],
    value: [["X-A: a\u0001b"], ["X-A: a\u0000b"], ["X-A: \u00e9"], ["X-A: a\rb"], ["X-A: 1", " folded: 2"], ["X-A: a\tb"], ["X-A: \u007f"]],
    twice: [["If-None-Match: \"other\"", "If-None-Match: ETAG"], ["Range: bytes=0-4", "Range: bytes=5-9"]],
};
const bodies = {
    length: [["Content-Length: 5", "hello"], ["Content-Length: 0", ""], ["Content-Length: 00005", "hello"]],
    badlength: ["+5", "-5", "5, 5", "5 5", "0x5", "5a", "", "99999999999999999999999"].map((v) => [`Content-Length: ${v}`, "hello"]),
    twolengths: [["Content-Length: 5\r\nContent-Length: 5", "hello"], ["Content-Length: 5\r\nContent-Length: 6", "hello"]],
    chunked: ["5\r\nhello\r\n0\r\n\r\n", "0\r\n\r\n", "5;a=b\r\nhello\r\n0\r\n\r\n", "05\r\nhello\r\n0\r\n\r\n", "5\r\nhello\r\n0\r\nX: 1\r\n\r\n"]
        .map((v) => ["Transfer-Encoding: chunked", v]),
    badchunks: ["5\nhello\n0\n\n", "-5\r\nhello\r\n0\r\n\r\n", "0x5\r\nhello\r\n0\r\n\r\n", "5 \r\nhello\r\n0\r\n\r\n", "4\r\nhello\r\n0\r\n\r\n", "ffffffffffffffffff\r\nhello", "g\r\n\r\n", "\r\n\r\n"]
        .map((v) => ["Transfer-Encoding: chunked", v]),
    bothways: [["Content-Length: 5\r\nTransfer-Encoding: chunked", "0\r\n\r\n"], ["Transfer-Encoding: chunked\r\nContent-Length: 5", "5\r\nhello\r\n0\r\n\r\n"]],
    coding: ["gzip, chunked", "identity", "chunked, gzip", "chunked, chunked", "Chunked", "xchunked", ""].map((v) => [`Transfer-Encoding: ${v}`, "0\r\n\r\n"]),
};
const lines = { // [of the request line's target, how the file is named]
    plain: [(p) => p],
    query: [(p) => `${p}?`, (p) => `${p}?sh=0`],
    badquery: [(p) => `${p}?a=b&&c`, (p) => `${p}?%zz`, (p) => `${p}?a=%00`],
    absolute: [(p) => `http://files.example${p}`, (p) => `http://other.example${p}`, (p) => `HTTP://files.example${p}`, (p) => `https://files.example${p}`],
    badabsolute: [(p) => `http://${p}`, (p) => `http:${p}`, (p) => `http://files.example`, (p) => `ftp://files.example${p}`, (p) => `http://a b${p}`],
    dots: [(p) => `/.${p}`, (p) => `/x/..${p}`, (p) => `/..${p}`, (p) => p.replace("/r/", "/./r/"), (p) => p.replace("/r/", "/x/../r/"), (p) => `${p}/.`, (p) => `${p}/..`,
        (p) => `/%2e%2e${p}`, (p) => p.replace("/r/", "/x/%2e%2e/r/")],
    slashes: [(p) => `/${p}`, (p) => p.replace("/r/", "//r/"), (p) => `${p}/`],
    escapes: [(p) => p.replace("/d/", "/%64/"), (p) => p.replace("toy", "t%6Fy"), (p) => p.replace("toy", "t%6fy")],
    badescapes: [(p) => p.replace("/r/", "%2Fr%2F"), (p) => `${p}%00`, (p) => `${p}%zz`, (p) => `${p}%`, (p) => `${p}%4`, (p) => `${p}%0a`, (p) => p.replace("/r/", "%5cr%5c")],
    missing: [() => "/d/none", (p) => `${p}x`, () => "/none/none/none", () => "/d/toy/r/000000000000/none"],
    form: [() => "*", (p) => p.slice(1), (p) => `${p}#part`, () => "files.example:80", (p) => `${p}\u00e9`, (p) => `${p}"`],
    control: [(p) => `${p}\u0001`, (p) => `${p}\u0000`, (p) => `${p}\u007f`],
    long: [(p) => `${p}?a=${"b".repeat(3000)}`, (p) => `${p}?a=${"b".repeat(20000)}`],
};
const methods = { GET: 12, HEAD: 4, OPTIONS: 1, POST: 1, PUT: 1, DELETE: 1, TRACE: 1, PATCH: 1, PROPFIND: 1, get: 1, "G@T": 1, CONNECT: 1 };
const versions = { "HTTP/1.1": 24, "HTTP/1.0": 2, "HTTP/1.2": 1, "HTTP/2.0": 1, "HTTP/0.9": 1, "HTTP/1.10": 1, "HTTX/1.1": 1, "http/1.1": 1, "": 1 };
const hosts = {
    one: [["Host: files.example"], ["Host: files.example:80"], ["Host: 127.0.0.1"], ["Host: [::1]:80"], ["hOsT:files.example"]],
    none: [[]],
    two: [["Host: files.example", "Host: files.example"], ["Host: files.example", "Host: other.example"]],
    empty: [["Host:"]],
    bad: [["Host: a b"], ["Host: a/b"], ["Host: a@b"], ["Host: a,b"], ["Host: a:x"], ["Host: .."], ["Host: <a>"]],
};
const ends = { crlf: 30, lf: 1, onelf: 1, leading: 1, leadinglf: 1, spaces: 1, tab: 1 };
const weighted = (of) => pick(Object.entries(of).flatMap(([k, n]) => Array(n).fill(k)));

function generate() {
    const kind = random(2) ? "tile" : "doc";
    const what = new Set([kind]);
    const method = random(3) ? "GET" : weighted(methods);
    const version = random(4) ? "HTTP/1.1" : weighted(versions);
    const target = random(3) ? "plain" : pick(Object.keys(lines));
    const host = random(6) ? "one" : pick(Object.keys(hosts));
    const end = random(4) ? "crlf" : weighted(ends);
    const path = pick(lines[target])(kind === "tile" ? tile : doc);
    what.add(`method ${method}`).add(`version ${version}`).add(`target ${target}`).add(`host ${host}`).add(`end ${end}`);
    const fields = [...pick(hosts[host])];
    let body = "";
    for (let k = random(3); k > 0; k--) {
        const of = pick(Object.keys(headers));
        if (what.has(`header ${of}`)) continue;
        what.add(`header ${of}`);
        fields.push(...pick(headers[of]));
    }
    if (!random(6)) {
        const of = pick(Object.keys(bodies)), [field, bytes] = pick(bodies[of]);
        what.add(`body ${of}`);
        fields.push(field);
        body = bytes;
    }
    const br = end === "lf" ? "\n" : "\r\n";
    const space = end === "spaces" ? "  " : end === "tab" ? "\t" : " ";
    let head = `${method}${space}${path}${version ? space + version : ""}${end === "onelf" ? "\n" : br}`;
    for (const f of fields) head += f + br;
    head = (end === "leading" ? "\r\n" : end === "leadinglf" ? "\n" : "") + head + br;
    return { what, kind, method, path, version, fields, text: head + body };
}

// ---- what comes back ----

function exchange(port, text) {
    return new Promise((done) => {
        const parts = [], socket = net.connect(port, "127.0.0.1", () => socket.write(Buffer.from(text, "latin1")));
        const end = () => done(Buffer.concat(parts));
        socket.on("data", (d) => parts.push(d));
        socket.on("error", () => {});
        socket.on("close", end);
        socket.setTimeout(30000, () => socket.destroy(new Error("silence")));
    });
}

function read(bytes, methods) { // all answers on a connection; methods of their requests, in order
    const answers = [];
    let at = 0;
    while (at < bytes.length) {
        const end = bytes.indexOf("\r\n\r\n", at);
        const head = end < 0 ? "" : bytes.toString("latin1", at, end);
        const status = Number(/^HTTP\/1\.[01] (\d{3})/.exec(head)?.[1] ?? 0);
        if (!status) { // HTTP/0.9 has no head
            answers.push({ status: 0, fields: {}, body: bytes.subarray(at) });
            break;
        }
        const fields = {};
        for (const line of head.split("\r\n").slice(1)) {
            const [, name, value] = /^([^:]+):\s*(.*)$/.exec(line);
            fields[name.toLowerCase()] = value;
        }
        at = end + 4;
        if (status < 200) continue;
        const none = methods[Math.min(answers.length, methods.length - 1)] === "HEAD" || status === 204 || status === 304;
        let body = Buffer.alloc(0);
        if (!none && fields["transfer-encoding"] === "chunked") {
            const chunks = [];
            for (;;) {
                const eol = bytes.indexOf("\r\n", at), n = parseInt(bytes.toString("latin1", at, eol), 16);
                if (eol < 0 || !(n > 0)) { at = eol < 0 ? bytes.length : eol + 4; break; } // cut, or the last
                chunks.push(bytes.subarray(eol + 2, eol + 2 + n));
                at = eol + 4 + n;
            }
            body = Buffer.concat(chunks);
        } else if (!none) {
            const n = fields["content-length"] === undefined ? bytes.length - at : Number(fields["content-length"]);
            body = bytes.subarray(at, at + n);
            at += n;
        }
        answers.push({ status, fields, body });
    }
    return answers;
}

const hash = (b) => createHash("sha256").update(b).digest("hex").slice(0, 8);

function summary(a) { // of an answer: what has to be the same
    const f = a.fields, good = a.status >= 200 && a.status < 300, coded = f["content-encoding"] ?? "none";
    let body = "";
    if (good && a.body.length) body = /^multipart\/byteranges/.test(f["content-type"] ?? "") ? "several" : coded === "gzip" ? hash(gunzipSync(a.body)) : hash(a.body);
    return {
        status: String(a.status),
        range: f["content-range"] ?? "none",
        coding: good ? coded : "none",
        body,
        length: a.status === 206 ? f["content-length"] ?? "none" : "",
        tag: a.status === 200 || a.status === 206 || a.status === 304 ? String(Boolean(f.etag)) : "",
        accepts: a.status === 200 && coded === "none" ? f["accept-ranges"] ?? "none" : "",
        vary: a.status === 200 && f.vary ? String(/accept-encoding/i.test(f.vary)) : "",
    };
}

const own = { [ours]: {}, [nginx]: {} }; // ETag and Last-Modified of each server
for (const port of [ours, nginx])
    for (const [kind, path] of [["tile", tile], ["doc", doc]]) {
        const [a] = read(await exchange(port, `GET ${path} HTTP/1.1\r\nHost: files.example\r\nConnection: close\r\n\r\n`), ["GET"]);
        if (a?.status !== 200) throw new Error(`${path} of port ${port}: ${a?.status}`);
        own[port][kind] = { etag: a.fields.etag, date: a.fields["last-modified"] ?? "Thu, 01 Jan 1970 00:00:01 GMT", sum: hash(a.body) };
    }
for (const kind of ["tile", "doc"])
    if (own[ours][kind].sum !== own[nginx][kind].sum) throw new Error(`the ${kind} differs to begin with`);

async function ask(port, r) {
    const { etag, date } = own[port][r.kind];
    const text = r.text.replaceAll("ETAG", etag).replaceAll("DATE", date);
    const behind = `GET ${tile} HTTP/1.1\r\nHost: files.example\r\nConnection: close\r\n\r\n`;
    return read(await exchange(port, text + behind), [r.method, "GET"]);
}

const used = new Map(table.map((row) => [row, 0])), unargued = [];
let same = 0;

function compare(r, a, b) {
    // statuses of all answers, then the fields of the first if both gave it
    const all = { answers: [a.map((x) => x.status).join(" ") || "closed", b.map((x) => x.status).join(" ") || "closed"] };
    if (a.length && b.length && a[0].status === b[0].status) {
        const [x, y] = [summary(a[0]), summary(b[0])];
        for (const k of Object.keys(x)) if (x[k] !== y[k]) all[k] = [x[k], y[k]];
    }
    let differs = false;
    for (const [field, [our, their]] of Object.entries(all)) {
        if (our === their) continue;
        differs = true;
        const row = table.find((t) => t.field === field && t.when(r) && (t.pair ? t.pair(our, their) : t.ours.test(our) && t.nginx.test(their)));
        if (row) used.set(row, used.get(row) + 1);
        else unargued.push(`${field}: ours '${our}', nginx '${their}' for ${[...r.what].join(", ")}\n    ${JSON.stringify(r.text.slice(0, 400))}`);
    }
    if (!differs) same++;
}

// What the generator seldom meets.
const rare = [["doc", "nonematch", "If-None-Match: ETAG", "Accept-Encoding: gzip", ""], ["tile", "range", "Range: bytes=5 - 9", "Accept: */*", ""], ["tile", "range", "Range: bytes=0-4", "Accept: */*", "?sh=0"]]
    .map(([kind, header, one, other, query]) => ({
        what: new Set([kind, "method GET", query ? "target query" : "target plain", `header ${header}`, "header coding"]), kind, method: "GET",
        text: `GET ${kind === "tile" ? tile : doc}${query} HTTP/1.1\r\nHost: files.example\r\n${one}\r\n${other}\r\n\r\n`,
    }));
const list = [...rare, ...[...Array(requests)].map(generate)];
let next = 0;
await Promise.all([...Array(24)].map(async () => {
    while (next < list.length) {
        const r = list[next++];
        compare(r, ...await Promise.all([ask(ours, r), ask(nginx, r)]));
    }
}));

console.log(`${list.length} requests: ${same} answered alike`);
for (const [row, n] of used) console.log(`${String(n).padStart(6)}  ${row.field}: ${row.what}`);
const idle = requests < 1500 ? [] : [...used].filter(([, n]) => !n).map(([row]) => row.what);
if (idle.length) console.log(`rows that no request needed:\n  ${idle.join("\n  ")}`);
for (const u of unargued.slice(0, Number(process.env.SHOW ?? 20))) console.log(`NOT ARGUED ${u}`);
console.log(`${unargued.length} differences are not argued`);
process.exit(unargued.length || idle.length ? 1 : 0);
