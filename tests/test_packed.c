/* Exported files as datasets: what a 3TZ and a PMTiles answer is what is in them, from a file and
 * from a server of objects that misbehaves; damaged, cut and hostile ones are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/ranges_kit.h"

#include "tests/client.h"

#include <zip.h>
#include <zlib.h>

#include "codec/package.h"
#include "lod/blocks.h"
#include "lod/remote.h"
#include "server/packed.h"

enum { TILES = 6, TILE_BYTES = 90000, ZOOM = 17, MAP_ZOOM_MIN = 15, MAP_ZOOM_MAX = 17 };
static const uint32_t TILE_X = 70406, TILE_Y = 43000;

static struct {
    char dir[FILE_PATH_MAX], cache[FILE_PATH_MAX], files[FILE_PATH_MAX];
    char tiles[FILE_PATH_MAX], deflated[FILE_PATH_MAX], map[FILE_PATH_MAX], at[FILE_PATH_MAX];
    char *names[TILES + 2];
    struct arena arena;
    unsigned seed; /* of contents */
} p;

/* ---- the files ---- */

static void tile_bytes(size_t i, struct buf *b)
{
    uint8_t *to = buf_grow(b, TILE_BYTES + i);
    for (size_t k = 0; k < TILE_BYTES + i; k++) /* a half that deflate makes smaller */
        to[k] = (uint8_t)(k % 2 ? rng_u64(p.seed, i, k) : 7);
}

static void document(struct buf *b)
{
    struct geo_origin origin = {13.4, 52.5, 40};
    double m[16];
    struct err e = {0};
    kit_ok(geo_enu_to_ecef(&origin, m, &e), e);
    buf_printf(b,
               "{\"asset\":{\"version\":\"1.1\",\"tilesetVersion\":\"%012x\",\"extras\":{"
               "\"cesium\":{\"credits\":[{\"html\":\"a test\"}]}}},\"geometricError\":9,"
               "\"root\":{\"transform\":[",
               p.seed);
    for (int i = 0; i < 16; i++)
        buf_printf(b, "%s%.17g", i ? "," : "", m[i]);
    buf_printf(b,
               "],\"boundingVolume\":{\"box\":[0,0,0,100,0,0,0,100,0,0,0,20]},"
               "\"content\":{\"uri\":\"t/%d/%u/%u.glb\"},\"children\":[",
               ZOOM, TILE_X, TILE_Y);
    for (unsigned i = 1; i < TILES; i++)
        buf_printf(b, "%s{\"content\":{\"uri\":\"t/%d/%u/%u.glb\"}}", i > 1 ? "," : "", ZOOM,
                   TILE_X, TILE_Y + i);
    buf_printf(b, ",{\"content\":{\"uri\":\"tileset/17/1/2.json\"}}]}}\n");
}

/* What file i of the tileset holds. */
static void file_bytes(size_t i, struct buf *b)
{
    if (i == 0 || i == TILES + 1)
        document(b);
    else
        tile_bytes(i - 1, b);
}

static void make_tiles(const char *path)
{
    struct err e = {0};
    char at[FILE_PATH_MAX];
    for (size_t i = 0; i < TILES + 2; i++) {
        struct buf b = {0};
        file_bytes(i, &b);
        kit_ok(file_join(at, p.files, p.names[i], &e), e);
        *strrchr(at, '/') = '\0';
        kit_ok(file_mkdir(at, &e), e);
        kit_ok(file_join(at, p.files, p.names[i], &e), e);
        kit_ok(file_write(at, b.data, b.size, &e), e);
        buf_free(&b);
    }
    kit_ok(package_write(p.files, p.names, TILES + 2, path, &e), e);
}

/* The same files, as any program writes a zip archive, with a folder and a comment. */
static void make_deflated(const char *path)
{
    struct err e = {0};
    char at[FILE_PATH_MAX];
    int why;
    zip_t *z = zip_open(path, ZIP_CREATE | ZIP_TRUNCATE, &why);
    assert_non_null(z);
    assert_true(zip_dir_add(z, "t", 0) >= 0);
    for (size_t i = 0; i < TILES + 2; i++) {
        kit_ok(file_join(at, p.files, p.names[i], &e), e);
        assert_true(zip_file_add(z, p.names[i], zip_source_file(z, at, 0, -1), 0) >= 0);
    }
    assert_int_equal(zip_set_archive_comment(z, "a comment", 9), 0);
    assert_int_equal(zip_close(z), 0);
}

