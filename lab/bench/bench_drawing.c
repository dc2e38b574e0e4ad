/* The cost of drawing in a separate process (docs/decisions/022). The same requests go to the same
 * code in that process (server/drawing/worker.h) and in a thread here, in turns, picture by
 * picture. A ratio is the median over pairs, so other work on the machine affects both sides.
 *
 * Checked before timing: both give the same bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"
#include "lab/bench/city.h"

#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/geo/geo.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "lod/make/pyramid.h"
#include "server/drawing/draw.h"

enum { DRAWING_PICTURES = 60, DRAWING_QUICK = 6, DRAWING_LIMIT = 64 << 20 };
static const struct geo_origin drawing_origin = {8.6821, 50.1109, 160};

enum { HERE, THERE, WAYS };
struct drawing {
    struct bench *b;
    int store; /* descriptor */
    struct draw_hello hello;
    void *here;
    struct worker *there;
    uint64_t life;
    int n;
    double ms[WAYS][DRAWING_PICTURES], cpu_ms[WAYS][DRAWING_PICTURES];
    enum err_code rc;
    struct err *e;
};

/* Round the city, every picture another one. */
static void drawing_request(int k, uint32_t width_px, uint32_t height_px, bool opens,
                            struct draw_request *q)
{
    double a = 0.1 * k;
    const double eye[3] = {150 * cos(a), 150 * sin(a), 110}, target[3] = {0, 0, 10};
    memset(q, 0, sizeof *q);
    q->kind = DRAW_VIEW;
    q->opens = opens;
    snprintf(q->name, sizeof q->name, "bench");
    q->view.cam = camera_look_at(eye, target, 0.9, width_px, height_px);
    q->view.format = FORMAT_JPG;
    q->view.quality = 85;
}

/* CPU time of this process, and of the other one as far as it told. */
static double drawing_cpu_s(struct drawing *d)
{
    struct worker_status st;
    worker_status(d->there, &st);
    return clock_cpu_s() + st.cpu_s;
}

static enum err_code drawing_make(struct drawing *d, int way, const struct draw_request *q,
                                  struct buf *out, struct err *e)
{
    int fd = q->opens ? dup(d->store) : -1;
    out->size = 0;
    if (way == HERE)
        return draw_service.run(d->here, q, sizeof *q, fd, out, e); /* takes fd */
    enum err_code rc =
        worker_ask(d->there, d->life, q, sizeof *q, fd, DRAWING_LIMIT, NULL, NULL, out, e);
    if (fd >= 0)
        close(fd);
    return rc;
}

/* Picture k by both; the one that begins changes. timed: it counts. */
static enum err_code drawing_pair(struct drawing *d, int k, uint32_t width_px, uint32_t height_px,
                                  bool timed, struct err *e)
{
    struct draw_request *q = mem_array(1, sizeof *q);
    struct buf out[WAYS] = {{0}};
    enum err_code rc = q ? ERR_OK : err_set(e, ERR_MEM, "bench_drawing: out of memory");
    for (int i = 0; !rc && i < WAYS; i++) {
        int way = (i + k) % WAYS;
        drawing_request(k, width_px, height_px, !timed && k == 0, q);
        double cpu_s = drawing_cpu_s(d), start_s = clock_s();
        rc = drawing_make(d, way, q, &out[way], e);
        if (timed) {
            d->ms[way][k] = (clock_s() - start_s) * 1e3;
            d->cpu_ms[way][k] = (drawing_cpu_s(d) - cpu_s) * 1e3;
        }
    }
    if (!rc && (out[HERE].size != out[THERE].size || !out[HERE].size ||
                memcmp(out[HERE].data, out[THERE].data, out[HERE].size) != 0))
        rc = err_set(e, ERR_INTERNAL, "bench_drawing: check: the two pictures differ");
    for (int i = 0; i < WAYS; i++)
        buf_free(&out[i]);
    mem_free(q);
    return rc;
}

