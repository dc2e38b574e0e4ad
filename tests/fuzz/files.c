/* Fuzz targets that read from disk: a checkpoint, a COLMAP model, polygons. Each input is written
 * to a folder in memory, one for the process.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _XOPEN_SOURCE 700
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "codec/container/geojson.h"
#include "codec/scene/colmap.h"
#include "codec/scene/odm.h"
#include "tests/fuzz/fuzz.h"

enum { CKPT_HEAD = 64, CKPT_ENTRY = 64, CKPT_HASHED = 24, COLMAP_HEAD = 5, ODM_HEAD = 3 };

static char folder[64];
static const char *const names[] = {"x.ckpt",       "cameras.bin",   "images.bin",
                                    "points3D.bin", "cameras.txt",   "images.txt",
                                    "points3D.txt", "x.geojson",     "reconstruction.json",
                                    "tracks.csv",   "shots.geojson", "cameras.json"};

static void remove_folder(void)
{
    char path[96];
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        snprintf(path, sizeof path, "%s/%s", folder, names[i]);
        remove(path);
    }
    rmdir(folder);
}

/* The path of a file of `n` bytes in our folder. */
static const char *put(const char *name, const uint8_t *bytes, size_t n)
{
    static char path[96];
    if (!folder[0]) {
        snprintf(folder, sizeof folder, "%s/citysplat-fuzz-XXXXXX",
                 access("/dev/shm", W_OK) ? "/tmp" : "/dev/shm");
        assert(mkdtemp(folder));
        atexit(remove_folder);
    }
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *f = fopen(path, "wb");
    assert(f);
    size_t done = n ? fwrite(bytes, 1, n, f) : 0;
    assert(done == n && !fclose(f));
    return path;
}

static void drop(const char *name)
{
    char path[96];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    remove(path);
}

static uint64_t get(const uint8_t *p, size_t n)
{
    uint64_t v = 0;
    memcpy(&v, p, n);
    return v;
}

static void put_hash(uint8_t *to, struct hash128 h)
{
    memcpy(to, &h.lo, 8);
    memcpy(to + 8, &h.hi, 8);
}

/* Size and hashes are made right, or nothing behind them would ever be reached. */
static void mend(uint8_t *b, size_t n)
{
    uint64_t size = n;
    if (n < CKPT_HEAD)
        return;
    memcpy(b + 16, &size, 8);
    size_t sections = (size_t)get(b + 12, 4), room = (n - CKPT_HEAD) / CKPT_ENTRY;
    for (size_t i = 0; i < sections && i < room; i++) {
        uint8_t *entry = b + CKPT_HEAD + CKPT_ENTRY * i;
        uint64_t at = get(entry + 32, 8), len = get(entry + 40, 8);
        if (at <= n && len <= n - at)
            put_hash(entry + 48, hash_bytes(b + at, (size_t)len));
    }
    struct buf head = {0};
    buf_add(&head, b, CKPT_HASHED);
    if (sections <= room)
        buf_add(&head, b + CKPT_HEAD, CKPT_ENTRY * sections);
    put_hash(b + CKPT_HASHED, hash_bytes(head.data, head.size));
    buf_free(&head);
}

void fuzz_ckpt(const uint8_t *bytes, size_t n)
{
    struct ckpt c;
    struct ckpt_rows *rows = NULL;
    uint8_t *copy = mem_array(n, 1);
    assert(copy);
    if (n)
        memcpy(copy, bytes, n);
    mend(copy, n);
    const char *path = put("x.ckpt", copy, n);
    enum err_code whole = ckpt_read(path, &c, NULL), sliced = ckpt_rows_open(path, &rows, NULL);
    if (whole == ERR_OK && sliced == ERR_OK && c.g.n == ckpt_rows_count(rows)) {
        struct gauss g;
        enum err_code rc = ckpt_rows_read(rows, 0, c.g.n, &g, NULL);
        assert(!rc && g.n == c.g.n && !memcmp(g.mean_m, c.g.mean_m, 12 * g.n));
        gauss_free(&g);
    }
    ckpt_rows_close(&rows);
    ckpt_free(&c);
    mem_free(copy);
}

/* Byte 0: text or binary; then two lengths of 16 bits: cameras, images; the rest is points. What is
 * read must be whole: indices in range, and the same again after writing. */