static void map_bytes(struct key k, struct buf *b)
{
    buf_printf(b, "tile %u/%u/%u of %u", k.z, k.x, k.y, p.seed);
    for (unsigned i = 0; i < 3000 + k.x % 7; i++)
        buf_u8(b, (unsigned)rng_u64(k.x, k.y, i));
}

/* Columns 5 and 6 of a zoom; of the tile 17/5/1 there are two alike. */
static void make_map(const char *path)
{
    struct err e = {0};
    struct pmtiles *out = NULL;
    const struct pmtiles_about about = {
        .type = PMTILES_WEBP,
        .zoom_min = MAP_ZOOM_MIN,
        .zoom_max = MAP_ZOOM_MAX,
        .zoom_center = 16,
        .bbox_deg = {13, 52, 13.5, 52.5},
        .metadata = "{\"attribution\":\"a map\",\"revision\":\"0123456789ab\"}"};
    kit_ok(pmtiles_begin(path, &out, &e), e);
    for (unsigned z = MAP_ZOOM_MIN; z <= MAP_ZOOM_MAX; z++) {
        struct buf b = {0};
        map_bytes((struct key){(uint8_t)z, 5, 1}, &b);
        const uint64_t id = pmtiles_id((uint8_t)z, 5, 1);
        for (uint64_t i = 0; i < 2; i++)
            kit_ok(pmtiles_add(out, id + i, b.data, b.size, &e), e);
        buf_free(&b);
    }
    kit_ok(pmtiles_commit(&out, &about, &e), e);
}

static int packed_setup_all(void **state)
{
    struct err e = {0};
    (void)state;
    log_set_level(LOG_ERROR);
    kit_tmpdir(p.dir);
    p.names[0] = arena_text(&p.arena, "tileset.json");
    for (unsigned i = 0; i < TILES; i++)
        p.names[i + 1] =
            arena_printf(&p.arena, "t/%d/%u/%u.glb", ZOOM, TILE_X, (unsigned)TILE_Y + i);
    p.names[TILES + 1] = arena_text(&p.arena, "tileset/17/1/2.json");
    kit_ok(file_join(p.cache, p.dir, "cache", &e), e);
    kit_ok(file_join(p.files, p.dir, "files", &e), e);
    kit_ok(file_join(p.tiles, p.dir, "city.3tz", &e), e);
    kit_ok(file_join(p.deflated, p.dir, "other.3tz", &e), e);
    kit_ok(file_join(p.map, p.dir, "plan.pmtiles", &e), e);
    ranges_start();
    remote_patience(5);
    return 0;
}

static int packed_teardown_all(void **state)
{
    (void)state;
    ranges_stop();
    arena_free(&p.arena);
    kit_rmdir(p.dir);
    return 0;
}

static int packed_setup(void **state)
{
    (void)state;
    p.seed = 1;
    make_tiles(p.tiles);
    make_deflated(p.deflated);
    make_map(p.map);
    kit_rmdir(p.cache);
    blocks_configure(p.cache, (uint64_t)1 << 30);
    atomic_store(&ranges.way, RANGES_WELL);
    return 0;
}

static const char *far(const char *name)
{
    static char url[80];
    snprintf(url, sizeof url, "http://127.0.0.1:%u/%s?sig=a/b.tiles", ranges.port, name);
    return url;
}

/* ---- served ---- */

static void serve(const char *path)
{
    arena_free(&t.arena);
    served_config(&t.cfg, &t.arena);
    t.cfg.device = NULL; /* yet nothing is drawn, and no process is there to draw */
    t.cfg.cache_dir = p.cache;
    t.cfg.remote_refresh_s = 0;
    t.cfg.deadline_s = 1.5;
    t.cfg.workers = 2;
    t.cfg.http_threads = 2;
    t.paths[0] = path;
    start();
}

/* Address of a file of the 3TZ, in the revision that is served. */
static const char *address(const char *name)
{
    static char text[160];
    struct catalog *c = services_catalog(server_services(t.server));
    snprintf(text, sizeof text, "/d/%s/r/%s/%s", c->ds[0]->meta.name, revision_of(EDITION_TILES),
             name);
    catalog_drop(&c);
    return text;
}

