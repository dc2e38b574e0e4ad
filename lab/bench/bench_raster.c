/* Map tiles of the server over loopback, of a small and a large city: the time of a new tile of 256
 * px, at every zoom, and of a tile that is in memory, against a tile of Gaussians in memory. One
 * client sends one request after another, so drawing has the whole machine.
 *
 * Checked before timing: every tile is answered 200 with the requested type, and a second answer
 * has the same bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"
#include "lab/bench/city.h"

#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "core/math/sort.h"
#include "lod/make/pyramid.h"
#include "lod/surface/raster.h"
#include "server/answers/services.h"
#include "server/server.h"

enum { RASTER_SIDE = 6 /* tiles, of a square about the middle */, RASTER_HOT = 2000 };
static const struct city_size raster_cities[] = {{200000, 1}, {10400000, 4}, {0}},
                              raster_quick[] = {{20000, 1}, {0}};
static const struct geo_origin raster_origin = {8.6821, 50.1109, 160};

struct raster_case {
    struct server *server;
    int fd;
    struct area area; /* of the dataset, borrowed */
    size_t n;         /* Gaussians */
    char prefix[64];  /* "/d/bench/r/REV" */
    double ms[RASTER_HOT > RASTER_SIDE *RASTER_SIDE ? RASTER_HOT : RASTER_SIDE *RASTER_SIDE];
};

static enum err_code raster_config(struct server_config *cfg, struct arena *a, struct err *e)
{
    enum err_code rc = config_defaults(cfg, a, e);
    cfg->port = 0;
    cfg->access_log = false;
    cfg->requests_per_connection = 1000000000;
    cfg->client_views_s = cfg->client_tiles_s = 0;
    return rc;
}

static enum err_code raster_store(const struct city_size *city, const char *path, struct err *e)
{
    const struct pyramid_config cfg = {.name = "bench"};
    struct gauss g = {0};
    enum err_code rc = city_square(city, 0, 0, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc)
        rc = pyramid_build(&raster_origin, &level, 1, &cfg, NULL, 0, path, NULL, e);
    gauss_free(&g);
    return rc;
}

static enum err_code raster_connect(struct raster_case *c, struct err *e)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    a.sin_port = htons((uint16_t)atoi(strrchr(server_url(c->server), ':') + 1));
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    c->fd = socket(AF_INET, SOCK_STREAM, 0);
    return c->fd >= 0 && connect(c->fd, (struct sockaddr *)&a, sizeof a) == 0
               ? ERR_OK
               : err_set(e, ERR_IO, "bench_raster: cannot connect");
}

/* One answer of the connection: its body in `body` (as it was read, head and all), bytes of the
 * body in *n. */
static enum err_code raster_ask(struct raster_case *c, const char *path, struct buf *body,
                                size_t *n, struct err *e)
{
    char request[256];
    size_t want = 0;
    int len = snprintf(request, sizeof request, "GET %s%s HTTP/1.1\r\nHost: bench\r\n\r\n",
                       c->prefix, path);
    body->size = 0;
    if (send(c->fd, request, (size_t)len, MSG_NOSIGNAL) != len)
        return err_set(e, ERR_IO, "bench_raster: a connection broke");
    while (!want || body->size < want) {
        char bytes[65536];
        ssize_t got = recv(c->fd, bytes, sizeof bytes, 0);
        if (got <= 0)
            return err_set(e, ERR_IO, "bench_raster: %s: the answer breaks off", path);
        buf_add(body, bytes, (size_t)got);
        buf_add(body, "", 1);
        enum err_code rc = buf_check(body, e);
        if (rc)
            return rc;
        body->size--;
        const char *head = (const char *)body->data, *end = strstr(head, "\r\n\r\n"),
                   *length = strstr(head, "Content-Length: ");
        if (want || !end)
            continue;
        if (strncmp(head + 9, "200", 3) || !length)
            return err_set(e, ERR_INTERNAL, "bench_raster: check: %s: %.12s", path, head);
        *n = strtoul(length + 16, NULL, 10);
        want = (size_t)(end + 4 - head) + *n;
    }
    return ERR_OK;
}

/* Tiles about the middle at this zoom that show the survey, each for the first time. */
static enum err_code raster_cold(struct bench *b, struct raster_case *c, uint8_t z, struct err *e)
{
    struct key middle = key_at(raster_origin.lon_deg, raster_origin.lat_deg, z);
    struct buf body = {0};
    size_t n = 0, bytes = 0, size;
    char text[96];
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; !rc && i < RASTER_SIDE * RASTER_SIDE; i++) {
        struct key k = {z, middle.x + i % RASTER_SIDE - RASTER_SIDE / 2,
                        middle.y + i / RASTER_SIDE - RASTER_SIDE / 2};
        if (!area_touches(&c->area, k))
            continue;
        snprintf(text, sizeof text, "/map/%u/%u/%u.webp", k.z, k.x, k.y);
        double start_s = clock_s();
        rc = raster_ask(c, text, &body, &size, e);
        c->ms[n++] = 1e3 * (clock_s() - start_s);
        bytes += size;
    }
    buf_free(&body);
    if (rc || !n)
        return rc ? rc : err_set(e, ERR_INTERNAL, "bench_raster: no tile at zoom %u", z);
    sort_doubles(c->ms, n);
    snprintf(text, sizeof text, "%.1f M, cold map tile, zoom %u, %zu of them, %zu B: median",
             (double)c->n * 1e-6, z, n, bytes / n);
    bench_report(b, text, c->ms[n / 2], "ms", 0, NULL);
    snprintf(text, sizeof text, "%.1f M, cold map tile, zoom %u: slowest", (double)c->n * 1e-6, z);
    bench_report(b, text, c->ms[n - 1], "ms", 0, NULL);
    return ERR_OK;
}

