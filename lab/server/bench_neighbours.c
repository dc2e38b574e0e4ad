/* What a client gets beside others. Each client has an address of its own (127.0.0.x).
 *
 * pictures   100 clients ask for a picture each, all at once. None may be refused while the wait is
 *            below the deadline.
 * stream     a stream of moving pictures, alone and beside four streams of another address that
 *            want every picture at full size.
 * tiles      tiles that nobody has, one after the other, alone and beside eight connections of
 *            another address that ask for tilesets of polygons that nobody has.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"
#include "lab/server/load.h"

#include <math.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/math/sort.h"
#include "core/pool.h"
#include "server/answers/services.h"
#include "server/server.h"

enum { CLIENTS = 100, HEAVY = 4, FLOOD = 8, TILES = 40, WIDTH = 1280, HEIGHT = 720 };
enum { HOST_OWN = 2, HOST_OTHER = 3, HOST_FIRST = 10 }; /* last numbers of addresses */
static const double STREAM_RUN_S = 8, POSE_S = 0.033, WAIT_S = 70,
                    ABOVE_M = 100, /* the city fills most of the picture */
    DEADLINE_S = 60;               /* enough for all pictures on a busy machine */

struct place {
    uint16_t port;
    const char *ds, *revision;
    double lon, lat, height_m, west, south, east, north;
};

static void neighbours_nap(double s)
{
    const struct timespec t = {.tv_sec = (time_t)s, .tv_nsec = (long)(fmod(s, 1) * 1e9)};
    nanosleep(&t, NULL);
}

/* ---- one answer ---- */

static bool neighbours_more(int fd, struct buf *b, double wait_s)
{
    uint8_t bytes[65536];
    struct pollfd p = {.fd = fd, .events = POLLIN};
    ssize_t n = poll(&p, 1, (int)(wait_s * 1e3)) == 1 ? recv(fd, bytes, sizeof bytes, 0) : -1;
    if (n > 0)
        buf_add(b, bytes, (size_t)n);
    buf_add(b, "", 1); /* an end for strstr */
    b->size--;
    return n > 0;
}

/* The status of the next answer, read to its end; 0: the connection broke, or had none. */
static int neighbours_status(int fd)
{
    struct buf b = {0};
    size_t want = 0;
    while ((!want || b.size < want) && neighbours_more(fd, &b, WAIT_S)) {
        const char *head = (const char *)b.data, *end = strstr(head, "\r\n\r\n"),
                   *length = end ? strstr(head, "Content-Length: ") : NULL;
        if (length)
            want = (size_t)(end + 4 - head) + strtoul(length + 16, NULL, 10);
    }
    const int status = want && b.size >= want ? atoi((const char *)b.data + 9) : 0;
    buf_free(&b);
    return status;
}

static void neighbours_post(const struct place *p, const char *path, double heading,
                            const char *more, char *out, size_t room)
{
    char body[320];
    int n = snprintf(body, sizeof body,
                     "{\"pose\":{\"lon\":%.7f,\"lat\":%.7f,\"height\":%.2f,\"heading\":%.3f,"
                     "\"pitch\":-35}%s}",
                     p->lon, p->lat, p->height_m + ABOVE_M, fmod(heading, 360), more);
    snprintf(out, room, "POST /d/%s/%s HTTP/1.1\r\nHost: bench\r\nContent-Length: %d\r\n\r\n%s",
             p->ds, path, n, body);
}

/* ---- a picture each ---- */

/* The first picture waits for the start of the process that draws. */
static enum err_code neighbours_first_picture(const struct place *p, struct err *e)
{
    char text[640];
    int status = 0;
    for (int i = 0; i < 10 && status != 200; i++) {
        int fd = load_dial_from(HOST_OWN, p->port);
        neighbours_post(p, "render", -1, ",\"width\":640,\"height\":360", text, sizeof text);
        status = load_send(fd, text) ? neighbours_status(fd) : 0;
        close(fd);
    }
    return status == 200
               ? ERR_OK
               : err_set(e, ERR_IO, "bench_neighbours: a picture was answered %d", status);
}

