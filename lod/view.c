/* A picture of a store: pick the tiles, have them decoded, put them together on the device, render.
 *
 * Two caches. Decoded tiles stay in memory up to a number of bytes, least recently used out first.
 * The tiles of the last picture stay together on the device as one model, used again while the same
 * tiles are picked, so a camera that turns a little costs a render and nothing else.
 *
 * The model's origin is the centre of its finest tile, not the eye: pictures depend on the request
 * alone, never on the ones before.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/pool.h"
#include "lod/lod.h"

enum { VIEW_BATCH = 16 /* payloads in memory at once while decoding */ };
#define VIEW_CACHE_BYTES ((size_t)1 << 30)

struct view_tile { /* decoded tile, by index into store_tiles */
    struct gauss g;
    size_t bytes; /* 0 = not resident */
    uint64_t used;
};

struct view {
    struct store *store;
    struct render *render; /* borrowed */
    struct view_tile *tile;
    size_t n_tiles;
    size_t resident_bytes, limit_bytes;
    uint64_t clock;
    uint32_t *picked, *now; /* tiles of the model; of the picture being made */
    size_t n_picked;
    struct render_model model;
    bool model_valid;
    enum err_code (*bake)(void *user, struct gauss *g, struct err *e);
    void *bake_user;
    const struct appearance *appearance; /* of the store; NULL: none */
    float *look;                         /* [len_image]; NULL: the default one */
    bool raw;
};

enum err_code view_open(const char *store_path, struct render *r, size_t cache_bytes,
                        struct view **out, struct err *e)
{
    *out = NULL;
    struct view *v = mem_array(1, sizeof *v);
    if (!v)
        return err_set(e, ERR_MEM, "%s: out of memory", store_path);
    v->render = r;
    v->limit_bytes = cache_bytes ? cache_bytes : VIEW_CACHE_BYTES;
    enum err_code rc = store_open(store_path, &v->store, e);
    if (!rc)
        rc = bake_of(v->store, &v->appearance, e);
    if (!rc) {
        store_tiles(v->store, &v->n_tiles);
        v->tile = mem_array(v->n_tiles, sizeof *v->tile);
        v->picked = mem_array(v->n_tiles, sizeof *v->picked);
        v->now = mem_array(v->n_tiles, sizeof *v->now);
        if (!v->tile || !v->picked || !v->now)
            rc = err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", store_path, v->n_tiles);
    }
    if (rc)
        view_close(&v);
    *out = v;
    return rc;
}

static void view_drop_model(struct view *v)
{
    if (v->model_valid)
        render_model_free(&v->model);
    v->model_valid = false;
}

void view_close(struct view **vp)
{
    struct view *v = *vp;
    if (!v)
        return;
    view_drop_model(v);
    for (size_t i = 0; v->tile && i < v->n_tiles; i++)
        gauss_free(&v->tile[i].g);
    mem_free(v->tile);
    mem_free(v->picked);
    mem_free(v->now);
    mem_free(v->look);
    store_close(&v->store);
    mem_free(v);
    *vp = NULL;
}

const struct store *view_store(const struct view *v)
{
    return v->store;
}

const struct appearance *view_appearance(const struct view *v)
{
    return v->appearance;
}

void view_set_bake(struct view *v,
                   enum err_code (*bake)(void *user, struct gauss *g, struct err *e), void *user)
{
    v->bake = bake;
    v->bake_user = user;
    view_drop_model(v);
}

enum err_code view_set_look(struct view *v, const float *image, struct err *e)
{
    float *look = NULL;
    if (image && v->appearance) {
        look = mem_array(v->appearance->len_image, sizeof *look);
        if (!look)
            return err_set(e, ERR_MEM, "view: out of memory");
        memcpy(look, image, v->appearance->len_image * sizeof *look);
    }
    mem_free(v->look);
    v->look = look;
    view_drop_model(v);
    return ERR_OK;
}

enum err_code view_find_look(struct view *v, const char *look, float *image, struct err *e)
{
    return bake_find(v->store, look, image, e);
}

void view_set_raw(struct view *v, bool raw)
{
    v->raw = raw;
    view_drop_model(v);
}

/* ---- decoded tiles ---- */

static size_t view_gauss_bytes(const struct gauss *g)
{
    return g->cap * (11 + 3 * gauss_sh_count(g->sh_degree) + g->embed_len) * sizeof(float);
}

