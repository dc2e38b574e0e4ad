/* What a thin client sees while its camera turns: one request a picture, against a stream of JPEG
 * and a stream of video (server/motion.c), for several round-trip times. A relay delays both
 * directions; it models nothing else of the line. The camera turns at 20 degrees a second for a few
 * seconds.
 *
 * Checked before timing: both answer with JPEG.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"
#include "bench/load.h"

#include <math.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "codec/video.h"
#include "core/pool.h"
#include "core/sort.h"
#include "server/server.h"
#include "server/services.h"

enum { MOTION_W = 1280, MOTION_H = 720, MOTION_PICTURES = 2000, MOTION_PAIRS = 8 };
enum { MOTION_PIECES = 4096, MOTION_PIECE = 16384 };
static const double MOTION_RUN_S = 6, MOTION_POSE_S = 0.033;
/* As the viewer's pictures.ts. */
static const double MOTION_AREA = 60000, MOTION_LEAST = 20000, MOTION_MOST = 500000,
                    MOTION_MS = 100;

/* ---- a line with a delay ---- */

struct line_piece {
    double due_s;
    size_t n;
    uint8_t bytes[MOTION_PIECE];
};
struct line_way { /* one direction: a ring of what is under way */
    struct line_piece *piece;
    size_t first, n, sent;
};
struct line {
    int listener;
    uint16_t port, to;
    double delay_s; /* of one direction */
    int fd[MOTION_PAIRS][2];
    struct line_way way[MOTION_PAIRS][2];
    size_t n;
    _Atomic bool stop;
    struct pool_thread *thread;
};

static int motion_line_dial(uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int yes = 1;
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    if (fd >= 0 && connect(fd, (struct sockaddr *)&a, sizeof a) != 0) {
        close(fd);
        fd = -1;
    }
    (void)setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    return fd;
}

static void motion_line_accept(struct line *l)
{
    int fd = accept(l->listener, NULL, NULL);
    const int yes = 1;
    if (fd < 0 || l->n == MOTION_PAIRS)
        return;
    (void)setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    l->fd[l->n][0] = fd;
    l->fd[l->n][1] = motion_line_dial(l->to);
    for (int k = 0; k < 2; k++)
        l->way[l->n][k].piece = mem_array(MOTION_PIECES, sizeof(struct line_piece));
    l->n++;
}

/* Bytes from fd into the ring; what is due out of it. */
static void motion_line_move(struct line *l, size_t i, int k, double now_s)
{
    struct line_way *w = &l->way[i][k];
    while (w->n < MOTION_PIECES) {
        struct line_piece *p = &w->piece[(w->first + w->n) % MOTION_PIECES];
        ssize_t n = recv(l->fd[i][k], p->bytes, sizeof p->bytes, MSG_DONTWAIT);
        if (n <= 0)
            break;
        p->n = (size_t)n;
        p->due_s = now_s + l->delay_s;
        w->n++;
    }
    while (w->n && w->piece[w->first].due_s <= now_s) {
        struct line_piece *p = &w->piece[w->first];
        ssize_t n =
            send(l->fd[i][!k], p->bytes + w->sent, p->n - w->sent, MSG_DONTWAIT | MSG_NOSIGNAL);
        if (n < 0)
            break;
        w->sent += (size_t)n;
        if (w->sent < p->n)
            break;
        w->sent = 0;
        w->first = (w->first + 1) % MOTION_PIECES;
        w->n--;
    }
}

static void motion_line_main(void *user)
{
    struct line *l = user;
    while (!atomic_load(&l->stop)) {
        struct pollfd p = {.fd = l->listener, .events = POLLIN};
        if (poll(&p, 1, 1) == 1)
            motion_line_accept(l);
        for (size_t i = 0; i < l->n; i++)
            for (int k = 0; k < 2; k++)
                motion_line_move(l, i, k, clock_s());
    }
}

static enum err_code motion_line_open(struct line *l, uint16_t to, double delay_s, struct err *e)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    memset(l, 0, sizeof *l);
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    l->to = to;
    l->delay_s = delay_s;
    l->listener = socket(AF_INET, SOCK_STREAM, 0);
    if (l->listener < 0 || bind(l->listener, (struct sockaddr *)&a, sizeof a) != 0 ||
        listen(l->listener, 8) != 0 || getsockname(l->listener, (struct sockaddr *)&a, &n) != 0)
        return err_errno(e, ERR_IO, "bench_motion: no relay");
    l->port = ntohs(a.sin_port);
    return pool_start(motion_line_main, l, &l->thread, e);
}

