// A server of files for pages that tests make.
//
// SPDX-License-Identifier: Apache-2.0
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { extname } from "node:path";

const TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".css": "text/css",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".wasm": "application/wasm",
};

// fileOf: from the path of a URL to a file's name. { url, close }; what is not there is 404.
export async function serveFiles(fileOf) {
    const server = createServer((request, response) => {
        try {
            const file = fileOf(decodeURIComponent(new URL(request.url, "http://x").pathname));
            const bytes = readFileSync(file);
            response.setHeader("Content-Type", TYPES[extname(file)] ?? "application/octet-stream");
            response.end(bytes);
        } catch {
            response.statusCode = 404;
            response.end();
        }
    });
    await new Promise((done) => server.listen(0, "127.0.0.1", done));
    const close = () => {
        server.closeAllConnections();
        server.close();
    };
    return { url: `http://127.0.0.1:${server.address().port}`, close };
}