static void drawing_report(struct drawing *d, const char *size, const char *what,
                           double (*ms)[DRAWING_PICTURES])
{
    char text[96];
    double ratio[DRAWING_PICTURES];
    for (int k = 0; k < d->n; k++)
        ratio[k] = ms[THERE][k] / ms[HERE][k];
    sort_doubles(ratio, (size_t)d->n);
    for (int way = 0; way < WAYS; way++) {
        sort_doubles(ms[way], (size_t)d->n);
        snprintf(text, sizeof text, "%s, %s, %s", size,
                 way == HERE ? "on a thread" : "by a process of its own", what);
        bench_report(d->b, text, ms[way][d->n / 2], "ms", way == HERE ? 0 : ratio[d->n / 2],
                     way == HERE ? NULL : "the thread");
    }
    snprintf(text, sizeof text, "%s, process to thread, %s: lower quartile", size, what);
    bench_report(d->b, text, ratio[d->n / 4], "", 0, NULL);
    snprintf(text, sizeof text, "%s, process to thread, %s: upper quartile", size, what);
    bench_report(d->b, text, ratio[3 * d->n / 4], "", 0, NULL);
}

static enum err_code drawing_size(struct drawing *d, uint32_t width_px, uint32_t height_px,
                                  struct err *e)
{
    char size[32];
    enum err_code rc = ERR_OK;
    snprintf(size, sizeof size, "%ux%u", width_px, height_px);
    for (int timed = 0; timed < 2; timed++) /* first the tiles are decoded, kernels built */
        for (int k = 0; !rc && k < d->n; k++)
            rc = drawing_pair(d, k, width_px, height_px, timed, e);
    if (rc)
        return rc;
    drawing_report(d, size, "time", d->ms);
    drawing_report(d, size, "CPU time", d->cpu_ms);
    return ERR_OK;
}

/* On a thread of its own; neither is niced, or what else the machine does would meet one alone. */
static void drawing_main(void *user)
{
    struct drawing *d = user;
    char about[WORKER_ABOUT];
    struct worker_status st;
    d->rc = draw_service.open(&d->hello, sizeof d->hello, &d->here, about, d->e);
    if (!d->rc)
        d->rc = worker_ready(d->there, NULL, NULL, &d->life, d->e);
    if (!d->rc)
        d->rc = drawing_size(d, 640, 480, d->e);
    if (!d->rc)
        d->rc = drawing_size(d, 1280, 720, d->e);
    worker_status(d->there, &st);
    if (!d->rc)
        bench_report(d->b, "memory of the process at most", (double)st.peak_bytes * 1e-6, "MB", 0,
                     NULL);
    draw_service.close(d->here);
}

static enum err_code drawing_store(struct drawing *d, struct err *e)
{
    char path[FILE_PATH_MAX];
    const struct pyramid_config cfg = {.name = "bench", .tile_edge_m = 60};
    struct pyramid_report report;
    struct gauss g = {0};
    const char *from = d->b->tiles;
    enum err_code rc = file_join(path, bench_tmpdir(d->b), "drawing.tiles", e);
    if (!rc && !from)
        rc = city_sorted_degree(d->b->quick ? 20000 : 1000000, 1, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc && !from)
        rc = pyramid_build(&drawing_origin, &level, 1, &cfg, NULL, 0, path, &report, e);
    gauss_free(&g);
    from = from ? from : path;
    d->store = rc ? -1 : open(from, O_RDONLY | O_CLOEXEC);
    return !rc && d->store < 0 ? err_errno(e, ERR_IO, "%s", from) : rc;
}

enum err_code bench_drawing(struct bench *b, struct err *e)
{
    struct drawing *d = mem_array(1, sizeof *d);
    struct pool_thread *thread = NULL;
    if (!d)
        return err_set(e, ERR_MEM, "bench_drawing: out of memory");
    *d = (struct drawing){
        .b = b, .store = -1, .e = e, .n = b->quick ? DRAWING_QUICK : DRAWING_PICTURES};
    d->hello =
        (struct draw_hello){.view_cache_bytes = (uint64_t)1 << 30, .view_gaussians = 1200000};
    const struct worker_config w = {.hello = &d->hello,
                                    .n_hello = sizeof d->hello,
                                    .start_s = 60,
                                    .ask_s = 60,
                                    .pause_s = 1,
                                    .pause_most_s = 1,
                                    .steady_s = 10};
    enum err_code rc = drawing_store(d, e);
    if (!rc)
        rc = worker_open(&w, &d->there, e);
    if (!rc)
        rc = pool_start(drawing_main, d, &thread, e);
    if (thread)
        pool_join(&thread);
    if (!rc)
        rc = d->rc;
    worker_close(&d->there);
    if (d->store >= 0)
        close(d->store);
    mem_free(d);
    return rc;
}