static void assert_body(const char *target, const char *type, const struct buf *want)
{
    struct reply x;
    ask("GET", target, "", &x);
    if (x.status != 200)
        fail_msg("%s: %d %.300s", target, x.status, (const char *)x.raw.data);
    assert_string_equal(header(&x, "Content-Type"), type);
    assert_non_null(strstr(header(&x, "Cache-Control"), "immutable"));
    assert_int_equal(x.body_size, want->size);
    assert_memory_equal(x.body, want->data, want->size);
    char same[128];
    snprintf(same, sizeof same, "If-None-Match: %s\r\n", header(&x, "ETag"));
    buf_free(&x.raw);
    assert_int_equal(status_of("GET", target, same), 304);
    assert_int_equal(status_of("GET", target, "Range: bytes=1-3\r\n"),
                     strstr(type, "json") ? 200 : 206);
}

static void assert_all_files(void)
{
    for (size_t i = 0; i < TILES + 2; i++) {
        struct buf b = {0};
        file_bytes(i, &b);
        assert_body(address(p.names[i]),
                    strstr(p.names[i], ".glb") ? "model/gltf-binary" : "application/json", &b);
        buf_free(&b);
    }
}

static void assert_says(const char *target, int status, const char *text)
{
    struct reply x;
    ask("GET", target, "", &x);
    buf_u8(&x.raw, 0);
    if (x.status != status || !strstr((const char *)x.raw.data, text))
        fail_msg("%s: expected %d %s, got %.900s", target, status, text, (const char *)x.raw.data);
    buf_free(&x.raw);
}

static void a_3tz_is_its_files(void **state)
{
    const char *const paths[] = {p.tiles, p.deflated, far("city.3tz")};
    struct reply x;
    (void)state;
    ranges_serve(p.tiles, "one");
    for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
        serve(paths[i]);
        assert_all_files();
        char entry[64], uri[80], moving[80];
        snprintf(entry, sizeof entry, "/d/%s/tileset.json", i == 1 ? "other" : "city");
        ask("GET", entry, "", &x);
        assert_int_equal(x.status, 200);
        buf_u8(&x.raw, 0);
        snprintf(uri, sizeof uri, "\"r/%s/%s\"", revision_of(EDITION_TILES), p.names[1]);
        assert_non_null(strstr((const char *)x.body, uri)); /* and none of another revision */
        assert_null(strstr((const char *)x.body, "\"t/"));
        buf_free(&x.raw);
        snprintf(moving, sizeof moving, "/d/%s/%s", i == 1 ? "other" : "city", p.names[2]);
        ask("GET", moving, "", &x);
        assert_int_equal(x.status, 307);
        assert_non_null(strstr(header(&x, "Location"), revision_of(EDITION_TILES)));
        buf_free(&x.raw);
        assert_int_equal(status_of("HEAD", address(p.names[1]), ""), 200);
        server_stop(&t.server);
    }
}

static void what_a_3tz_lacks_is_told(void **state)
{
    (void)state;
    serve(p.tiles);
    assert_says(address("t/17/1/1.glb"), 404, "no such file");
    assert_says(address("t/17/70406/43000.spz"), 404, ".glb alone");
    assert_says(address("t/17/70406/43000.glb?preset=preview"), 404, "one form");
    assert_says(address("t/17/70406/43000.glb?clip=1,1,2,1,2,2"), 404, "one form");
    assert_says("/d/city/tileset.json?sh=0", 404, "one form");
    for (const char *const *path =
             (const char *const[]){"map.json", "style.json", "wmts.xml", "seed.ndjson",
                                   "appearances", "height?lon=13&lat=52", "map/17/1/1.png",
                                   "static/13,52,100@0,-30/64x64.jpg", "motion/0123456789abcdef",
                                   NULL};
         *path; path++) {
        char target[96];
        snprintf(target, sizeof target, "/d/city/%s", *path);
        assert_says(target, 404, "exported 3TZ, which has tileset.json");
    }
    struct reply x;
    assert_int_equal(post_text("/d/city/render", "{}", &x), 404);
    buf_free(&x.raw);
    assert_says("/collections/city/tiles.json", 404, "exported 3TZ");
    assert_says("/collections/city", 200, "\"3tz\"");
    assert_says("/collections", 200, "\"a test\"");
    assert_says("/collections?bbox=13.3,52.4,13.5,52.6", 200, "city");
    assert_says("/collections?bbox=1,2,3,4", 200, "\"collections\": []");
    assert_int_equal(status_of("GET", "/readyz", ""), 200);
    assert_int_equal(status_of("GET", "/", ""), 200);
    assert_int_equal(status_of("GET", "/metrics", ""), 200);
    server_stop(&t.server);
}

