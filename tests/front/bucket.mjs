// A plain file server that takes PUT with conditions in one step, as buckets do. It keeps a folder, so it may be killed and
// started again. Each request is answered after a delay, and adds a line "METHOD status" to its log.
//
//   node bucket.mjs FOLDER LOG PORT DELAY-MS
//
// SPDX-License-Identifier: Apache-2.0
import { createHash } from "node:crypto";
import { appendFileSync, existsSync, readFileSync, renameSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { basename, join } from "node:path";

const [, , folder, log, port, delay] = process.argv;
const tagOf = (bytes) => `"${createHash("sha256").update(bytes).digest("hex").slice(0, 32)}"`;

function answer(method, file, headers, body) {
    const now = existsSync(file) ? readFileSync(file) : null;
    const tag = now && tagOf(now);
    if (method === "GET")
        return !now ? [404] : headers["if-none-match"] === tag ? [304, tag] : [200, tag, now];
    if (method !== "PUT") return [405];
    if ((headers["if-match"] && headers["if-match"] !== tag) || (headers["if-none-match"] === "*" && now)) return [412];
    writeFileSync(`${file}.part`, body);
    renameSync(`${file}.part`, file);
    return [now ? 200 : 201, tagOf(body)];
}

createServer((request, response) => {
    const parts = [];
    request.on("data", (part) => parts.push(part));
    request.on("end", () => setTimeout(() => {
        const [status, tag, bytes] = answer(request.method, join(folder, basename(request.url) || "none"), request.headers, Buffer.concat(parts));
        appendFileSync(log, `${request.method} ${status}\n`);
        response.writeHead(status, { ...(tag && { etag: tag }), ...(status !== 304 && { "content-length": bytes?.length ?? 0 }) });
        response.end(bytes);
    }, Number(delay)));
}).listen(Number(port), "127.0.0.1");