static void motion_line_close(struct line *l)
{
    atomic_store(&l->stop, true);
    if (l->thread)
        pool_join(&l->thread);
    for (size_t i = 0; i < l->n; i++)
        for (int k = 0; k < 2; k++) {
            close(l->fd[i][k]);
            mem_free(l->way[i][k].piece);
        }
    if (l->listener >= 0)
        close(l->listener);
}

/* ---- what is seen ---- */

struct seen {
    size_t n;
    double posed_s[MOTION_PICTURES], shown_s[MOTION_PICTURES];
    double pixels;
    size_t down, up; /* bytes */
};

static void motion_seen_add(struct seen *s, double posed_s, double pixels)
{
    if (s->n == MOTION_PICTURES)
        return;
    s->posed_s[s->n] = posed_s;
    s->shown_s[s->n++] = clock_s();
    s->pixels += pixels;
}

static void motion_seen_report(struct bench *b, const char *how, double delay_s,
                               const struct seen *s)
{
    double late[MOTION_PICTURES], age = 0, over;
    char name[96];
    if (s->n < 2)
        return;
    for (size_t i = 0; i < s->n; i++)
        late[i] = (s->shown_s[i] - s->posed_s[i]) * 1e3;
    for (size_t i = 0; i + 1 < s->n; i++) {
        double from = s->shown_s[i] - s->posed_s[i], to = s->shown_s[i + 1] - s->posed_s[i];
        age += (from + to) / 2 * (to - from);
    }
    over = s->shown_s[s->n - 1] - s->shown_s[0];
    sort_doubles(late, s->n);
    const struct {
        const char *what, *unit;
        double value;
    } rows[] = {
        {"pictures", "/s", (double)(s->n - 1) / over},
        {"pose to picture, median", "ms", late[s->n / 2]},
        {"pose to picture, 90 of 100", "ms", late[s->n * 90 / 100]},
        {"pose to picture, 95 of 100", "ms", late[s->n * 95 / 100]},
        {"age of what is seen, mean", "ms", age / over * 1e3},
        {"size", "kpx", s->pixels / (double)s->n / 1e3},
        {"down", "kB/s", (double)s->down / over / 1e3},
        {"up", "kB/s", (double)s->up / over / 1e3},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        snprintf(name, sizeof name, "%s, round trip %.0f ms: %s", how, 2e3 * delay_s, rows[i].what);
        bench_report(b, name, rows[i].value, rows[i].unit, 0, NULL);
    }
}

/* ---- the two clients ---- */

struct thin {
    uint16_t port;
    const char *ds;
    double lon, lat, h;
};

static size_t motion_thin_post(const struct thin *t, const char *path, double at_s, int number,
                               uint32_t width, uint32_t height, struct buf *out)
{
    struct buf body = {0};
    char extra[64] = "";
    if (number >= 0)
        snprintf(extra, sizeof extra, ",\"number\":%d", number);
    buf_printf(
        &body,
        "{\"pose\":{\"lon\":%.7f,\"lat\":%.7f,\"height\":%.2f,\"heading\":%.3f,\"pitch\":-35},"
        "\"width\":%u,\"height\":%u,\"quality\":60%s}",
        t->lon, t->lat, t->h + 250, fmod(20 * at_s, 360), (unsigned)width, (unsigned)height, extra);
    out->size = 0;
    buf_printf(out, "POST /d/%s/%s HTTP/1.1\r\nHost: bench\r\nContent-Length: %zu\r\n\r\n", t->ds,
               path, body.size);
    buf_add(out, body.data, body.size);
    buf_free(&body);
    return out->size;
}

/* Bytes until `have` says that a whole thing is there. */
static bool motion_thin_more(int fd, struct buf *b)
{
    uint8_t bytes[65536];
    struct pollfd p = {.fd = fd, .events = POLLIN};
    ssize_t n = poll(&p, 1, 5000) == 1 ? recv(fd, bytes, sizeof bytes, 0) : -1;
    if (n > 0)
        buf_add(b, bytes, (size_t)n);
    buf_add(b, "", 1);
    b->size--;
    return n > 0;
}