static void a_map_is_its_tiles(void **state)
{
    const char *const paths[] = {p.map, far("plan.pmtiles")};
    (void)state;
    ranges_serve(p.map, "one");
    for (size_t i = 0; i < 2; i++) {
        serve(paths[i]);
        assert_string_equal(t.rev, "0123456789ab");
        for (unsigned z = MAP_ZOOM_MIN; z <= MAP_ZOOM_MAX; z++) {
            struct buf b = {0};
            char name[40];
            map_bytes((struct key){(uint8_t)z, 5, 1}, &b);
            snprintf(name, sizeof name, "map/%u/5/1.webp", z);
            assert_body(address(name), "image/webp", &b);
            buf_free(&b);
            snprintf(name, sizeof name, "map/%u/9/9.webp", z);
            assert_int_equal(status_of("GET", address(name), ""), 204);
        }
        assert_says("/d/plan/map.json", 200, address("map/{z}/{x}/{y}.webp"));
        assert_says("/d/plan/map.json?appearance=x", 404, "one appearance");
        assert_says(address("map/17/5/1.png"), 404, "z/x/y.webp");
        assert_says(address("map/17/5/1@2x.webp"), 404, "z/x/y.webp");
        assert_says(address("map/18/5/1.webp"), 404, "zooms 15 to 17");
        assert_int_equal(status_of("GET", "/d/plan/map/17/5/1.webp", ""), 307);
        assert_says("/d/plan/terrain/17/5/1.png", 404, "exported PMTiles");
        assert_says("/d/plan/tileset.json", 404, "exported PMTiles");
        assert_says("/collections/plan", 200, "map.json");
        server_stop(&t.server);
    }
}

/* As stores do: what is kept is served, the rest is 503 until the server of the object answers. */
static void a_package_waits_for_its_server(void **state)
{
    static const int ways[] = {RANGES_BUSY, RANGES_CUT};
    (void)state;
    ranges_serve(p.tiles, "one");
    for (size_t i = 0; i < 2; i++) {
        kit_rmdir(p.cache);
        atomic_store(&ranges.way, ways[i]);
        serve(far("city.3tz"));
        assert_all_files();
        server_stop(&t.server);
    }
    kit_rmdir(p.cache);
    atomic_store(&ranges.way, RANGES_WELL);
    serve(far("city.3tz"));
    assert_int_equal(status_of("GET", address(p.names[TILES]), ""), 200);
    atomic_store(&ranges.way, RANGES_DOWN);
    assert_int_equal(status_of("GET", address(p.names[TILES]), ""), 200);
    assert_says(address(p.names[1]), 503, "Retry-After: ");
    assert_says("/readyz", 200, "\"ready\"");
    atomic_store(&ranges.way, RANGES_WELL);
    for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s; nap_ms(50))
        if (status_of("GET", address(p.names[1]), "") == 200)
            break;
    assert_int_equal(status_of("GET", address(p.names[1]), ""), 200);
    server_stop(&t.server);
}

static void a_replaced_package_is_opened_again(void **state)
{
    struct err e = {0};
    char old[160];
    (void)state;
    ranges_serve(p.tiles, "one");
    serve(far("city.3tz"));
    assert_int_equal(status_of("GET", address(p.names[TILES]), ""), 200);
    snprintf(old, sizeof old, "%s", address(p.names[TILES]));
    kit_ok(server_reload(t.server, &e), e); /* the same: nothing happens */
    assert_string_equal(address(p.names[TILES]), old);
    p.seed = 2;
    make_tiles(p.tiles);
    ranges_serve(p.tiles, "two");
    assert_says(address(p.names[1]), 503, "Retry-After: "); /* never bytes of two revisions */
    server_look(t.server, clock_s());
    assert_true(server_reload_asked(t.server));
    kit_ok(server_reload(t.server, &e), e);
    struct catalog *c = services_catalog(server_services(t.server));
    assert_int_equal(c->n, 2);
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
    catalog_drop(&c);
    assert_string_equal(t.rev, "000000000002");
    assert_all_files();
    assert_int_equal(status_of("GET", old, ""), 200); /* it was kept */
    ranges_serve("/etc/passwd", "three");
    kit_fails(server_reload(t.server, &e), ERR_FORMAT, e, "no zip archive");
    assert_all_files();
    server_stop(&t.server);
}

