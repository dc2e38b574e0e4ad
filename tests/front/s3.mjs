// s3.mjs METHOD URL [FILE]: one request to a bucket, signed (version 4) with AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY,
// by its definition and without code of citysplat. The body goes to stdout; it fails where the status is not 2xx.
//
// SPDX-License-Identifier: Apache-2.0
import { createHash, createHmac } from "node:crypto";
import { readFileSync } from "node:fs";

const [method, address, file] = process.argv.slice(2);
const { AWS_ACCESS_KEY_ID: id, AWS_SECRET_ACCESS_KEY: secret } = process.env;
const url = new URL(address);
const body = file ? readFileSync(file) : undefined;
const hex = (bytes) => createHash("sha256").update(bytes).digest("hex");
const mac = (key, text) => createHmac("sha256", key).update(text).digest();
const time = new Date().toISOString().replace(/[-:]|\.\d+/g, "");
const day = time.slice(0, 8);
const fields = { host: url.host, "x-amz-content-sha256": hex(body ?? ""), "x-amz-date": time };
const names = Object.keys(fields).sort();
const head = names.map((name) => `${name}:${fields[name]}\n`).join("");
const canonical = [method, url.pathname, "", head, names.join(";"), fields["x-amz-content-sha256"]].join("\n");
const scope = `${day}/us-east-1/s3/aws4_request`;
const key = [day, "us-east-1", "s3", "aws4_request"].reduce(mac, `AWS4${secret}`);
const signature = mac(key, ["AWS4-HMAC-SHA256", time, scope, hex(canonical)].join("\n")).toString("hex");
delete fields.host; // fetch writes it
fields.authorization = `AWS4-HMAC-SHA256 Credential=${id}/${scope}, SignedHeaders=${names.join(";")}, Signature=${signature}`;
const answer = await fetch(url, { method, headers: fields, body });
process.stdout.write(await answer.text());
if (!answer.ok) process.exit(1);