static enum err_code motion_thin_by_request(const struct thin *t, struct seen *s, struct err *e)
{
    struct buf q = {0}, a = {0};
    double area = MOTION_AREA, start_s = clock_s();
    int fd = motion_line_dial(t->port);
    enum err_code rc = fd < 0 ? err_set(e, ERR_IO, "bench_motion: cannot connect") : ERR_OK;
    while (!rc && clock_s() - start_s < MOTION_RUN_S) {
        double f = fmin(1, sqrt(area / (MOTION_W * MOTION_H))), posed_s = clock_s();
        uint32_t w = (uint32_t)(MOTION_W * f), h = (uint32_t)(MOTION_H * f);
        s->up += motion_thin_post(t, "render", posed_s - start_s, -1, w, h, &q);
        if (send(fd, q.data, q.size, MSG_NOSIGNAL) != (ssize_t)q.size)
            rc = err_set(e, ERR_IO, "bench_motion: the connection broke");
        a.size = 0;
        for (size_t want = 0; !rc && (!want || a.size < want);) {
            if (!motion_thin_more(fd, &a))
                rc = err_set(e, ERR_IO, "bench_motion: no answer");
            const char *head = (const char *)a.data, *end = rc ? NULL : strstr(head, "\r\n\r\n");
            const char *length = end ? strstr(head, "Content-Length: ") : NULL;
            if (length)
                want = (size_t)(end + 4 - head) + strtoul(length + 16, NULL, 10);
        }
        if (!rc && strncmp((const char *)a.data + 9, "200", 3) != 0)
            rc = err_set(e, ERR_IO, "bench_motion: %.60s", (const char *)a.data);
        s->down += a.size;
        motion_seen_add(s, posed_s, (double)w * h);
        double ms = (clock_s() - posed_s) * 1e3;
        area = fmin(MOTION_MOST, fmax(MOTION_LEAST, area * fmin(1.3, fmax(0.5, MOTION_MS / ms))));
    }
    close(fd);
    buf_free(&q);
    buf_free(&a);
    return rc;
}

struct steering {
    const struct thin *thin;
    const char *path;
    double start_s;
    double posed_s[MOTION_PICTURES];
    size_t up;
    _Atomic bool stop;
    int fd;
};

/* A pose thirty times a second, and answers thrown away as they come. */
static void motion_thin_steer(void *user)
{
    struct steering *st = user;
    struct buf q = {0};
    uint8_t bytes[4096];
    for (int i = 0; i < MOTION_PICTURES && !atomic_load(&st->stop); i++) {
        st->posed_s[i] = clock_s();
        st->up += motion_thin_post(st->thin, st->path, st->posed_s[i] - st->start_s, i, MOTION_W,
                                   MOTION_H, &q);
        (void)!send(st->fd, q.data, q.size, MSG_NOSIGNAL);
        while (recv(st->fd, bytes, sizeof bytes, MSG_DONTWAIT) > 0)
            continue;
        const struct timespec nap = {.tv_nsec = (long)(MOTION_POSE_S * 1e9)};
        nanosleep(&nap, NULL);
    }
    buf_free(&q);
}

/* The end of the first whole part in text, NULL: it is not there yet. Chunks of HTTP lie between: a
 * part's bytes are not looked at, its delimiter is. */
static const char *motion_thin_part_end(const struct buf *b, size_t at)
{
    static const char mark[] = "\r\n--citysplat-picture\r\n";
    for (size_t i = at; i + sizeof mark - 1 <= b->size; i++)
        if (b->data[i] == '\r' && !memcmp(b->data + i, mark, sizeof mark - 1))
            return (const char *)b->data + i + sizeof mark - 1;
    return NULL;
}