/* ---- what is refused ---- */

static enum err_code try(const char *ending, const void *bytes, size_t n, struct err *e)
{
    struct packed *x = NULL;
    char name[32];
    snprintf(name, sizeof name, "try%s", ending);
    kit_ok(file_join(p.at, p.dir, name, e), *e);
    FILE *file = fopen(p.at, "wb"); /* file_write would wait for the disk each time */
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, n, file), n);
    assert_int_equal(fclose(file), 0);
    enum err_code rc = packed_open(p.at, 1, &x, e);
    assert_true(rc ? !x : x != NULL);
    struct packed_part part;
    struct buf b = {0};
    if (x && packed_find_file(x, p.names[1], strlen(p.names[1]), &part))
        (void)!packed_read(x, &part, &b, NULL);
    if (x && packed_find_tile(x, (struct key){17, 5, 1}, &part))
        (void)!packed_read(x, &part, &b, NULL);
    buf_free(&b);
    packed_close(&x);
    return rc;
}

/* Cut anywhere it is refused; with any byte changed outside of the tiles it is refused or read. */
static void cut_and_changed_ones(void **state)
{
    const char *const paths[] = {p.tiles, p.deflated, p.map}, *const endings[] = {".3tz", ".3tz",
                                                                                  ".pmtiles"};
    struct err e = {0};
    (void)state;
    for (size_t i = 0; i < 3; i++) {
        struct buf b = {0};
        size_t n_refused = 0, n_tried = 0;
        kit_ok(file_read(paths[i], 0, &b, &e), e);
        kit_ok(try(endings[i], b.data, b.size, &e), e);
        for (size_t n = 0; n < b.size; n += 1 + b.size / 97)
            assert_int_equal(try(endings[i], b.data, n, &e), ERR_FORMAT);
        const size_t end = i < 2 ? b.size : 127 + 60, from = end > 900 ? end - 900 : 0;
        for (size_t at = from; at < end; at++) {
            const uint8_t was = b.data[at];
            b.data[at] = (uint8_t)(was ^ (at % 3 ? 0xff : 0x40));
            n_refused += try(endings[i], b.data, b.size, &e) != ERR_OK;
            n_tried++;
            b.data[at] = was;
        }
        assert_in_range(n_refused, n_tried / 10, n_tried);
        buf_free(&b);
    }
}

static void put(struct buf *b, size_t at, uint64_t v, size_t n)
{
    for (size_t k = 0; k < n; k++)
        b->data[at + k] = (uint8_t)(v >> (8 * k));
}

/* The first record of this kind behind `from`. */
static size_t record(const struct buf *b, const char *magic, size_t from)
{
    for (size_t i = from; i + 4 <= b->size; i++)
        if (!memcmp(b->data + i, magic, 4))
            return i;
    fail_msg("no record");
    return 0;
}