void fuzz_colmap(const uint8_t *bytes, size_t n)
{
    struct colmap_model m, again;
    if (n < COLMAP_HEAD)
        return;
    size_t first = bytes[0] & 1 ? 4 : 1, left = n - COLMAP_HEAD;
    size_t cameras = (size_t)get(bytes + 1, 2), images = (size_t)get(bytes + 3, 2);
    cameras = cameras < left ? cameras : left;
    images = images < left - cameras ? images : left - cameras;
    bytes += COLMAP_HEAD;
    put(names[first], bytes, cameras);
    put(names[first + 1], bytes + cameras, images);
    put(names[first + 2], bytes + cameras + images, left - cameras - images);
    if (colmap_read(folder, &m, NULL) == ERR_OK) {
        for (size_t i = 0; i < m.n_images; i++)
            assert(m.images[i].camera < m.n_cameras);
        for (size_t i = 0; i < m.n_tracks; i++)
            assert(m.tracks[i].image < m.n_images &&
                   m.tracks[i].obs < m.images[m.tracks[i].image].n_obs);
        enum err_code rc = colmap_write_bin(folder, &m, NULL);
        assert(!rc);
        rc = colmap_read(folder, &again, NULL);
        assert(!rc && again.n_cameras == m.n_cameras && again.n_images == m.n_images &&
               again.n_points == m.n_points && again.n_tracks == m.n_tracks);
        colmap_free(&again);
    }
    colmap_free(&m);
    for (size_t i = 1; i < sizeof names / sizeof *names; i++)
        drop(names[i]);
}

/* Byte 0: reconstruction.json with tracks.csv, or shots.geojson with cameras.json; then the length
 * of the first in 16 bits. What is read is a model that can be written and read again. */
void fuzz_odm(const uint8_t *bytes, size_t n)
{
    struct odm_project p;
    struct colmap_model again = {0};
    if (n < ODM_HEAD)
        return;
    size_t left = n - ODM_HEAD, first = (size_t)get(bytes + 1, 2), k = bytes[0] & 1 ? 10 : 8;
    first = first < left ? first : left;
    put(names[k], bytes + ODM_HEAD, first);
    put(names[k + 1], bytes + ODM_HEAD + first, left - first);
    if (odm_read(folder, &p, NULL) == ERR_OK) {
        for (size_t i = 0; i < p.model.n_images; i++)
            assert(!p.places[i].known ||
                   (fabs(p.places[i].lat_deg) <= 90 && fabs(p.places[i].lon_deg) <= 180));
        enum err_code rc = colmap_write_bin(folder, &p.model, NULL);
        assert(!rc);
        rc = colmap_read(folder, &again, NULL);
        assert(!rc && again.n_images == p.model.n_images && again.n_points == p.model.n_points &&
               again.n_tracks == p.model.n_tracks);
        colmap_free(&again);
    }
    odm_free(&p);
    for (size_t i = 1; i < sizeof names / sizeof *names; i++)
        drop(names[i]);
}

/* What is read are closed rings on the globe, and asking for a place ends. */
void fuzz_geojson(const uint8_t *bytes, size_t n)
{
    struct geojson_area a;
    if (geojson_read(put("x.geojson", bytes, n), &a, NULL) == ERR_OK) {
        assert(a.n && a.n_polygons && a.n_rings);
        for (size_t i = 0; i < a.n; i++) {
            const struct geojson_edge *edge = &a.edges[i];
            assert(fabs(edge->from[0]) <= 180 && fabs(edge->from[1]) <= 90);
            assert(edge->polygon < a.n_polygons && edge->ring < a.n_rings);
            bool last = i + 1 == a.n || a.edges[i + 1].ring != edge->ring;
            assert(last || !memcmp(edge->to, a.edges[i + 1].from, sizeof edge->to));
        }
        (void)geojson_holds(a.edges, a.n, a.edges[0].from[0], a.edges[0].from[1]);
    }
    geojson_free(&a);
}

/* ---- seeds ---- */

bool fuzz_seed_ckpt(const struct gauss *g, struct buf *out)
{
    json_t *meta = json_pack("{s:i, s:s}", "level", 2, "id", "x1y2");
    const struct ckpt_blob blob = {"camera", "0123456789", 10};
    const char *path = put("x.ckpt", NULL, 0);
    enum err_code rc = ckpt_write(path, meta, g, &blob, 1, NULL);
    if (!rc)
        rc = file_read(path, 0, out, NULL);
    json_decref(meta);
    return !rc;
}

bool fuzz_seed_geojson(size_t i, struct buf *out)
{
    static const char *const seeds[] = {
        "{\"type\":\"Polygon\",\"coordinates\":[[[7,47],[8,47],[8,48],[7,48],[7,47]],"
        "[[7.2,47.2],[7.4,47.2],[7.2,47.4],[7.2,47.2]]]}",
        "// a "
        "city\n{\"type\":\"FeatureCollection\",\"features\":[{\"type\":\"Feature\",\"geometry\":"
        "{\"type\":\"MultiPolygon\",\"coordinates\":[[[[7,47],[8,47],[8,48],[7,47]]],"
        "[[[9,47],[9.5,47],[9.5,48],[9,47]]]]}}]}",
        "{\"type\":\"GeometryCollection\",\"crs\":{\"type\":\"name\",\"properties\":{\"name\":"
        "\"urn:ogc:def:crs:OGC:1.3:CRS84\"}},\"geometries\":[{\"type\":\"Point\",\"coordinates\":["
        "7,47]},"
        "{\"type\":\"Polygon\",\"coordinates\":[[[-180,-90,3],[180,-90,3],[0,90,3],[-180,-90,3]]]}]"
        "}"};
    buf_printf(out, "%s", seeds[i]);
    return !out->failed;
}

