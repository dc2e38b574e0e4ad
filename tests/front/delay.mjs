// A network that is far away: passes TCP connections on, each byte after half of the round trip. A connection takes one
// round trip to open.
//
//   node delay.mjs PORT-FILE TO-PORT ROUND-TRIP-MS
//
// SPDX-License-Identifier: Apache-2.0
import { renameSync, writeFileSync } from "node:fs";
import { connect, createServer } from "node:net";

const [, , file, to, round] = process.argv;
const half = Number(round) / 2;

function pass(from, into) {
    from.on("data", (bytes) => setTimeout(() => into.writable && into.write(bytes), half));
    from.on("end", () => setTimeout(() => into.end(), half));
    from.on("error", () => into.destroy());
}

const server = createServer({ allowHalfOpen: true, noDelay: true }, (near) => {
    near.pause();
    setTimeout(() => {
        const far = connect({ port: Number(to), host: "127.0.0.1", allowHalfOpen: true, noDelay: true });
        pass(near, far);
        pass(far, near);
        near.resume();
    }, Number(round));
});
server.listen(0, "127.0.0.1", () => {
    writeFileSync(`${file}.part`, String(server.address().port));
    renameSync(`${file}.part`, file);
});
