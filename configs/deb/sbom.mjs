// Licences of everything that the program links and the viewer contains: an SBOM (SPDX 2.3) for the package, and the
// page docs/licences.md. From the programs themselves (readelf, ldd), Debian's records (dpkg) and npm's lock file.
//
//   node configs/deb/sbom.mjs --sbom FILE --version V PROGRAM LIBRARY...    writes the SBOM
//   node configs/deb/sbom.mjs --texts FILE                                  writes the licence texts of npm's packages
//   node configs/deb/sbom.mjs --page FILE PROGRAM LIBRARY...                writes the page; --check FILE compares it
//
// SPDX-License-Identifier: Apache-2.0
import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { existsSync, readdirSync, readFileSync, realpathSync, writeFileSync } from "node:fs";
import { basename, dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const root = join(dirname(fileURLToPath(import.meta.url)), "../..");

const DRACO = "Of three is assets/draco_decoder.js, too: Draco's decoder, Apache-2.0.";

// Libraries that the program links itself, by the Debian package less its number: the licence of what is linked, as its
// copyright file and its authors state it. A package that is not in here is an error: somebody has to read its licence.
const LINKED = {
  "libc": ["LGPL-2.1-or-later", "C library"],
  "libgcc-s": ["GPL-3.0-or-later WITH GCC-exception-3.1", "run time of the compiler"],
  "libstdc++": ["GPL-3.0-or-later WITH GCC-exception-3.1", "C++ library"],
  "libcurl3-gnutls": ["curl", "stores at addresses, `citysplat seed`"],
  "libdeflate": ["MIT", "compression"],
  "libdraco": ["Apache-2.0", "`.drc`"],
  "libexpat": ["MIT", "XMP of photographs"],
  "libgdal": ["MIT", "maps and heights as files; `citysplat-gdal.so`"],
  "libgeographiclib": ["MIT", "geodesy"],
  "libgnutls": ["LGPL-2.1-or-later", "HTTPS"],
  "libjpeg62-turbo": ["IJG AND BSD-3-Clause AND Zlib", "plain JPEG"],
  "libjansson": ["MIT", "JSON"],
  "libmicrohttpd": ["LGPL-2.1-or-later", "HTTP"],
  "libnettle": ["LGPL-3.0-or-later OR GPL-2.0-or-later", "signed addresses"],
  "libopenimageio": ["BSD-3-Clause", "photographs; `citysplat-image.so`"],
  "libsqlite3": ["LicenseRef-SQLite-public-domain", "tile stores"],
  "libsystemd": ["LGPL-2.1-or-later", "readiness, watchdog"],
  "libvpx": ["BSD-3-Clause", "streams as video"],
  "libwebp": ["BSD-3-Clause", "pictures, `.sog`"],
  "libxxhash": ["BSD-2-Clause", "hashes"],
  "libzip": ["BSD-3-Clause", "`.sog`, `.3tz`"],
  "libzstd": ["BSD-3-Clause OR GPL-2.0-only", "compression"],
  "ocl-icd-libopencl": ["BSD-2-Clause", "OpenCL's loader"],
  "zlib": ["Zlib", "compression"],
};
// npm's packages that build the viewer and leave nothing in it.
const TOOLS = /^(typescript|vite|esbuild|@types\/.*)$/;

const run = (program, args) => {
  try {
    return execFileSync(program, args, { encoding: "utf8", maxBuffer: 1 << 26, stdio: ["ignore", "pipe", "ignore"] });
  } catch (failed) {
    if (failed.stdout) return failed.stdout; // dpkg -S does not know every path
    throw new Error(`${program}: ${failed.message}`);
  }
};
const byName = (a, b) => (a.name < b.name ? -1 : a.name > b.name ? 1 : 0);

// ---- libraries

// Sonames that the files name themselves, and the path of each library that is loaded with them.
function libraries(files) {
  const needed = new Set();
  for (const line of run("readelf", ["-d", ...files]).split("\n")) {
    const name = /\(NEEDED\).*\[(.*)\]/.exec(line)?.[1];
    if (name) needed.add(name);
  }
  const loaded = new Map();
  for (const line of run("ldd", files).split("\n")) {
    const [, name, path] = /^\s*(\S+) => (\/\S+)/.exec(line) ?? /^\s*(?:\/\S*\/)?((ld-linux)\S*)/.exec(line) ?? [];
    if (/=> not found/.test(line)) throw new Error(`ldd: ${line.trim()}`);
    if (path?.startsWith("/")) loaded.set(name, path);
  }
  for (const name of needed)
    if (!loaded.has(name) && !name.startsWith("ld-linux")) throw new Error(`${name} is linked, and ldd does not find it`);
  return { needed, loaded };
}

// The Debian package of each library: dpkg knows a file by the path that the package has, before or after /usr was merged.
function packagesOf({ needed, loaded }) {
  const wanted = new Map();
  for (const [name, path] of loaded)
    for (const one of [path, realpathSync(path)])
      for (const form of [one.replace(/^\/usr\/lib/, "/lib"), one.replace(/^\/lib/, "/usr/lib")]) wanted.set(form, name);
  const owner = new Map();
  for (const line of run("dpkg-query", ["-S", ...wanted.keys()]).split("\n")) {
    const [, owners, path] = /^(.+): (\/.+)$/.exec(line) ?? [];
    if (path && wanted.has(path)) owner.set(wanted.get(path), owners.split(",")[0].replace(/:.*/, ""));
  }
  const found = new Map();
  for (const name of loaded.keys()) {
    const of = owner.get(name);
    if (!of) throw new Error(`${loaded.get(name)}: no Debian package has it`);
    const entry = found.get(of) ?? { name: of, files: [], linked: [] };
    entry.files.push(name);
    if (needed.has(name)) entry.linked.push(name.replace(/\.so.*/, ""));
    found.set(of, entry);
  }
  const format = "${Package}\t${Version}\t${Architecture}\t${source:Package}\t${source:Version}\n";
  for (const line of run("dpkg-query", ["-W", "-f", format, ...found.keys()]).split("\n")) {
    const [name, version, arch, source, sourceVersion] = line.split("\t");
    if (found.has(name)) Object.assign(found.get(name), { version, arch, source, sourceVersion });
  }
  return [...found.values()].sort(byName);
}

// Names of licences in a copyright file of the machine-readable form (DEP-5).
function debianNames(name) {
  const path = `/usr/share/doc/${name}/copyright`;
  if (!existsSync(path)) return [];
  const text = readFileSync(path, "utf8");
  if (!/^Format:/m.test(text)) return [];
  return [...new Set([...text.matchAll(/^License:[ \t]*(\S.*)$/gm)].map((match) => match[1].trim()))].sort();
}

function linkedOf(name) {
  const plain = name.replace("t64", ""); // libcurl3t64-gnutls of Debian 13
  const known = LINKED[plain] ?? LINKED[plain.replace(/-?[0-9][0-9.]*g?$/, "")]; // libsqlite3-0, zlib1g
  if (!known) throw new Error(`${name} is linked, and configs/deb/sbom.mjs does not know its licence: read /usr/share/doc/${name}/copyright`);
  return { licence: known[0], what: known[1] };
}

// ---- npm

// Packages of the lock file that the viewer contains: what its dependencies need, without tools.
function npmPackages() {
  const all = JSON.parse(readFileSync(join(root, "web/package-lock.json"), "utf8")).packages;
  const found = new Map();
  const add = (from, name) => {
    let folder = from;
    for (;;) {
      const path = `${folder ? `${folder}/` : ""}node_modules/${name}`;
      if (all[path]) {
        if (found.has(path)) return;
        const one = all[path];
        found.set(path, { path, name, version: one.version, licence: one.license, integrity: one.integrity });
        for (const next of Object.keys(one.dependencies ?? {})) if (!TOOLS.test(next)) add(path, next);
        return;
      }
      if (!folder) throw new Error(`web/package-lock.json: ${name}, which ${from || "the viewer"} needs, is not in it`);
      folder = folder.includes("/node_modules/") ? folder.slice(0, folder.lastIndexOf("/node_modules/")) : "";
    }
  };
  for (const name of Object.keys({ ...all[""].dependencies, ...all[""].devDependencies })) if (!TOOLS.test(name)) add("", name);
  for (const one of found.values()) if (!one.licence) throw new Error(`web/package-lock.json: ${one.name} has no licence`);
  return [...found.values()].sort(byName);
}

function texts() {
  const parts = npmPackages().map(({ path, name, version, licence }) => {
    const folder = join(root, "web", path);
    const files = existsSync(folder) ? readdirSync(folder).filter((file) => /^(licen[cs]e|copying|notice)/i.test(file)).sort() : null;
    if (!files) throw new Error(`${folder} is not installed: (cd web && npm ci)`);
    const text = files.map((file) => readFileSync(join(folder, file), "utf8").trim()).join("\n\n");
    return `${name} ${version} (${licence})\n\n${text || "The package has no file with the text."}\n`;
  });
  return parts.join(`\n${"-".repeat(78)}\n\n`);
}

// ---- SPDX

const id = (text) => `SPDXRef-${text.replace(/[^A-Za-z0-9.-]/g, "-")}`;

function sbom(version, files) {
  const debian = packagesOf(libraries(files));
  const npm = npmPackages();
  const self = {
    SPDXID: "SPDXRef-citysplat", name: "citysplat", versionInfo: version, downloadLocation: "NOASSERTION", filesAnalyzed: false,
    licenseConcluded: "Apache-2.0", licenseDeclared: "Apache-2.0", copyrightText: "NOASSERTION",
    externalRefs: [{ referenceCategory: "PACKAGE-MANAGER", referenceType: "purl", referenceLocator: `pkg:deb/citysplat@${version}` }],
  };
  const packages = [self], relationships = [{ spdxElementId: "SPDXRef-DOCUMENT", relationshipType: "DESCRIBES", relatedSpdxElement: self.SPDXID }];
  for (const one of debian) {
    const names = debianNames(one.name);
    const licence = one.linked.length ? linkedOf(one.name).licence : "NOASSERTION";
    packages.push({
      SPDXID: id(`deb-${one.name}`), name: one.name, versionInfo: one.version, supplier: "Organization: Debian", filesAnalyzed: false,
      downloadLocation: "NOASSERTION", licenseConcluded: licence, licenseDeclared: licence, copyrightText: "NOASSERTION",
      sourceInfo: `source package ${one.source} ${one.sourceVersion}; libraries ${one.files.sort().join(", ")}`,
      licenseComments: names.length ? `named in /usr/share/doc/${one.name}/copyright: ${names.join("; ")}` : `see /usr/share/doc/${one.name}/copyright`,
      externalRefs: [{ referenceCategory: "PACKAGE-MANAGER", referenceType: "purl",
        referenceLocator: `pkg:deb/debian/${encodeURIComponent(one.name)}@${encodeURIComponent(one.version)}?arch=${one.arch}` }],
    });
    relationships.push({ spdxElementId: self.SPDXID, relationshipType: one.linked.length ? "DYNAMIC_LINK" : "DEPENDS_ON", relatedSpdxElement: id(`deb-${one.name}`) });
  }
  for (const one of npm) {
    const at = id(`npm-${one.path.replaceAll("node_modules/", "")}`);
    const hash = one.integrity?.startsWith("sha512-") ? Buffer.from(one.integrity.slice(7), "base64").toString("hex") : null;
    packages.push({
      SPDXID: at, name: one.name, versionInfo: one.version, downloadLocation: "NOASSERTION", filesAnalyzed: false,
      licenseConcluded: one.licence, licenseDeclared: one.licence, copyrightText: "NOASSERTION",
      ...(one.name === "three" ? { licenseComments: DRACO } : {}),
      ...(hash ? { checksums: [{ algorithm: "SHA512", checksumValue: hash }] } : {}),
      externalRefs: [{ referenceCategory: "PACKAGE-MANAGER", referenceType: "purl", referenceLocator: `pkg:npm/${one.name.replace("@", "%40")}@${one.version}` }],
    });
    relationships.push({ spdxElementId: self.SPDXID, relationshipType: "CONTAINS", relatedSpdxElement: at });
  }
  const seconds = process.env.SOURCE_DATE_EPOCH ? Number(process.env.SOURCE_DATE_EPOCH) : Math.floor(Date.now() / 1000);
  const hash = createHash("sha256").update(JSON.stringify(packages)).digest("hex").slice(0, 32);
  return {
    spdxVersion: "SPDX-2.3", dataLicense: "CC0-1.0", SPDXID: "SPDXRef-DOCUMENT", name: `citysplat-${version}`,
    documentNamespace: `https://spdx.org/spdxdocs/citysplat-${version}-${hash}`,
    creationInfo: { created: new Date(1000 * seconds).toISOString().replace(/\.\d+Z/, "Z"), creators: ["Tool: citysplat-sbom"] },
    hasExtractedLicensingInfos: [{ licenseId: "LicenseRef-SQLite-public-domain", name: "public domain",
      extractedText: "The author disclaims copyright to this source code. https://sqlite.org/copyright.html" }],
    packages, relationships,
  };
}

// ---- the page

function page(files) {
  const rows = packagesOf(libraries(files)).filter((one) => one.linked.length).map((one) => {
    const { licence, what } = linkedOf(one.name);
    return `| ${one.linked.sort().join(", ")} | ${one.name} | ${licence.replace("LicenseRef-SQLite-public-domain", "public domain")} | ${what} |`;
  });
  const npm = new Map();
  for (const one of npmPackages()) npm.set(one.licence, [...(npm.get(one.licence) ?? []), one.name]);
  const list = [...npm.keys()].sort().map((licence) => `| ${licence} | ${[...new Set(npm.get(licence))].join(", ")} |`);
  return `# Licences

citysplat is under the Apache License 2.0 (\`LICENSE\`). This page names what it links and what the viewer contains. It is
written by \`node configs/deb/sbom.mjs --page docs/licences.md PROGRAM LIBRARY...\`; do not edit it.

The Debian package has an SBOM with versions, in SPDX 2.3: \`/usr/share/doc/citysplat/sbom.spdx.json\`. It also names the
libraries that these libraries load (OpenImageIO and GDAL bring some 250), each with its Debian package, its version and
the licences that its copyright file names. Some of those are under the GPL (poppler, which Debian's GDAL loads). This matters for
whoever ships the program together with them; the Debian package of citysplat contains none of them.

## Libraries that the program links

| library | Debian package | licence | what for |
|---|---|---|---|
${rows.join("\n")}

At run time it needs an OpenCL driver, PoCL (MIT) for CPUs. \`align\` runs COLMAP (BSD-3-Clause) as a
program of its own.

## What the viewer contains

npm's packages of \`web/package-lock.json\` that are in the viewer and the module, by licence. Their texts are in
\`/usr/share/doc/citysplat/licences-npm.txt\`.

| licence | packages |
|---|---|
${list.join("\n")}

${DRACO}
`;
}

// ---- command line

const options = {}, files = [];
for (let k = 2; k < process.argv.length; k++) {
  const word = process.argv[k];
  if (word.startsWith("--")) options[word.slice(2)] = process.argv[++k];
  else files.push(word);
}
try {
  for (const file of files) if (!existsSync(file)) throw new Error(`${file}: no such file`);
  if (options.texts) writeFileSync(options.texts, texts());
  if (options.sbom) writeFileSync(options.sbom, `${JSON.stringify(sbom(options.version ?? "0", files), null, 1)}\n`);
  if (options.page) writeFileSync(options.page, page(files));
  if (options.check && readFileSync(options.check, "utf8") !== page(files))
    throw new Error(`${options.check} is not what is linked and locked; write it again with --page (${files.map((file) => basename(file)).join(" ")})`);
} catch (failed) {
  console.error(`sbom: error: ${failed.message}`);
  process.exit(1);
}