static enum err_code neighbours_pictures(struct bench *b, const struct place *p, struct err *e)
{
    int fd[CLIENTS], refused = 0;
    char text[640];
    double last_ms = 0;
    for (int i = 0; i < CLIENTS; i++)
        fd[i] = load_dial_from((unsigned)(HOST_FIRST + i), p->port);
    const double start_s = clock_s();
    for (int i = 0; i < CLIENTS; i++) {
        neighbours_post(p, "render", 3.6 * i + 0.1, ",\"width\":640,\"height\":360", text,
                        sizeof text);
        refused += !load_send(fd[i], text);
    }
    for (int i = 0; i < CLIENTS; i++) {
        refused += neighbours_status(fd[i]) != 200;
        last_ms = (clock_s() - start_s) * 1e3;
        close(fd[i]);
    }
    bench_report(b, "a picture each for 100 clients at once: refused", refused, "", 0, NULL);
    bench_report(b, "a picture each for 100 clients at once: the last", last_ms, "ms", 0, NULL);
    /* on a machine so busy that the last waits for its whole deadline, some must be */
    return refused && last_ms < 900 * DEADLINE_S
               ? err_set(e, ERR_BUSY, "bench_neighbours: %d of %d pictures were not made", refused,
                         CLIENTS)
               : ERR_OK;
}

/* ---- streams ---- */

struct viewer {
    const struct place *place;
    unsigned host, number; /* address, name of the stream */
    bool heavy;            /* every picture at full size */
    int read_fd, steer_fd;
    _Atomic bool stop;
    _Atomic size_t pictures;
    struct pool_thread *steers, *reads;
};

static void neighbours_steer(void *user)
{
    struct viewer *v = user;
    char path[64], more[128], text[640];
    uint8_t bytes[4096];
    snprintf(path, sizeof path, "motion/neighbour-%08u-%u", (unsigned)getpid(), v->number);
    for (int i = 0; !atomic_load(&v->stop); i++) {
        snprintf(more, sizeof more, ",\"width\":%d,\"height\":%d,\"number\":%d%s", WIDTH, HEIGHT, i,
                 v->heavy ? ",\"still\":true" : "");
        neighbours_post(v->place, path, 90.0 * v->number + 20 * POSE_S * i, more, text,
                        sizeof text);
        (void)load_send(v->steer_fd, text);
        while (recv(v->steer_fd, bytes, sizeof bytes, MSG_DONTWAIT) > 0)
            continue;
        /* A full picture is cancelled when its camera moves: this one moves after each picture. */
        const size_t seen = v->pictures;
        do
            neighbours_nap(POSE_S);
        while (v->heavy && v->pictures == seen && !atomic_load(&v->stop));
    }
}

/* Counts the heads of parts: each has one such field. */
static void neighbours_read(void *user)
{
    static const char mark[] = "Rest: ";
    enum { MARK = sizeof mark - 1 };
    struct viewer *v = user;
    struct buf b = {0};
    while (!atomic_load(&v->stop)) {
        if (!neighbours_more(v->read_fd, &b, 0.1) || b.size < MARK)
            continue;
        for (size_t i = 0; i + MARK <= b.size; i++)
            v->pictures += !memcmp(b.data + i, mark, MARK);
        memmove(b.data, b.data + b.size - (MARK - 1), MARK - 1); /* one may be cut */
        b.size = MARK - 1;
    }
    buf_free(&b);
}

static enum err_code neighbours_watch(struct viewer *v, struct err *e)
{
    char text[256];
    struct buf b = {0};
    v->read_fd = load_dial_from(v->host, v->place->port);
    v->steer_fd = load_dial_from(v->host, v->place->port);
    snprintf(text, sizeof text,
             "GET /d/%s/motion/neighbour-%08u-%u HTTP/1.1\r\nHost: bench\r\n\r\n", v->place->ds,
             (unsigned)getpid(), v->number);
    enum err_code rc = ERR_OK;
    if (!load_send(v->read_fd, text) || !neighbours_more(v->read_fd, &b, WAIT_S) ||
        atoi((const char *)b.data + 9) != 200)
        rc = err_set(e, ERR_IO, "bench_neighbours: no stream");
    if (!rc)
        rc = pool_start(neighbours_steer, v, &v->steers, e);
    if (!rc)
        rc = pool_start(neighbours_read, v, &v->reads, e);
    buf_free(&b);
    return rc;
}