static enum err_code motion_thin_by_stream(const struct thin *t, const char *query, struct seen *s,
                                           struct err *e)
{
    static unsigned streams;
    char path[64], q[200];
    struct buf a = {0};
    struct steering st = {.thin = t, .path = path, .start_s = clock_s()};
    struct pool_thread *thread = NULL;
    snprintf(path, sizeof path, "motion/bench-%u-%06u-%u", (unsigned)getpid(), (unsigned)t->port,
             streams++);
    int fd = motion_line_dial(t->port);
    st.fd = motion_line_dial(t->port);
    snprintf(q, sizeof q, "GET /d/%s/%s%s HTTP/1.1\r\nHost: bench\r\n\r\n", t->ds, path, query);
    enum err_code rc = fd < 0 || st.fd < 0 || send(fd, q, strlen(q), MSG_NOSIGNAL) < 0
                           ? err_set(e, ERR_IO, "bench_motion: cannot connect")
                           : ERR_OK;
    if (!rc && !motion_thin_more(fd, &a)) /* the stream is open: it may be steered */
        rc = err_set(e, ERR_IO, "bench_motion: no stream");
    if (!rc && strncmp((const char *)a.data + 9, "200", 3) != 0)
        rc = err_set(e, ERR_IO, "bench_motion: %.60s", (const char *)a.data);
    if (!rc)
        rc = pool_start(motion_thin_steer, &st, &thread, e);
    size_t at = a.size;
    while (!rc && clock_s() - st.start_s < MOTION_RUN_S) {
        if (!motion_thin_more(fd, &a))
            rc = err_set(e, ERR_IO, "bench_motion: the stream broke");
        for (const char *end; !rc && (end = motion_thin_part_end(&a, at));) {
            const char *text = (const char *)a.data + at, *pose = strstr(text, "Pose: "),
                       *size = strstr(text, "Size: ");
            unsigned w = 0, h = 0;
            int number = pose && pose < end ? atoi(pose + 6) : -1;
            if (size && size < end && number >= 0 && number < MOTION_PICTURES &&
                sscanf(size, "Size: %ux%u", &w, &h) == 2)
                motion_seen_add(s, st.posed_s[number], (double)w * h);
            at = (size_t)(end - (const char *)a.data);
        }
    }
    s->down = a.size;
    atomic_store(&st.stop, true);
    if (thread)
        pool_join(&thread);
    s->up = st.up;
    close(fd);
    close(st.fd);
    buf_free(&a);
    return rc;
}

static enum err_code motion_case(struct bench *b, struct thin *t, uint16_t port, double delay_s,
                                 struct err *e)
{
    struct line l;
    struct seen *s = mem_array(3, sizeof *s);
    enum err_code rc = s ? motion_line_open(&l, port, delay_s, e)
                         : err_set(e, ERR_MEM, "bench_motion: out of memory");
    if (!s)
        return rc;
    t->port = l.port;
    if (!rc)
        rc = motion_thin_by_request(t, &s[0], e);
    if (!rc)
        rc = motion_thin_by_stream(t, "", &s[1], e);
    if (!rc && video_can())
        rc = motion_thin_by_stream(t, "?video=vp9", &s[2], e);
    motion_line_close(&l);
    if (!rc) {
        motion_seen_report(b, "request a picture", delay_s, &s[0]);
        motion_seen_report(b, "stream", delay_s, &s[1]);
        motion_seen_report(b, "video", delay_s, &s[2]);
    }
    mem_free(s);
    return rc;
}

enum err_code bench_motion(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct thin t = {0};
    const char *const paths[] = {b->tiles ? b->tiles : path};
    enum err_code rc = file_join(path, bench_tmpdir(b), "motion.tiles", e);
    if (!rc && !b->tiles)
        rc = load_city(path, b->quick ? 50000 : 1000000, e);
    if (!rc)
        rc = config_defaults(&cfg, &arena, e);
    cfg.port = 0;
    cfg.access_log = false;
    cfg.client_views_s = 0;
    if (!rc)
        rc = server_start(&cfg, paths, 1, &server, e);
    if (!rc) {
        struct catalog *c = services_catalog(server_services(server));
        const struct dataset *d = c->ds[0];
        uint16_t port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1);
        t.ds = d->meta.name;
        t.lon = (d->bbox[0] + d->bbox[3]) / 2;
        t.lat = (d->bbox[1] + d->bbox[4]) / 2;
        t.h = d->bbox[2];
        static const double delays_s[] = {0, 0, 0.025, 0.05, 0.1};
        for (size_t i = 0; i < 5 && !rc; i++) { /* the first one fills the caches */
            struct bench quiet = *b;
            rc = motion_case(i ? b : &quiet, &t, port, delays_s[i], e);
        }
        catalog_drop(&c);
    }
    server_stop(&server);
    arena_free(&arena);
    return rc;
}
