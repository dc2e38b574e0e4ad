/* What a thin client sees while its camera turns: one request a picture, against a stream of JPEG
 * and a stream of video (server/answers/view_stream.c), for two sizes and several round-trip
 * times. A relay delays both directions; it models nothing else of the line. The camera turns at
 * 20 degrees a second for a few seconds. A picture counts as seen when its last byte has come:
 * decoding is the client's.
 *
 * A busy machine is waited for as long as the server waits itself. What came until then is
 * reported, beside the load, and so is what was refused or did not come.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _DEFAULT_SOURCE // NOLINT(cert-dcl51-cpp): getloadavg
#include "lab/bench/bench.h"
#include "lab/server/load.h"

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

#include "codec/image/video.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "server/answers/services.h"
#include "server/server.h"

enum { MOTION_PICTURES = 2000, MOTION_PAIRS = 8, MOTION_WORD = 64 };
enum { MOTION_PIECES = 512, MOTION_PIECE = 16384 }; /* cleared when a client dials: little */
static const double MOTION_RUN_S = 6, MOTION_POSE_S = 0.033, MOTION_AGAIN_S = 0.25,
                    MOTION_LATE_S = 2;    /* after the server's deadline */
static const double MOTION_ABOVE_M = 100; /* the city fills most of the picture */
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
    bool ends, ended; /* no more will come; so the other side was told */
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
        w->ends |= n == 0;
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
    if (w->ends && !w->n && !w->ended) { /* else a stream that is left goes on being drawn */
        (void)shutdown(l->fd[i][!k], SHUT_WR);
        w->ended = true;
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
    double start_s, posed_s[MOTION_PICTURES], shown_s[MOTION_PICTURES];
    double pixels;
    double quantizers; /* their sum, of frames of video */
    size_t frames;
    size_t down, up;      /* bytes */
    size_t refused, lost; /* answers of 429, 503, 504; ends of the line, or silence */
};

static void motion_seen_add(struct seen *s, double posed_s, double pixels)
{
    if (s->n == MOTION_PICTURES)
        return;
    s->posed_s[s->n] = posed_s;
    s->shown_s[s->n++] = clock_s();
    s->pixels += pixels;
}

/* A row of the client `how`. */
static void motion_seen_row(struct bench *b, const char *how, const char *what, double value,
                            const char *unit)
{
    char name[2 * MOTION_WORD];
    snprintf(name, sizeof name, "%s: %s", how, what);
    bench_report(b, name, value, unit, 0, NULL);
}

static void motion_seen_report(struct bench *b, const char *how, const struct seen *s)
{
    double late[MOTION_PICTURES], age = 0, over, load = 0;
    if (getloadavg(&load, 1) == 1)
        motion_seen_row(b, how, "load of the machine", load, "");
    motion_seen_row(b, how, "pictures that came", (double)s->n, "");
    if (s->refused || s->lost) {
        motion_seen_row(b, how, "refused", (double)s->refused, "");
        motion_seen_row(b, how, "lost", (double)s->lost, "");
    }
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
        {"the first picture, after", "ms", (s->shown_s[0] - s->start_s) * 1e3},
        {"the last picture, after", "ms", (s->shown_s[s->n - 1] - s->start_s) * 1e3},
        {"pictures", "/s", (double)(s->n - 1) / over},
        {"pose to picture, median", "ms", late[s->n / 2]},
        {"pose to picture, 90 of 100", "ms", late[s->n * 90 / 100]},
        {"pose to picture, 95 of 100", "ms", late[s->n * 95 / 100]},
        {"age of what is seen, mean", "ms", age / over * 1e3},
        {"size", "kpx", s->pixels / (double)s->n / 1e3},
        {"a picture", "kB", (double)s->down / (double)s->n / 1e3},
        {"down", "kB/s", (double)s->down / over / 1e3},
        {"up", "kB/s", (double)s->up / over / 1e3},
    };
    if (s->frames)
        motion_seen_row(b, how, "quantizer, mean", s->quantizers / (double)s->frames, "");
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        motion_seen_row(b, how, rows[i].what, rows[i].value, rows[i].unit);
}

/* ---- the two clients ---- */

