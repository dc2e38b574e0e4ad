// An identity service for one test: tells nginx's auth_request who sends a request, by a JSON Web Token (RFC 7519) that
// is signed by RS256.
//
//   node identity.mjs FOLDER    writes tokens, a file each, and its port
//
// SPDX-License-Identifier: Apache-2.0
import { createHmac, generateKeyPairSync, sign, verify } from "node:crypto";
import { renameSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { join } from "node:path";

const folder = process.argv[2];
const AUDIENCE = "citysplat";
const { privateKey, publicKey } = generateKeyPairSync("rsa", { modulusLength: 2048 });
const pem = publicKey.export({ type: "spki", format: "pem" });
const part = (value) => Buffer.from(JSON.stringify(value)).toString("base64url");

function token(claims, alg = "RS256") {
    const text = `${part({ alg, typ: "JWT" })}.${part(claims)}`;
    const made = {
        RS256: () => sign("sha256", Buffer.from(text), privateKey).toString("base64url"),
        HS256: () => createHmac("sha256", pem).update(text).digest("base64url"), // a public key is no secret
        none: () => "",
    };
    return `${text}.${made[alg]()}`;
}

// The claims of a token that holds now; null: it is none.
function claimsOf(header) {
    const [, head, body, signature] = /^Bearer ([\w-]+)\.([\w-]+)\.([\w-]*)$/.exec(header ?? "") ?? [];
    if (!head) return null;
    const read = (text) => JSON.parse(Buffer.from(text, "base64url").toString());
    try {
        const claims = read(body);
        const signed = verify("sha256", Buffer.from(`${head}.${body}`), publicKey, Buffer.from(signature, "base64url"));
        return read(head).alg === "RS256" && signed && claims.aud === AUDIENCE && claims.exp > Date.now() / 1000 ? claims : null;
    } catch {
        return null;
    }
}

const now = Math.floor(Date.now() / 1000);
const good = { sub: "somebody", aud: AUDIENCE, exp: now + 600, groups: ["staff", "VIEWERS"] };
const tokens = {
    good: token(good),
    late: token({ ...good, exp: now - 1 }),
    elsewhere: token({ ...good, aud: "another" }),
    other: token({ ...good, groups: ["VIEWERS-NOT"] }),
    none: token(good, "none"),
    hmac: token(good, "HS256"),
};
for (const [name, text] of Object.entries(tokens)) writeFileSync(join(folder, name), text);

const server = createServer((request, response) => {
    const claims = claimsOf(request.headers.authorization);
    if (!request.url.startsWith("/oauth2/auth")) response.writeHead(200).end("sign in here");
    else if (!claims) response.writeHead(401).end();
    else response.writeHead(202, { "X-Auth-Request-User": claims.sub, "X-Auth-Request-Groups": claims.groups.join(",") }).end();
});
server.listen(0, "127.0.0.1", () => {
    writeFileSync(join(folder, "port.part"), String(server.address().port));
    renameSync(join(folder, "port.part"), join(folder, "port"));
});
