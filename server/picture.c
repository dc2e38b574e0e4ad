/* Pictures for clients that cannot draw Gaussians. One thread owns the OpenCL device, the compiled
 * kernels and the tiles on the device; it is niced, and OpenCL's own threads, which it starts,
 * inherit that, so tiles keep flowing while a picture is made. Views of the last few datasets stay
 * open. Without a device the server still serves tiles, and says why it has no pictures.
 *
 * The views belong to the view thread alone; `lock` guards what other threads ask about.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/picture.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>

#include "core/dev.h"
#include "lod/pick.h"
#include "lod/store.h"
#include "lod/view.h"
#include "render/render.h"
#include "server/paint.h"

enum { PICTURE_VIEWS = 4, PICTURE_NICE = 5 };

struct open_view {
    struct dataset *ds;  /* a reference: a file that was restored is another dataset */
    struct view *view;   /* over its descriptor */
    struct nadir *nadir; /* over the view; NULL: nobody asked for a map yet */
    uint64_t used;       /* tick of its last use */
};
struct picture {
    const struct server_config *cfg;
    pthread_mutex_t lock;
    _Atomic int state; /* enum picture_state */
    char about[160];   /* by lock */
    struct dev dev;
    struct render *render;
    struct render_surface *surface; /* NULL: nobody asked for depth or a background yet */
    bool has_dev;
    struct open_view open[PICTURE_VIEWS];
    uint64_t tick;
};

enum err_code picture_open(const struct server_config *cfg, struct picture **out, struct err *e)
{
    struct picture *p = mem_array(1, sizeof *p);
    *out = p;
    if (!p)
        return err_set(e, ERR_MEM, "picture: out of memory");
    p->cfg = cfg;
    atomic_init(&p->state, PICTURE_STARTING);
    pthread_mutex_init(&p->lock, NULL);
    return ERR_OK;
}

static void picture_set_state(struct picture *p, enum picture_state state, const char *about)
{
    pthread_mutex_lock(&p->lock);
    snprintf(p->about, sizeof p->about, "%.*s", (int)sizeof p->about - 1, about);
    atomic_store(&p->state, state);
    pthread_mutex_unlock(&p->lock);
}

void picture_enter(struct picture *p)
{
    struct err e = {0};
    char about[256];
    setpriority(PRIO_PROCESS, 0,
                PICTURE_NICE); /* on Linux: of this thread, and of those it starts */
    double start_s = clock_s();
    enum err_code rc = dev_open(p->cfg->device, &p->dev, &e);
    p->has_dev = !rc;
    if (!rc)
        rc = render_open(&p->dev, &p->render, &e);
    if (rc) {
        log_warn("serve", "pictures are off, tiles are served: %s", e.msg);
        picture_set_state(p, PICTURE_OFF, e.msg);
        return;
    }
    snprintf(about, sizeof about, "%s %s", p->dev.name, p->dev.driver);
    picture_set_state(p, PICTURE_READY, about);
    log_info("serve", "pictures are on device=\"%s\" start_s=%.1f", about, clock_s() - start_s);
}

static void picture_view_drop(struct open_view *v)
{
    nadir_close(&v->nadir);
    view_close(&v->view);
    dataset_drop(&v->ds);
    memset(v, 0, sizeof *v);
}

void picture_leave(struct picture *p)
{
    for (int i = 0; i < PICTURE_VIEWS; i++)
        if (p->open[i].view)
            picture_view_drop(&p->open[i]);
    render_surface_close(&p->surface);
    render_close(&p->render);
    if (p->has_dev)
        dev_close(&p->dev);
    p->has_dev = false;
}

void picture_close(struct picture **out)
{
    struct picture *p = *out;
    *out = NULL;
    if (!p)
        return;
    pthread_mutex_destroy(&p->lock);
    mem_free(p);
}

enum picture_state picture_state(const struct picture *p)
{
    return (enum picture_state)atomic_load(&p->state);
}

void picture_about(struct picture *p, char *out, size_t n)
{
    pthread_mutex_lock(&p->lock);
    snprintf(out, n, "%s", p->about);
    pthread_mutex_unlock(&p->lock);
}

/* The open view of a dataset. Those that nobody else has any more are closed; then the one unused
 * for longest makes room. */