struct thin {
    uint16_t port;
    const char *ds;
    double lon, lat, h;
    uint32_t width_px, height_px; /* of a full picture */
    double wait_s;                /* for bytes */
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
        t->lon, t->lat, t->h + MOTION_ABOVE_M, fmod(20 * at_s, 360), (unsigned)width,
        (unsigned)height, extra);
    out->size = 0;
    buf_printf(out, "POST /d/%s/%s HTTP/1.1\r\nHost: bench\r\nContent-Length: %zu\r\n\r\n", t->ds,
               path, body.size);
    buf_add(out, body.data, body.size);
    buf_free(&body);
    return out->size;
}

/* Some more bytes. False: there are none in time, or the line is cut. */
static bool motion_thin_more(const struct thin *t, int fd, struct buf *b)
{
    uint8_t bytes[65536];
    struct pollfd p = {.fd = fd, .events = POLLIN};
    ssize_t n = poll(&p, 1, (int)(1e3 * t->wait_s)) == 1 ? recv(fd, bytes, sizeof bytes, 0) : -1;
    if (n > 0)
        buf_add(b, bytes, (size_t)n);
    buf_add(b, "", 1);
    b->size--;
    return n > 0;
}

static bool motion_thin_is(const struct buf *answer, const char *status)
{
    return answer->size > 12 && !strncmp((const char *)answer->data + 9, status, 3);
}

/* A whole answer. False: it does not come. */
static bool motion_thin_answer(const struct thin *t, int fd, struct buf *out)
{
    out->size = 0;
    for (size_t want = 0; !want || out->size < want;) {
        if (!motion_thin_more(t, fd, out))
            return false;
        const char *head = (const char *)out->data, *end = strstr(head, "\r\n\r\n");
        const char *length = end ? strstr(head, "Content-Length: ") : NULL;
        if (length)
            want = (size_t)(end + 4 - head) + strtoul(length + 16, NULL, 10);
    }
    return true;
}

static void motion_nap(double s)
{
    const struct timespec nap = {.tv_nsec = (long)(s * 1e9)};
    nanosleep(&nap, NULL);
}