static void hostile_archives(void **state)
{
    static const struct {
        const char *record;
        size_t at, n;
        uint64_t value;
        enum err_code code;
        const char *says;
    } cases[] = {
        {"PK\1\2", 8, 2, 1, ERR_FORMAT, "encrypted"},
        {"PK\1\2", 10, 2, 14, ERR_FORMAT, "not deflate"},
        {"PK\1\2", 42, 4, 0xfffffff0, ERR_FORMAT, "within the archive"},
        {"PK\1\2", 20, 4, 0xfffffff0, ERR_FORMAT, "within the archive"},
        {"PK\1\2", 24, 4, 0xfffffff0, ERR_FORMAT, "cannot be as many"},
        {"PK\1\2", 28, 2, 0xffff, ERR_FORMAT, "makes no sense"},
        {"PK\1\2", 0, 4, 0, ERR_FORMAT, "makes no sense"},
        {"PK\1\2", 46, 1, 'x', ERR_FORMAT, "no 3TZ"},
        {"PK\3\4", 0, 1, 'x', ERR_FORMAT, "does not begin"},
        {"PK\3\4", 26, 2, 0xffff, ERR_FORMAT, "checksum"},
        {"PK\5\6", 16, 4, 0xfffffff0, ERR_FORMAT, "lie within it"},
        {"PK\5\6", 12, 4, 0xfffffff0, ERR_FORMAT, "lie within it"},
        {"PK\5\6", 10, 2, 0xffff, ERR_FORMAT, "lie within it"},
    };
    struct err e = {0};
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct buf b = {0};
        kit_ok(file_read(p.tiles, 0, &b, &e), e);
        put(&b, record(&b, cases[i].record, 0) + cases[i].at, cases[i].value, cases[i].n);
        kit_fails(try(".3tz", b.data, b.size, &e), cases[i].code, e, cases[i].says);
        buf_free(&b);
    }
    /* two files of one name */
    struct buf b = {0};
    kit_ok(file_read(p.tiles, 0, &b, &e), e);
    const size_t one = record(&b, "PK\1\2", 0), two = record(&b, "PK\1\2", one + 4),
                 three = record(&b, "PK\1\2", two + 4);
    memcpy(b.data + three + 46, b.data + two + 46, strlen(p.names[1]));
    kit_fails(try(".3tz", b.data, b.size, &e), ERR_FORMAT, e, "one name");
    buf_free(&b);
}

/* An archive with this entry alone. */
static void refuses_entry(const char *text, const char *says)
{
    struct err e = {0};
    char *names[] = {p.names[0]};
    char at[FILE_PATH_MAX];
    struct buf b = {0};
    kit_ok(file_join(at, p.files, "tileset.json", &e), e);
    kit_ok(file_write(at, text, strlen(text), &e), e);
    kit_ok(file_join(at, p.dir, "made.3tz", &e), e);
    kit_ok(package_write(p.files, names, 1, at, &e), e);
    kit_ok(file_read(at, 0, &b, &e), e);
    kit_fails(try(".3tz", b.data, b.size, &e), ERR_FORMAT, e, says);
    buf_free(&b);
}

static void hostile_entries(void **state)
{
    struct buf deep = {0};
    (void)state;
    refuses_entry("no json", "no tileset");
    refuses_entry("{}", "asset is missing");
    refuses_entry("{\"asset\":{}}", "not one of citysplat export");
    refuses_entry("{\"asset\":{},\"root\":{}}", "no transform");
    refuses_entry("{\"asset\":{},\"root\":{\"content\":{\"uri\":\"../../etc/passwd\"}}}",
                  "../../etc/passwd");
    refuses_entry("{\"asset\":{},\"root\":{\"content\":{\"uri\":\"t/01/2/3.glb\"}}}",
                  "not one of citysplat export");
    refuses_entry("{\"asset\":{},\"root\":{\"content\":{\"uri\":\"t/1/2/3.glb\"}}}",
                  "names t/1/2/3.glb, which is not in it");
    refuses_entry("{\"asset\":{},\"root\":{\"transform\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"
                  "\"boundingVolume\":{\"box\":[1,2,3]}}}",
                  "no box");
    for (int i = 0; i < 500; i++)
        buf_printf(&deep, "%s", i ? "{\"children\":[" : "{\"asset\":{},\"root\":{\"children\":[");
    for (int i = 0; i < 499; i++)
        buf_printf(&deep, "]}");
    buf_printf(&deep, "]}}");
    refuses_entry((const char *)deep.data, "not one of citysplat export");
    buf_free(&deep);
}

/* A tile whose bytes are not those of its checksum is not sent. */
static void a_damaged_tile(void **state)
{
    struct err e = {0};
    struct buf b = {0};
    (void)state;
    kit_ok(file_read(p.tiles, 0, &b, &e), e);
    const size_t first = record(&b, "PK\3\4", 0), second = record(&b, "PK\3\4", first + 4);
    b.data[second + 5000] ^= 1;
    kit_ok(file_write(p.tiles, b.data, b.size, &e), e);
    buf_free(&b);
    serve(p.tiles);
    assert_says(address(p.names[1]), 500, "damaged");
    assert_int_equal(status_of("GET", address(p.names[2]), ""), 200);
    assert_says("/readyz", 200, "degraded");
    server_stop(&t.server);
}

