/* A picture of a store: pick the tiles, have them decoded, put them together on the device, render.
 *
 * Two caches. Decoded tiles stay in memory, in the device's layout, up to a number of bytes, least
 * recently used out first. The tiles of the last picture stay together on the device as one model:
 * while the same tiles are picked a picture costs a render and nothing else, and when some change,
 * those behind the first that differs are copied. Nothing is computed for it: colours are as they
 * were trained, and the look of a photograph is a few hundred numbers that the renderer gets with
 * the frame.
 *
 * The model's origin is the centre of the first tile of the store, whatever is in view: pictures
 * depend on the request alone, never on the ones before.
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
    float *packed; /* see render_piece_pack */
    uint32_t n;    /* Gaussians */
    size_t bytes;  /* 0 = not resident */
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
    const struct appearance *appearance; /* of the store; NULL: none */
    float *frame;                        /* of the look, see appearance_frame; NULL: none */
    struct render_piece *pieces;         /* scratch, [n_tiles] */
};

/* An empty model, about the first tile: an index that never changes. */
static void view_model_start(struct view *v)
{
    size_t n;
    const struct store_tile *tiles = store_tiles(v->store, &n);
    v->model.sh_degree = store_info(v->store)->sh_degree;
    v->model.embed_len = v->appearance ? store_info(v->store)->embed_len : 0;
    if (n > 0)
        memcpy(v->model.origin_enu_m, tiles[0].center_enu_m, sizeof v->model.origin_enu_m);
}

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
        v->pieces = mem_array(v->n_tiles, sizeof *v->pieces);
        if (!v->tile || !v->picked || !v->now || !v->pieces)
            rc = err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", store_path, v->n_tiles);
    }
    if (!rc)
        view_model_start(v);
    if (!rc && v->appearance)
        rc = view_set_look(v, NULL, e);
    if (rc)
        view_close(&v);
    *out = v;
    return rc;
}

void view_close(struct view **vp)
{
    struct view *v = *vp;
    if (!v)
        return;
    render_model_free(&v->model);
    for (size_t i = 0; v->tile && i < v->n_tiles; i++)
        mem_free(v->tile[i].packed);
    mem_free(v->tile);
    mem_free(v->picked);
    mem_free(v->now);
    mem_free(v->pieces);
    mem_free(v->frame);
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

enum err_code view_set_look(struct view *v, const float *image, struct err *e)
{
    const struct appearance *a = v->appearance;
    float default_look[APPEARANCE_IMAGE_MAX];
    enum err_code rc = ERR_OK;
    if (!a)
        return ERR_OK;
    if (!v->frame)
        v->frame = mem_array(appearance_frame_floats(a->len_gauss, a->hidden), sizeof *v->frame);
    if (!v->frame)
        return err_set(e, ERR_MEM, "view: out of memory");
    if (!image)
        rc = bake_find(v->store, BAKE_DEFAULT, default_look, e);
    if (!rc)
        appearance_frame(a, image ? image : default_look, v->frame);
    return rc;
}

enum err_code view_find_look(struct view *v, const char *look, float *image, struct err *e)
{
    return bake_find(v->store, look, image, e);
}

/* ---- decoded tiles ---- */

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
    struct gauss g = {0};
    enum err_code rc = payload_decode(b->payload[i].data, b->payload[i].size, NULL, &g, e);
    if (rc)
        return err_add(e, "tile %u/%u/%u", t->key.z, t->key.x, t->key.y);
    const struct render_model *m = &b->view->model;
    memcpy(g.origin_enu_m, t->center_enu_m, sizeof g.origin_enu_m);
    if (!m->embed_len)
        g.embed_len = 0; /* nothing would say what they mean */
    if (g.sh_degree != m->sh_degree || g.embed_len != m->embed_len)
        rc = err_set(e, ERR_FORMAT, "tile %u/%u/%u: other harmonics or embeddings than the store's",
                     t->key.z, t->key.x, t->key.y);
    size_t floats = (size_t)render_piece_groups(g.n) * RENDER_LANES *
                    render_planes_embed(g.sh_degree, g.embed_len);
    if (!rc && !(to->packed = mem_array(floats ? floats : 1, sizeof(float))))
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g.n);
    if (!rc) {
        render_piece_pack(&g, m->origin_enu_m, to->packed);
        to->n = (uint32_t)g.n;
        to->bytes = floats * sizeof(float) + sizeof *to;
    }
    gauss_free(&g);
    return rc;
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
        if (rc) { /* of all or of none */
            mem_free(t->packed);
            t->packed = NULL;
            t->bytes = 0;
        }
        b->view->resident_bytes += t->bytes;
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
        mem_free(list[i]->packed);
        list[i]->packed = NULL;
    }
    mem_free(list);
}

/* ---- the model ---- */

static enum err_code view_assemble(struct view *v, size_t n, struct err *e)
{
    size_t same = 0;
    while (v->model_valid && same < n && same < v->n_picked && v->now[same] == v->picked[same])
        same++;
    for (size_t i = 0; i < n; i++) {
        const struct view_tile *t = &v->tile[v->now[i]];
        v->pieces[i] = (struct render_piece){t->packed, render_piece_groups(t->n)};
    }
    enum err_code rc = render_model_assemble(v->render, v->pieces, n, same, &v->model, e);
    v->model_valid = rc == ERR_OK;
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

static uint64_t view_count(const struct view *v, size_t n)
{
    size_t n_tiles;
    const struct store_tile *tiles = store_tiles(v->store, &n_tiles);
    uint64_t sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += tiles[v->now[i]].count;
    return sum;
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
                                 .n_gaussians = view_count(v, n),
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
    struct render_options o = *ro;
    if (v->frame && !o.appearance_frame) {
        o.appearance_frame = v->frame;
        o.appearance_hidden = v->appearance->hidden;
    }
    if (!rc)
        rc = render_forward(v->render, m, cam, &o, rgb, NULL, e);
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