/* What is in memory, again and again: median ms. */
static enum err_code raster_hot(struct raster_case *c, const char *path, double *median_ms,
                                size_t *size, struct err *e)
{
    struct buf first = {0}, body = {0};
    enum err_code rc = raster_ask(c, path, &first, size, e);
    if (!rc)
        rc = raster_ask(c, path, &body, size, e); /* from here on a hit */
    if (!rc && memcmp(body.data + body.size - *size, first.data + first.size - *size, *size) != 0)
        rc = err_set(e, ERR_INTERNAL, "bench_raster: check: %s: two answers differ", path);
    for (size_t i = 0; !rc && i < RASTER_HOT; i++) {
        double start_s = clock_s();
        rc = raster_ask(c, path, &body, size, e);
        c->ms[i] = 1e3 * (clock_s() - start_s);
    }
    *median_ms = rc ? 0 : sort_median(c->ms, RASTER_HOT);
    buf_free(&first);
    buf_free(&body);
    return rc;
}

static enum err_code raster_compare(struct bench *b, struct raster_case *c, uint8_t z,
                                    struct err *e)
{
    const struct store *s = c->area.store;
    size_t n_tiles, sizes[2];
    const struct store_tile *tiles = store_tiles(s, &n_tiles), *least = tiles;
    struct key k = key_at(raster_origin.lon_deg, raster_origin.lat_deg, z);
    char map[64], splats[64], text[96];
    double map_ms, splats_ms;
    for (size_t i = 0; i < n_tiles;
         i++) /* of the sizes of Gaussian tiles nearest to a map tile's */
        least = tiles[i].count < least->count ? &tiles[i] : least;
    snprintf(map, sizeof map, "/map/%u/%u/%u.webp", k.z, k.x, k.y);
    snprintf(splats, sizeof splats, "/t/%u/%u/%u.spz", least->key.z, least->key.x, least->key.y);
    enum err_code rc = raster_hot(c, splats, &splats_ms, &sizes[1], e);
    if (!rc)
        rc = raster_hot(c, map, &map_ms, &sizes[0], e);
    if (rc)
        return rc;
    snprintf(text, sizeof text, "%.1f M, hot tile of Gaussians (%zu B), one client",
             (double)c->n * 1e-6, sizes[1]);
    bench_report(b, text, splats_ms, "ms", 0, NULL);
    snprintf(text, sizeof text, "%.1f M, hot map tile (%zu B), one client", (double)c->n * 1e-6,
             sizes[0]);
    bench_report(b, text, map_ms, "ms", map_ms / splats_ms, "the tile of Gaussians");
    return ERR_OK;
}

static enum err_code raster_of_city(struct bench *b, const struct city_size *city, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct raster_case c = {.fd = -1, .n = city->n};
    struct buf body = {0};
    const char *const paths[] = {path};
    size_t size;
    enum err_code rc = file_join(path, bench_tmpdir(b), "raster.tiles", e);
    if (!rc)
        rc = raster_store(city, path, e);
    if (!rc)
        rc = raster_config(&cfg, &arena, e);
    if (!rc)
        rc = server_start(&cfg, paths, 1, &c.server, e);
    if (!rc)
        rc = raster_connect(&c, e);
    if (rc)
        goto out;
    struct catalog *catalog = services_catalog(server_services(c.server));
    c.area = catalog->ds[0]->area;
    snprintf(c.prefix, sizeof c.prefix, "/d/bench/r/%s", catalog->ds[0]->meta.revision);
    const uint8_t z = raster_zoom_max(&c.area), least = raster_zoom_min(&c.area);
    char first[64];
    struct key k = key_at(raster_origin.lon_deg, raster_origin.lat_deg,
                          (uint8_t)(z + 1)); /* not timed below */
    snprintf(first, sizeof first, "/map/%u/%u/%u.webp", k.z, k.x, k.y);
    rc = raster_ask(&c, first, &body, &size, e); /* the device starts, kernels are compiled */
    for (int at = z; !rc && at >= least; at--)
        rc = raster_cold(b, &c, (uint8_t)at, e);
    if (!rc)
        rc = raster_compare(b, &c, z, e);
    catalog_drop(&catalog);
out:
    if (c.fd >= 0)
        close(c.fd);
    server_stop(&c.server);
    arena_free(&arena);
    buf_free(&body);
    return rc;
}

enum err_code bench_raster(struct bench *b, struct err *e)
{
    return city_each(b, b->quick ? raster_quick : raster_cities, raster_of_city, e);
}