/* ---- maps ---- */

static void number(struct buf *b, uint64_t v)
{
    for (; v >= 128; v >>= 7)
        buf_u8(b, (unsigned)(v & 127) | 128);
    buf_u8(b, (unsigned)v);
}

static void directory(struct buf *b, const uint64_t (*row)[4], size_t n)
{
    number(b, n);
    for (int column = 0; column < 4; column++)
        for (size_t i = 0; i < n; i++)
            number(b, row[i][column]);
}

/* A file with these directories, which are not compressed, and 100 bytes of tiles. */
static enum err_code try_map(const struct buf *root, const struct buf *leaves, unsigned packing,
                             unsigned type, struct err *e)
{
    struct buf b = {0};
    buf_add(&b, "PMTiles\3", 8);
    const uint64_t data = 127 + root->size + leaves->size;
    const uint64_t at[] = {127, root->size, 0, 0, 127 + root->size, leaves->size, data,
                           100, 1,          1, 1};
    for (size_t i = 0; i < sizeof at / sizeof *at; i++)
        buf_u64(&b, at[i]);
    const uint8_t kinds[] = {1, (uint8_t)packing, 1, (uint8_t)type, 0, 5};
    buf_add(&b, kinds, sizeof kinds);
    for (int i = 0; i < 25; i++)
        buf_u8(&b, 0);
    buf_add(&b, root->data, root->size);
    buf_add(&b, leaves->data, leaves->size);
    for (int i = 0; i < 100; i++)
        buf_u8(&b, 1);
    enum err_code rc = try(".pmtiles", b.data, b.size, e);
    buf_free(&b);
    return rc;
}

static void hostile_maps(void **state)
{
    enum { PLAIN = 1, GZIP, BROTLI };
    /* difference of ids, run, length, offset + 1 */
    static const struct {
        uint64_t root[2][4], leaf[2][4];
        size_t n_root, n_leaf;
        const char *says; /* NULL: it is read */
    } cases[] = {
        {{{0, 1, 100, 1}}, {{0}}, 1, 0, NULL},
        {{{0, 1, 50, 1}, {1, 1, 50, 0}}, {{0}}, 2, 0, NULL},
        {{{0, 1, 101, 1}}, {{0}}, 1, 0, "within the file"},
        {{{0, 1, 100, 2}}, {{0}}, 1, 0, "within the file"},
        {{{0, 1, 0, 1}}, {{0}}, 1, 0, "within the file"},
        {{{0, 1, 10, (uint64_t)1 << 62}}, {{0}}, 1, 0, "makes no sense"},
        {{{(uint64_t)1 << 62, 1, 10, 1}}, {{0}}, 1, 0, "makes no sense"},
        {{{0, (uint64_t)1 << 40, 10, 1}}, {{0}}, 1, 0, "makes no sense"},
        {{{0, 1, 10, 0}}, {{0}}, 1, 0, "makes no sense"},
        {{{0, 5, 10, 1}, {1, 1, 10, 1}}, {{0}}, 2, 0, "comes twice"},
        {{{0, 0, 5, 1}}, {{7, 1, 100, 1}}, 1, 1, NULL},
        {{{0, 0, 5, 1}, {9, 0, 5, 1}}, {{0, 1, 100, 1}}, 2, 1, "comes twice"},
        {{{0, 0, 5, 1}}, {{0, 0, 5, 1}}, 1, 1, "too deep"},
        {{{0, 0, 6, 1}}, {{0, 1, 100, 1}}, 1, 1, "within the file"},
        {{{0, 0, 1, 1}}, {{0}}, 1, 0, "without tiles"},
    };
    struct err e = {0};
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct buf root = {0}, leaf = {0};
        directory(&root, cases[i].root, cases[i].n_root);
        if (cases[i].n_leaf || (cases[i].says && strstr(cases[i].says, "without")))
            directory(&leaf, cases[i].leaf, cases[i].n_leaf);
        const enum err_code rc = try_map(&root, &leaf, PLAIN, PMTILES_PNG, &e);
        if (cases[i].says)
            kit_fails(rc, ERR_FORMAT, e, cases[i].says);
        else
            kit_ok(rc, e);
        buf_free(&root);
        buf_free(&leaf);
    }
    struct buf root = {0}, none = {0}, bomb = {0};
    directory(&root, cases[0].root, 1);
    kit_fails(try_map(&root, &none, BROTLI, PMTILES_PNG, &e), ERR_FORMAT, e, "not gzip");
    kit_fails(try_map(&root, &none, GZIP, PMTILES_PNG, &e), ERR_FORMAT, e, "not gzip");
    kit_fails(try_map(&root, &none, PLAIN, 1, &e), ERR_FORMAT, e, "maps of pictures");
    /* a directory of 64 MiB in 64 KiB */
    uint8_t *zeros = mem_array(1 << 26, 1), *to = buf_grow(&bomb, 1 << 20);
    z_stream z = {.next_in = zeros, .avail_in = 1 << 26, .next_out = to, .avail_out = 1 << 20};
    assert_int_equal(deflateInit2(&z, 9, Z_DEFLATED, 15 + 16, 9, Z_DEFAULT_STRATEGY), Z_OK);
    assert_int_equal(deflate(&z, Z_FINISH), Z_STREAM_END);
    bomb.size = z.total_out;
    deflateEnd(&z);
    mem_free(zeros);
    kit_fails(try_map(&bomb, &none, GZIP, PMTILES_PNG, &e), ERR_LIMIT, e, "more than 16 MiB");
    put(&bomb, bomb.size - 4, 100, 4); /* and one that lies */
    kit_fails(try_map(&bomb, &none, GZIP, PMTILES_PNG, &e), ERR_FORMAT, e, "not gzip");
    buf_free(&root);
    buf_free(&bomb);
}