static enum err_code picture_view_find(struct picture *p, struct dataset *d, struct open_view **out,
                                       struct err *e)
{
    struct open_view *oldest = &p->open[0];
    for (int i = 0; i < PICTURE_VIEWS; i++) {
        struct open_view *v = &p->open[i];
        if (v->view && dataset_is_last(v->ds))
            picture_view_drop(v);
        if (v->view && v->ds == d) {
            v->used = ++p->tick;
            *out = v;
            return ERR_OK;
        }
        if (v->used < oldest->used)
            oldest = v;
    }
    if (oldest->view)
        picture_view_drop(oldest);
    size_t bytes = ((size_t)p->cfg->view_cache_mb << 20) / PICTURE_VIEWS;
    enum err_code rc = view_open_fd(d->fd, d->path, p->render, bytes, &oldest->view, e);
    if (rc)
        return rc;
    oldest->ds = dataset_ref(d);
    oldest->used = ++p->tick;
    *out = oldest;
    return ERR_OK;
}

/* The same, in an appearance. */
static enum err_code picture_view(struct picture *p, struct dataset *d,
                                  const struct appearance_choice *a, struct open_view **out,
                                  struct err *e)
{
    char why[160];
    if (picture_state(p) != PICTURE_READY) {
        picture_about(p, why, sizeof why);
        return err_set(e, ERR_DEVICE, "pictures are off: %s", why);
    }
    enum err_code rc = picture_view_find(p, d, out, e);
    return rc ? rc : view_set_appearance((*out)->view, appearance_api_image(a), e);
}

enum err_code picture_nadir(struct picture *p, struct dataset *d, const struct appearance_choice *a,
                            struct nadir **out, struct err *e)
{
    struct open_view *v;
    enum err_code rc = picture_view(p, d, a, &v, e);
    if (!rc && !v->nadir)
        rc = nadir_over(v->view, p->render, (double)NAN, &v->nadir, e);
    *out = rc ? NULL : v->nadir;
    return rc;
}

/* What is left behind the last frame's Gaussians, and how far away they are, as far as `to` has
 * room. */
static enum err_code picture_measure(struct picture *p, float *transmittance, float *depth_m,
                                     struct err *e)
{
    const struct render_surface_maps maps = {.transmittance = transmittance, .median_m = depth_m};
    enum err_code rc = ERR_OK;
    if (!transmittance && !depth_m)
        return ERR_OK;
    if (!p->surface)
        rc = render_surface_open(p->render, &p->surface, e);
    return !rc ? render_surface_run(p->surface, NULL, &maps, e) : rc;
}

enum err_code picture_make(struct picture *p, const struct job *j, struct dataset *d,
                           const struct appearance_choice *a, const struct picture_view *v,
                           struct buf *out, struct err *e)
{
    struct open_view *view = NULL;
    const struct paint *paint = &v->paint;
    size_t n = (size_t)v->cam.width_px * v->cam.height_px;
    bool left = paint_needs_transmittance(paint), depth = paint_needs_depth(paint, v->format);
    struct render_options ro = {.aa = d->meta.antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                .sh_degree = -1};
    const struct pick_options po = {.max_gaussians = (uint64_t)p->cfg->view_gaussians};
    for (int c = 0; c < 3; c++)
        ro.background[c] = (float)(paint->rgb >> (16 - 8 * c) & 255) / 255.0f;
    float *rgb = mem_array(n, (3 + left + depth) * sizeof(float));
    enum err_code rc = rgb ? ERR_OK : err_set(e, ERR_MEM, "picture: out of memory");
    float *more = rgb ? rgb + 3 * n : NULL;
    const struct paint_planes planes = {rgb, left ? more : NULL,
                                        depth ? more + (left ? n : 0) : NULL};
    if (!rc)
        rc = picture_view(p, d, a, &view, e);
    if (!rc)
        rc = view_render(view->view, &v->cam, &ro, &po, rgb, NULL, e);
    if (!rc && job_cancelled(j))
        rc = err_set(e, ERR_CANCEL, "cancelled");
    if (!rc)
        rc = picture_measure(p, left ? more : NULL, depth ? more + (left ? n : 0) : NULL, e);
    if (!rc)
        rc = paint_encode(paint, &v->cam, v->format, v->quality, &planes, out, e);
    mem_free(rgb);
    return rc;
}