static void neighbours_leave(struct viewer *v)
{
    atomic_store(&v->stop, true);
    if (v->steers)
        pool_join(&v->steers);
    if (v->reads)
        pool_join(&v->reads);
    if (v->read_fd > 0)
        close(v->read_fd);
    if (v->steer_fd > 0)
        close(v->steer_fd);
}

/* Pictures a second of one stream beside so many heavy ones. */
static enum err_code neighbours_stream(const struct place *p, unsigned first, int heavy,
                                       double *per_s, double *heavy_per_s, struct err *e)
{
    struct viewer v[1 + HEAVY] = {{.place = p, .host = HOST_OWN, .number = first}};
    enum err_code rc = neighbours_watch(&v[0], e);
    for (int i = 1; i <= heavy && !rc; i++) {
        v[i] = (struct viewer){
            .place = p, .host = HOST_OTHER, .number = first + (unsigned)i, .heavy = true};
        rc = neighbours_watch(&v[i], e);
    }
    if (!rc) {
        neighbours_nap(1); /* costs and sizes of pictures settle */
        size_t own = v[0].pictures, theirs = 0;
        for (int i = 1; i <= heavy; i++)
            theirs += v[i].pictures;
        const double from_s = clock_s();
        neighbours_nap(STREAM_RUN_S);
        const double over_s = clock_s() - from_s;
        *per_s = (double)(v[0].pictures - own) / over_s;
        *heavy_per_s = -(double)theirs / over_s;
        for (int i = 1; i <= heavy; i++)
            *heavy_per_s += (double)v[i].pictures / over_s;
    }
    for (int i = 0; i <= heavy; i++)
        neighbours_leave(&v[i]);
    return rc;
}

static enum err_code neighbours_streams(struct bench *b, const struct place *p, struct err *e)
{
    double alone, beside, none, heavy;
    enum err_code rc = neighbours_stream(p, 0, 0, &alone, &none, e);
    if (!rc)
        rc = neighbours_stream(p, 10, HEAVY, &beside, &heavy, e);
    if (rc)
        return rc;
    bench_report(b, "a stream alone", alone, "/s", 0, NULL);
    bench_report(b, "a stream beside four heavy ones", beside, "/s", beside / alone, "alone");
    bench_report(b, "the four heavy ones together", heavy, "/s", 0, NULL);
    return ERR_OK;
}

/* ---- tiles ---- */

struct flood {
    const struct place *place;
    _Atomic bool stop;
    _Atomic int ok, refused;
};

static enum err_code neighbours_flood(void *user, size_t i, struct err *e)
{
    struct flood *f = user;
    const struct place *p = f->place;
    char text[400];
    int fd = load_dial_from(HOST_OTHER, p->port);
    (void)e;
    for (int n = 0; !atomic_load(&f->stop); n++) {
        const double east = (p->east - p->west) * (0.5 + 0.4 * rng_unit(9, i, (uint64_t)n)),
                     north = (p->north - p->south) * (0.5 + 0.4 * rng_unit(10, i, (uint64_t)n));
        snprintf(text, sizeof text,
                 "GET /d/%s/tileset.json?clip=%.7f,%.7f,%.7f,%.7f,%.7f,%.7f HTTP/1.1\r\nHost: "
                 "bench\r\n\r\n",
                 p->ds, p->west, p->south, p->west + east, p->south, p->west, p->south + north);
        const int status = load_send(fd, text) ? neighbours_status(fd) : 0;
        atomic_fetch_add(status == 200 ? &f->ok : &f->refused, 1);
        if (status != 200) {
            if (!status)
                break;
            neighbours_nap(0.05);
        }
    }
    close(fd);
    return ERR_OK;
}