static void names_and_options(void **state)
{
    struct err e = {0};
    struct packed *x = NULL;
    struct dataset *d = NULL;
    struct clip *some = (struct clip *)(uintptr_t)&e; /* it is not looked at */
    (void)state;
    assert_int_equal(packed_kind_of("a/b.3TZ"), PACKED_TILES);
    assert_int_equal(packed_kind_of("s3://b/c.pmtiles"), PACKED_MAP);
    assert_int_equal(packed_kind_of("https://a/c.pmtiles?x=.tiles#f"), PACKED_MAP);
    assert_int_equal(packed_kind_of("https://a/c.tiles?x=.3tz"), PACKED_NONE);
    assert_int_equal(packed_kind_of("a.3tz/city.tiles"), PACKED_NONE);
    assert_int_equal(packed_kind_of(".3tz"), PACKED_NONE);
    struct buf b = {0};
    kit_ok(file_read(p.map, 0, &b, &e), e);
    kit_ok(file_join(p.at, p.dir, "My City.pmtiles", &e), e);
    kit_ok(file_write(p.at, b.data, b.size, &e), e);
    buf_free(&b);
    kit_fails(packed_open(p.at, 1, &x, &e), ERR_ARG, e, "rename the file");
    kit_fails(packed_open("none.3tz", 1, &x, &e), ERR_NOENT, e, "none.3tz");
    kit_fails(dataset_open(p.map, 1, some, NULL, &d, &e), ERR_ARG, e, "clip the store");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_3tz_is_its_files, packed_setup, teardown),
        cmocka_unit_test_setup_teardown(what_a_3tz_lacks_is_told, packed_setup, teardown),
        cmocka_unit_test_setup_teardown(a_map_is_its_tiles, packed_setup, teardown),
        cmocka_unit_test_setup_teardown(a_package_waits_for_its_server, packed_setup, teardown),
        cmocka_unit_test_setup_teardown(a_replaced_package_is_opened_again, packed_setup, teardown),
        cmocka_unit_test_setup_teardown(a_damaged_tile, packed_setup, teardown),
        cmocka_unit_test_setup(cut_and_changed_ones, packed_setup),
        cmocka_unit_test_setup(hostile_archives, packed_setup),
        cmocka_unit_test_setup(hostile_entries, packed_setup),
        cmocka_unit_test_setup(hostile_maps, packed_setup),
        cmocka_unit_test_setup(names_and_options, packed_setup),
    };
    return cmocka_run_group_tests(tests, packed_setup_all, packed_teardown_all);
}