static enum err_code motion_thin_by_request(const struct thin *t, struct seen *s, struct err *e)
{
    struct buf q = {0}, a = {0};
    double area = MOTION_AREA, start_s = clock_s();
    const double full = (double)t->width_px * t->height_px;
    int fd = motion_line_dial(t->port);
    enum err_code rc = fd < 0 ? err_set(e, ERR_IO, "bench_motion: cannot connect") : ERR_OK;
    while (!rc && !s->lost && clock_s() - start_s < MOTION_RUN_S) {
        double f = fmin(1, sqrt(area / full)), posed_s = clock_s();
        uint32_t w = (uint32_t)(t->width_px * f), h = (uint32_t)(t->height_px * f);
        s->up += motion_thin_post(t, "render", posed_s - start_s, -1, w, h, &q);
        if (send(fd, q.data, q.size, MSG_NOSIGNAL) != (ssize_t)q.size ||
            !motion_thin_answer(t, fd, &a)) {
            s->lost++;
        } else if (motion_thin_is(&a, "503") || motion_thin_is(&a, "504") ||
                   motion_thin_is(&a, "429")) {
            s->refused++;
            motion_nap(MOTION_AGAIN_S);
        } else if (!motion_thin_is(&a, "200")) {
            rc = err_set(e, ERR_IO, "bench_motion: %.60s", (const char *)a.data);
        } else {
            motion_seen_add(s, posed_s, (double)w * h);
            double ms = (clock_s() - posed_s) * 1e3;
            area *= fmin(1.3, fmax(0.5, MOTION_MS / ms));
            area = fmin(MOTION_MOST, fmax(MOTION_LEAST, area));
        }
        s->down += a.size;
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
        st->up += motion_thin_post(st->thin, st->path, st->posed_s[i] - st->start_s, i,
                                   st->thin->width_px, st->thin->height_px, &q);
        (void)!send(st->fd, q.data, q.size, MSG_NOSIGNAL);
        while (recv(st->fd, bytes, sizeof bytes, MSG_DONTWAIT) > 0)
            continue;
        motion_nap(MOTION_POSE_S);
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

/* What has come whole of the stream in a, from *at on. */
static void motion_thin_look(const struct buf *a, size_t *at, const struct steering *st,
                             struct seen *s)
{
    for (const char *end; (end = motion_thin_part_end(a, *at));) {
        const char *text = (const char *)a->data + *at, *pose = strstr(text, "Pose: "),
                   *size = strstr(text, "Size: "), *quantizer = strstr(text, "Quantizer: ");
        unsigned w = 0, h = 0;
        int number = pose && pose < end ? atoi(pose + 6) : -1;
        if (size && size < end && number >= 0 && number < MOTION_PICTURES &&
            sscanf(size, "Size: %ux%u", &w, &h) == 2)
            motion_seen_add(s, st->posed_s[number], (double)w * h);
        if (quantizer && quantizer < end) {
            s->quantizers += atoi(quantizer + 11);
            s->frames++;
        }
        *at = (size_t)(end - (const char *)a->data);
    }
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
    s->lost = !rc && !motion_thin_more(t, fd, &a); /* else it is open: it may be steered */
    if (!rc && !s->lost && !motion_thin_is(&a, "200"))
        rc = err_set(e, ERR_IO, "bench_motion: %.60s", (const char *)a.data);
    if (!rc)
        rc = pool_start(motion_thin_steer, &st, &thread, e);
    size_t at = a.size;
    while (!rc && !s->lost && clock_s() - st.start_s < MOTION_RUN_S) {
        s->lost += !motion_thin_more(t, fd, &a);
        motion_thin_look(&a, &at, &st, s);
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

/* b NULL: nothing is reported. */
static enum err_code motion_case(struct bench *b, struct thin *t, uint16_t port, double delay_s,
                                 struct err *e)
{
    static const struct {
        const char *name, *query; /* query NULL: a request a picture */
    } clients[] = {{"request a picture", NULL}, {"stream", ""}, {"video", "?video=vp9"}};
    const size_t n = video_can() ? 3 : 2;
    char how[MOTION_WORD];
    struct line l;
    struct seen *s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "bench_motion: out of memory");
    enum err_code rc = motion_line_open(&l, port, delay_s, e);
    t->port = l.port;
    for (size_t i = 0; i < n && !rc; i++) {
        *s = (struct seen){.start_s = clock_s()};
        rc = clients[i].query ? motion_thin_by_stream(t, clients[i].query, s, e)
                              : motion_thin_by_request(t, s, e);
        snprintf(how, sizeof how, "%s, %u x %u px, round trip %.0f ms", clients[i].name,
                 (unsigned)t->width_px, (unsigned)t->height_px, 2e3 * delay_s);
        if (!rc && b)
            motion_seen_report(b, how, s);
    }
    motion_line_close(&l);
    mem_free(s);
    return rc;
}

static enum err_code motion_cases(struct bench *b, struct server *server, double wait_s,
                                  struct err *e)
{
    static const struct {
        uint32_t width_px, height_px;
        double delay_s;
    } cases[] = {{1280, 720, 0},   {1280, 720, 0.025}, {1280, 720, 0.05},
                 {1280, 720, 0.1}, {640, 360, 0},      {640, 360, 0.05}};
    struct catalog *c = services_catalog(server_services(server));
    const struct dataset *d = c->ds[0];
    const uint16_t port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1);
    struct thin t = {.ds = d->meta.name,
                     .lon = d->meta.origin.lon_deg,
                     .lat = d->meta.origin.lat_deg,
                     .h = d->meta.origin.h_m,
                     .width_px = cases[0].width_px,
                     .height_px = cases[0].height_px,
                     .wait_s = wait_s};
    enum err_code rc = motion_case(NULL, &t, port, 0, e); /* fills the caches */
    for (size_t i = 0; i < sizeof cases / sizeof *cases && !rc; i++) {
        const bool all = b->round_trip_ms < 0, first = cases[i].delay_s == 0; /* of its size */
        t.width_px = cases[i].width_px;
        t.height_px = cases[i].height_px;
        if (all || first)
            rc = motion_case(b, &t, port, all ? cases[i].delay_s : b->round_trip_ms / 2e3, e);
    }
    catalog_drop(&c);
    return rc;
}

enum err_code bench_motion(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
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
    if (!rc)
        rc = motion_cases(b, server, cfg.deadline_s + MOTION_LATE_S, e);
    server_stop(&server);
    arena_free(&arena);
    return rc;
}