/* Two photographs, with a point or from the report alone. */
bool fuzz_seed_odm(size_t i, struct buf *out)
{
    static const char lens[] = "\"c\":{\"projection_type\":\"brown\",\"width\":40,\"height\":30,"
                               "\"focal_x\":0.8,\"focal_y\":0.8,\"k1\":0.01}";
    struct buf part[2] = {{0}};
    if (i == 2) {
        buf_printf(&part[0], "{\"features\":[");
        for (int k = 0; k < 2; k++)
            buf_printf(&part[0],
                       "%s{\"properties\":{\"filename\":\"%d.jpg\",\"focal\":0.8,\"width\":40,"
                       "\"height\":30,\"translation\":[500000,5000000,%d],\"rotation\":[3,0,0.%d]}"
                       ",\"geometry\":{\"coordinates\":[8,47,300]}}",
                       k ? "," : "", k, k, k);
        buf_printf(&part[0], "]}");
        buf_printf(&part[1], "{%s}", lens);
    } else {
        buf_printf(&part[0], "[{\"cameras\":{%s},\"shots\":{", lens);
        for (int k = 0; k < 2; k++)
            buf_printf(&part[0],
                       "%s\"%d.jpg\":{\"rotation\":[0,0,0.%d],\"translation\":[%d,0,0],"
                       "\"camera\":\"c\"}",
                       k ? "," : "", k, k, k);
        buf_printf(&part[0],
                   "},\"points\":{\"7\":{\"coordinates\":[0,0,5],\"color\":[1,2,3]}},"
                   "\"reference_lla\":{\"latitude\":47,\"longitude\":8,\"altitude\":0}}]");
        if (i == 0)
            buf_printf(&part[1],
                       "OPENSFM_TRACKS_VERSION_v2\n0.jpg\t7\t1\t0.1\t0\n1.jpg\t7\t2\t0\t0\n");
    }
    buf_u8(out, i == 2);
    buf_u16(out, (uint32_t)part[0].size);
    for (int k = 0; k < 2; k++) {
        buf_add(out, part[k].data, part[k].size);
        buf_free(&part[k]);
    }
    return !out->failed;
}

/* Two photographs of one point. */
bool fuzz_seed_colmap(size_t i, struct buf *out)
{
    struct buf part[3] = {{0}};
    if (i == 0) {
        buf_printf(&part[0], "1 PINHOLE 640 480 500 510 320 240\n");
        for (int k = 1; k <= 2; k++)
            buf_printf(&part[1], "%d 1 0 0 0 0.5 -1 2 1 p%d.jpg\n10.5 20.5 7 30 40 -1\n", k, k);
        buf_printf(&part[2], "7 1.5 2.5 3.5 10 20 30 0.7 1 0 2 0\n");
    } else {
        buf_u64(&part[0], 1);
        buf_u32(&part[0], 1);
        buf_u32(&part[0], i == 1 ? 1 : 2); /* PINHOLE, SIMPLE_RADIAL: four numbers each */
        buf_u64(&part[0], 640);
        buf_u64(&part[0], 480);
        const double lens[4] = {500, i == 1 ? 510 : 320, i == 1 ? 320 : 240, i == 1 ? 240 : 0.01};
        buf_add(&part[0], lens, sizeof lens);
        buf_u64(&part[1], 2);
        for (uint32_t k = 1; k <= 2; k++) {
            const double pose[7] = {1, 0, 0, 0, 0.5, -1, 2}, at[2] = {10.5, 20.5};
            buf_u32(&part[1], k);
            buf_add(&part[1], pose, sizeof pose);
            buf_u32(&part[1], 1);
            buf_printf(&part[1], "p%u.jpg", k);
            buf_u8(&part[1], 0);
            buf_u64(&part[1], 1);
            buf_add(&part[1], at, sizeof at);
            buf_u64(&part[1], 7);
        }
        const double xyz[3] = {1.5, 2.5, 3.5}, error = 0.7;
        buf_u64(&part[2], 1);
        buf_u64(&part[2], 7);
        buf_add(&part[2], xyz, sizeof xyz);
        buf_add(&part[2], "\12\24\36", 3);
        buf_add(&part[2], &error, sizeof error);
        buf_u64(&part[2], 2);
        for (uint32_t k = 1; k <= 2; k++) {
            buf_u32(&part[2], k);
            buf_u32(&part[2], 0);
        }
    }
    buf_u8(out, i == 0);
    buf_u16(out, (uint32_t)part[0].size);
    buf_u16(out, (uint32_t)part[1].size);
    for (int k = 0; k < 3; k++) {
        buf_add(out, part[k].data, part[k].size);
        buf_free(&part[k]);
    }
    return !out->failed;
}