struct view_batch {
    struct view *view;
    uint32_t tile[VIEW_BATCH];
    struct buf payload[VIEW_BATCH];
    size_t n;
};

static enum err_code view_decode(void *user, size_t i, struct err *e)
{
    struct view_batch *b = user;
    size_t n;
    const struct store_tile *t = &store_tiles(b->view->store, &n)[b->tile[i]];
    struct view_tile *to = &b->view->tile[b->tile[i]];
    enum err_code rc = payload_decode(b->payload[i].data, b->payload[i].size, NULL, &to->g, e);
    if (rc)
        return err_add(e, "tile %u/%u/%u", t->key.z, t->key.x, t->key.y);
    memcpy(to->g.origin_enu_m, t->center_enu_m, sizeof to->g.origin_enu_m);
    return ERR_OK;
}

static enum err_code view_load_batch(struct view_batch *b, struct err *e)
{
    size_t n;
    const struct store_tile *tiles = store_tiles(b->view->store, &n);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < b->n; i++)
        rc = store_read(b->view->store, tiles[b->tile[i]].key, &b->payload[i], e);
    if (!rc)
        rc = pool_for(b->n, 0, view_decode, b, e);
    for (size_t i = 0; i < b->n; i++) {
        struct view_tile *t = &b->view->tile[b->tile[i]];
        buf_free(&b->payload[i]);
        if (rc)
            gauss_free(&t->g);
        else
            b->view->resident_bytes += t->bytes = view_gauss_bytes(&t->g) + sizeof *t;
    }
    b->n = 0;
    return rc;
}

/* Make the tiles v->now[0..n) resident. */
static enum err_code view_load(struct view *v, size_t n, struct err *e)
{
    struct view_batch b = {.view = v};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        struct view_tile *t = &v->tile[v->now[i]];
        t->used = ++v->clock;
        if (t->bytes)
            continue;
        b.tile[b.n++] = v->now[i];
        if (b.n == VIEW_BATCH)
            rc = view_load_batch(&b, e);
    }
    if (!rc && b.n)
        rc = view_load_batch(&b, e);
    return rc;
}

static int view_use_compare(const void *a, const void *b)
{
    const struct view_tile *const *x = a;
    const struct view_tile *const *y = b;
    return (*x)->used < (*y)->used ? -1 : (*x)->used > (*y)->used;
}

/* Least recently used out until the limit is kept. Without memory for the list nothing is evicted
 * this time. */
static void view_evict(struct view *v)
{
    if (v->resident_bytes <= v->limit_bytes)
        return;
    struct view_tile **list = mem_array(v->n_tiles, sizeof *list);
    size_t n = 0;
    for (size_t i = 0; list && i < v->n_tiles; i++)
        if (v->tile[i].bytes)
            list[n++] = &v->tile[i];
    if (list)
        qsort(list, n, sizeof *list, view_use_compare);
    for (size_t i = 0; i < n && v->resident_bytes > v->limit_bytes; i++) {
        v->resident_bytes -= list[i]->bytes;
        list[i]->bytes = 0;
        gauss_free(&list[i]->g);
    }
    mem_free(list);
}

/* ---- the model ---- */

static enum err_code view_assemble(struct view *v, size_t n, struct err *e)
{
    struct gauss all = {0};
    const struct store_meta *m = store_info(v->store);
    size_t total = 0, n_tiles;
    const struct store_tile *tiles = store_tiles(v->store, &n_tiles);
    for (size_t i = 0; i < n; i++)
        total += v->tile[v->now[i]].g.n;
    bool embed = v->bake || v->raw || v->appearance;
    enum err_code rc = gauss_alloc(&all, total, m->sh_degree, embed ? m->embed_len : 0, e);
    if (rc)
        return rc;
    all.antialiased = m->antialiased;
    if (n > 0) /* the index ascends with zoom: the last one is among the finest */
        memcpy(all.origin_enu_m, tiles[v->now[n - 1]].center_enu_m, sizeof all.origin_enu_m);
    for (size_t i = 0; !rc && i < n; i++) {
        const struct gauss *g = &v->tile[v->now[i]].g;
        rc = gauss_append(&all, g, NULL, g->n, e);
    }
    if (!rc && v->bake)
        rc = v->bake(v->bake_user, &all, e);
    else if (!rc && !v->raw)
        rc = bake_apply(v->store, v->look, &all, e);
    if (!rc && !v->raw)
        all.embed_len = 0; /* the device need not hold what nothing asks for */
    view_drop_model(v);
    if (!rc)
        rc = render_model_upload(v->render, &all, &v->model, e);
    v->model_valid = rc == ERR_OK;
    gauss_free(&all);
    return rc;
}