/* Of each tile of the list the time to its answer, in ms. Tiles with index first, first + 2 ... */
static enum err_code neighbours_tiles(const struct place *p, const struct dataset *d, size_t first,
                                      double ms[TILES], struct err *e)
{
    char text[256];
    int fd = load_dial_from(HOST_OWN, p->port);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < TILES && !rc; i++) {
        const size_t at = (first + 2 * i) % d->n_tiles;
        const struct key k = d->tiles[at].key;
        /* a form that nobody asked for: each number of bits gives other bytes */
        snprintf(text, sizeof text,
                 "GET /d/%s/r/%s/t/%u/%u/%u.glb?sh=%u HTTP/1.1\r\nHost: bench\r\n\r\n", p->ds,
                 p->revision, k.z, k.x, k.y, (unsigned)((first + 2 * i) / d->n_tiles % 2));
        const double from_s = clock_s();
        const int status = load_send(fd, text) ? neighbours_status(fd) : 0;
        ms[i] = (clock_s() - from_s) * 1e3;
        if (status != 200)
            rc = err_set(e, ERR_IO, "bench_neighbours: a tile was answered %d", status);
    }
    close(fd);
    return rc;
}

struct beside {
    struct flood flood;
    const struct dataset *d;
    double ms[TILES];
};

static enum err_code neighbours_beside(void *user, size_t i, struct err *e)
{
    struct beside *s = user;
    if (i)
        return neighbours_flood(&s->flood, i, e);
    neighbours_nap(1); /* costs are learned */
    enum err_code rc = neighbours_tiles(s->flood.place, s->d, 1, s->ms, e);
    atomic_store(&s->flood.stop, true);
    return rc;
}

static enum err_code neighbours_polygons(struct bench *b, const struct place *p,
                                         const struct dataset *d, struct err *e)
{
    double alone[TILES];
    struct beside s = {.flood = {.place = p}, .d = d};
    enum err_code rc = neighbours_tiles(p, d, 0, alone, e);
    if (!rc)
        rc = pool_for(FLOOD + 1, FLOOD + 1, neighbours_beside, &s, e);
    if (rc)
        return rc;
    sort_doubles(alone, TILES);
    sort_doubles(s.ms, TILES);
    bench_report(b, "a new tile alone, median", alone[TILES / 2], "ms", 0, NULL);
    bench_report(b, "a new tile beside polygons, median", s.ms[TILES / 2], "ms",
                 s.ms[TILES / 2] / alone[TILES / 2], "alone");
    bench_report(b, "a new tile beside polygons, 9 of 10", s.ms[TILES * 9 / 10], "ms",
                 s.ms[TILES * 9 / 10] / alone[TILES * 9 / 10], "alone");
    bench_report(b, "polygons made meanwhile", atomic_load(&s.flood.ok), "", 0, NULL);
    return ERR_OK;
}

enum err_code bench_neighbours(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    const char *const paths[] = {b->tiles ? b->tiles : path};
    enum err_code rc = file_join(path, bench_tmpdir(b), "neighbours.tiles", e);
    if (!rc && !b->tiles)
        rc = load_city(path, b->quick ? 50000 : 200000, e);
    if (!rc)
        rc = config_defaults(&cfg, &arena, e);
    cfg.port = 0;
    cfg.access_log = false;
    cfg.requests_per_connection = 1000000000;
    cfg.deadline_s = DEADLINE_S;
    if (!rc)
        rc = server_start(&cfg, paths, 1, &server, e);
    if (!rc) {
        struct catalog *c = services_catalog(server_services(server));
        const struct dataset *d = c->ds[0];
        const struct place p = {.port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1),
                                .ds = d->meta.name,
                                .revision = d->meta.revision,
                                .lon = d->meta.origin.lon_deg,
                                .lat = d->meta.origin.lat_deg,
                                .height_m = d->meta.origin.h_m,
                                .west = d->bbox[0],
                                .south = d->bbox[1],
                                .east = d->bbox[3],
                                .north = d->bbox[4]};
        rc = neighbours_first_picture(&p, e);
        if (!rc)
            rc = neighbours_pictures(b, &p, e);
        if (!rc)
            rc = neighbours_streams(b, &p, e);
        if (!rc)
            rc = neighbours_polygons(b, &p, d, e);
        catalog_drop(&c);
    }
    server_stop(&server);
    arena_free(&arena);
    return rc;
}
