// A man in the middle: forwards to a server, and does to its answers what bad days do. Listens on
// one port of its own, so that the server can be lost and be back.
//
// SPDX-License-Identifier: Apache-2.0
import { createServer, request as ask } from "node:http";

const CHUNK = 4096;

export class Proxy {
    log = []; // { path, bytes, began, ended, aborted }, times in ms; ended 0 while it is under way
    rule = () => null; // (path) => { status, body } to answer at once, or null
    onTile = () => {}; // a tile is asked for
    bytesPerSecond = Infinity; // of all slow answers together
    slow = () => true; // (path) => it is held to that speed
    latencyMs = 0;
    #server = null;
    #sockets = new Set();
    #port = 0;
    #target;
    #free = 0; // when the line is free again, ms

    static async open(target) {
        const proxy = new Proxy();
        proxy.#target = new URL(target);
        await proxy.up();
        return proxy;
    }

    get url() {
        return `http://127.0.0.1:${this.#port}`;
    }

    up() {
        this.#server = createServer((request, response) => void this.#serve(request, response));
        this.#server.on("connection", (socket) => {
            this.#sockets.add(socket);
            socket.once("close", () => this.#sockets.delete(socket));
        });
        return new Promise((done) =>
            this.#server.listen(this.#port, "127.0.0.1", () => {
                this.#port = this.#server.address().port;
                done();
            }),
        );
    }

    // Nobody listens any more, and what was on its way breaks off.
    down() {
        const closed = new Promise((done) => this.#server.close(done));
        for (const socket of this.#sockets) socket.destroy();
        return closed;
    }

    // Requests of tiles, in the order in which they came.
    tiles() {
        return this.log.filter(({ path }) => path.includes("/t/"));
    }

    async #serve(request, response) {
        const entry = { path: request.url, bytes: 0, began: Date.now(), ended: 0, aborted: false };
        this.log.push(entry);
        if (entry.path.includes("/t/")) this.onTile();
        let onward = null;
        response.on("close", () => {
            entry.aborted = !entry.ended;
            if (entry.aborted) onward?.destroy(); // nobody reads it
        });
        if (this.latencyMs) await new Promise((done) => setTimeout(done, this.latencyMs));
        if (entry.aborted) return;
        const own = this.rule(request.url);
        if (own) {
            entry.ended = Date.now();
            response.writeHead(own.status, { "content-type": "application/problem+json" });
            response.end(JSON.stringify(own.body ?? { title: "no" }));
            return;
        }
        const { hostname, port } = this.#target;
        const { method, url: path, headers } = request;
        onward = ask({ hostname, port, method, path, headers }, (answer) =>
            this.#pass(entry, answer, response).catch(() => response.destroy()),
        );
        onward.on("error", () => response.destroy());
        request.pipe(onward);
    }

    async #pass(entry, answer, response) {
        response.writeHead(answer.statusCode, answer.headers);
        for await (const part of answer)
            for (let at = 0; at < part.length && !entry.aborted; at += CHUNK) {
                const piece = part.subarray(at, at + CHUNK);
                if (this.slow(entry.path)) await this.#wait(piece.length);
                response.write(piece);
                entry.bytes += piece.length;
            }
        if (!entry.aborted) entry.ended = Date.now();
        response.end();
    }

    async #wait(bytes) {
        if (!Number.isFinite(this.bytesPerSecond)) return;
        const now = Date.now();
        this.#free = Math.max(this.#free, now) + (1000 * bytes) / this.bytesPerSecond;
        if (this.#free - now > 5) await new Promise((done) => setTimeout(done, this.#free - now));
    }
}