static enum err_code view_prepare(struct view *v, size_t n, struct err *e)
{
    bool same = v->model_valid && n == v->n_picked &&
                (n == 0 || !memcmp(v->now, v->picked, n * sizeof *v->now));
    if (same) {
        for (size_t i = 0; i < n; i++)
            v->tile[v->now[i]].used = ++v->clock;
        return ERR_OK;
    }
    enum err_code rc = view_load(v, n, e);
    if (!rc)
        rc = view_assemble(v, n, e);
    if (!rc && n > 0)
        memcpy(v->picked, v->now, n * sizeof *v->now);
    v->n_picked = n;
    view_evict(v);
    return rc;
}

enum err_code view_model(struct view *v, const struct camera *cam, const struct pick_options *po,
                         const struct render_model **out, struct view_stats *stats, struct err *e)
{
    double t0 = clock_s();
    size_t n = 0;
    *out = NULL;
    enum err_code rc = pick_tiles(v->store, cam, po, v->now, &n, e);
    double t1 = clock_s();
    if (!rc)
        rc = view_prepare(v, n, e);
    if (rc)
        return rc;
    *out = &v->model;
    *stats = (struct view_stats){.n_tiles = n,
                                 .n_gaussians = v->model.n,
                                 .ms_pick = 1e3 * (t1 - t0),
                                 .ms_load = 1e3 * (clock_s() - t1)};
    return ERR_OK;
}

enum err_code view_render(struct view *v, const struct camera *cam, const struct render_options *ro,
                          const struct pick_options *po, float *rgb, struct view_stats *stats,
                          struct err *e)
{
    struct view_stats st;
    const struct render_model *m;
    enum err_code rc = view_model(v, cam, po, &m, &st, e);
    double start = clock_s();
    if (!rc)
        rc = render_forward(v->render, m, cam, ro, rgb, NULL, e);
    st.ms_render = 1e3 * (clock_s() - start);
    if (!rc && stats)
        *stats = st;
    return rc;
}

enum err_code view_camera(const struct geo_origin *origin, const struct view_pose *pose,
                          uint32_t width_px, uint32_t height_px, struct camera *out, struct err *e)
{
    double eye[3], axes[9], zero[3] = {0};
    if (!(pose->fov_y_deg > 0.0 && pose->fov_y_deg < 180.0))
        return err_set(e, ERR_ARG,
                       "view: vertical field of view %g is not between 0 and 180 degrees",
                       pose->fov_y_deg);
    if (!(fabs(pose->pitch_deg) <= 90.0) || !isfinite(pose->heading_deg) || !width_px || !height_px)
        return err_set(e, ERR_ARG, "view: heading, pitch (-90..90) or picture size is not usable");
    enum err_code rc = geo_to_enu(origin, pose->lon_deg, pose->lat_deg, pose->h_m, eye, e);
    if (!rc)
        rc = geo_local_axes(origin, pose->lon_deg, pose->lat_deg, axes, e);
    if (rc)
        return rc;
    const double rad = 3.14159265358979323846 / 180.0;
    struct camera c = camera_heading(zero, pose->heading_deg, pose->pitch_deg,
                                     pose->fov_y_deg * rad, width_px, height_px);
    /* c.rot turns the place's own frame into the camera's; axes turns that frame into the origin's.
     */
    struct camera far = c;
    for (size_t r = 0; r < 3; r++) {
        for (size_t k = 0; k < 3; k++) {
            far.rot[3 * r + k] = 0.0;
            for (size_t j = 0; j < 3; j++)
                far.rot[3 * r + k] += c.rot[3 * r + j] * axes[3 * k + j];
        }
        far.trans[r] = 0.0;
        for (size_t k = 0; k < 3; k++)
            far.trans[r] -= far.rot[3 * r + k] * eye[k];
    }
    *out = far;
    return ERR_OK;
}
