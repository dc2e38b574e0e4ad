// The OpenAPI description is valid, describes addresses that exist, and what they answer has the shapes that
// it says.
//
// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Validator } from "@seriousme/openapi-schema-validator";
import Ajv from "ajv";

import { firstDataSet, getJson, openSource } from "./lib/source.mjs";

let source;
let api;
let check; // of a value against a schema of the description
before(async () => {
    source = await openSource();
    api = await getJson(`${source.url}/api`);
    const ajv = new Ajv({ strict: false });
    ajv.addFormat("binary", true);
    ajv.addSchema(api, "api");
    check = (schema, value) => {
        const validate = ajv.compile({ $ref: `api${schema.$ref}` });
        assert.ok(validate(value), JSON.stringify(validate.errors));
    };
});
after(() => source?.close());

test("the description is valid OpenAPI 3.0", async () => {
    const { valid, errors } = await new Validator().validate(structuredClone(api));
    assert.ok(valid, JSON.stringify(errors, null, 1));
    assert.match(api.openapi, /^3\.0\./);
});

test("parameters are those of the path, operations have names of their own", () => {
    const names = new Set();
    for (const [path, methods] of Object.entries(api.paths)) {
        assert.doesNotMatch(path, /[[\]]/, path);
        for (const operation of Object.values(methods)) {
            const inPath = operation.parameters.filter((p) => p.in === "path").map((p) => p.name);
            const inText = [...path.matchAll(/{(\w+)}/g)].map((m) => m[1]);
            assert.deepEqual(inPath, inText, path);
            assert.equal(new Set(inText).size, inText.length, path);
            assert.ok(!names.has(operation.operationId), operation.operationId);
            names.add(operation.operationId);
        }
    }
});

test("answers have the shapes that are said", async (t) => {
    const ds = await firstDataSet(source.url);
    const { splats } = await getJson(`${source.url}/collections/${ds}`);
    let looked = 0;
    for (const [path, methods] of Object.entries(api.paths)) {
        const content = methods.get?.responses["200"]?.content?.["application/json"];
        const url = path.replace("{ds}", ds).replace("{rev}", splats.revision);
        if (!content || url.includes("{")) continue;
        const asksForPlace = methods.get.parameters.some((p) => p.name === "lon");
        const [lon, lat] = splats.origin;
        const query = asksForPlace ? `?lon=${lon.toFixed(6)}&lat=${lat.toFixed(6)}` : "";
        const response = await fetch(source.url + url + query);
        if (response.status === 404) continue; // a part that this dataset does not have
        assert.equal(response.status, 200, url);
        assert.match(response.headers.get("content-type"), /^application\/json/, url);
        check(content.schema, await response.json());
        looked++;
    }
    assert.ok(looked >= 10, `${looked}`);
    const problem = await fetch(`${source.url}/d/${ds}/t/0/0/0.exe`);
    assert.equal(problem.status, 404);
    check({ $ref: "#/components/schemas/Problem" }, await problem.json());
    const seed = await (await fetch(`${source.url}/d/${ds}/seed.ndjson`)).text();
    for (const line of seed.trim().split("\n"))
        check({ $ref: "#/components/schemas/SeedLine" }, JSON.parse(line));
    t.diagnostic(`${looked} documents`);
});
