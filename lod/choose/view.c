/* A picture of a store: selects tiles, brings them to the device, lists their blocks that may be in
 * view, and renders.
 *
 * Tiles on the device have trained colours. The appearance of a photograph is a few hundred
 * numbers, which the renderer gets with the frame.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/geo/geo.h"
#include "core/splat/appearance.h"
#include "lod/choose/pick.h"
#include "lod/choose/resident.h"
#include "lod/choose/view.h"
#include "lod/store/bake.h"
#include "lod/store/store.h"

#define VIEW_CACHE_BYTES ((size_t)1 << 30)
/* Below this many pixels of their largest sigmas in the mean, Gaussians tile surfaces; photographs
 * show them at 1.7 and more (docs/decisions/021-low-pass.md). */
#define VIEW_SMALL_PX 1.6
/* Tile lists of a moving camera (docs/decisions/027-streams.md). They get room where the picture
 * moved by at most VIEW_STEP_MOST_PX since the last one. They are used until it has moved by more
 * than the room and VIEW_BEYOND_PX. Movement is that of things at a near depth: VIEW_NEAR of the
 * splats are nearer, and move more. */
#define VIEW_STEP_MOST_PX 4.0
#define VIEW_ROOM_PX 2.0
#define VIEW_BEYOND_PX 2.0
#define VIEW_NEAR 0.05

struct view_moving {           /* the last picture of a moving camera */
    bool made;                 /* it may be used */
    uint64_t frame;            /* of the renderer, when it was drawn */
    struct camera listed, cam; /* of the picture whose lists it has, and its own */
    struct render_options ro;
    uint64_t max_gaussians;
    double error_px;
    double near_m, room_px;
    struct view_stats stats;
};

struct view {
    struct store *store;
    struct render *render; /* borrowed */
    struct resident resident;
    uint32_t *now;                       /* tiles of the picture being made, scratch */
    const struct appearance *appearance; /* of the store; NULL: none */
    float *frame;                        /* of the appearance, see appearance_frame; NULL: none */
    struct view_moving moving;
};

/* Of store, which is taken, also on failure. */
static enum err_code view_open_store(struct store *store, const char *store_path, struct render *r,
                                     size_t cache_bytes, struct view **out, struct err *e)
{
    *out = NULL;
    struct view *v = mem_array(1, sizeof *v);
    if (!v) {
        store_close(&store);
        return err_set(e, ERR_MEM, "%s: out of memory", store_path);
    }
    v->render = r;
    v->store = store;
    enum err_code rc = bake_of(v->store, &v->appearance, e);
    if (!rc)
        rc = resident_open(v->store, r, v->appearance ? store_info(v->store)->embed_len : 0,
                           cache_bytes ? cache_bytes : VIEW_CACHE_BYTES, &v->resident, e);
    if (!rc && !(v->now = mem_array(v->resident.n_tiles, sizeof *v->now)))
        rc =
            err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", store_path, v->resident.n_tiles);
    if (!rc && v->appearance)
        rc = view_set_appearance(v, NULL, e);
    if (rc)
        view_close(&v);
    *out = v;
    return rc;
}

enum err_code view_open(const char *store_path, struct render *r, size_t cache_bytes,
                        struct view **out, struct err *e)
{
    struct store *s = NULL;
    enum err_code rc = store_open(store_path, &s, e);
    *out = NULL;
    return !rc ? view_open_store(s, store_path, r, cache_bytes, out, e) : rc;
}

enum err_code view_open_fd(int fd, const char *name, struct render *r, size_t cache_bytes,
                           struct view **out, struct err *e)
{
    struct store *s = NULL;
    enum err_code rc = store_open_fd(fd, name, &s, e);
    *out = NULL;
    return !rc ? view_open_store(s, name, r, cache_bytes, out, e) : rc;
}

void view_close(struct view **vp)
{
    struct view *v = *vp;
    if (!v)
        return;
    resident_close(&v->resident);
    mem_free(v->now);
    mem_free(v->frame);
    store_close(&v->store);
    mem_free(v);
    *vp = NULL;
}

void view_shrink(struct view *v)
{
    v->moving.made = false;
    resident_shrink(&v->resident);
}

const struct store *view_store(const struct view *v)
{
    return v->store;
}

void view_lift(struct view *v, double up_m)
{
    store_lift(v->store, up_m);
}

enum err_code view_get_blob(struct view *v, const char *name, struct buf *out, struct err *e)
{
    return store_get_blob(v->store, name, out, e);
}

const struct appearance *view_appearance(const struct view *v)
{
    return v->appearance;
}

enum err_code view_set_appearance(struct view *v, const float *image, struct err *e)
{
    const struct appearance *a = v->appearance;
    float by_default[APPEARANCE_IMAGE_MAX];
    enum err_code rc = ERR_OK;
    if (!a)
        return ERR_OK;
    const size_t n = appearance_frame_floats(a->len_gauss, a->hidden);
    float *frame = mem_array(n, sizeof *frame);
    if (!frame)
        return err_set(e, ERR_MEM, "view: out of memory");
    if (!image)
        rc = bake_find(v->store, BAKE_DEFAULT, by_default, e);
    if (!rc)
        appearance_frame(a, image ? image : by_default, frame);
    if (rc) {
        mem_free(frame);
        return rc;
    }
    v->moving.made = v->moving.made && memcmp(frame, v->frame, n * sizeof *frame) == 0;
    mem_free(v->frame);
    v->frame = frame;
    return ERR_OK;
}

enum err_code view_find_appearance(struct view *v, const char *text, float *image, struct err *e)
{
    return bake_find(v->store, text, image, e);
}

enum err_code view_model(struct view *v, const struct camera *cam, const struct pick_options *po,
                         const struct render_model **out, struct view_stats *stats, struct err *e)
{
    double t0 = clock_s();
    size_t n = 0, n_tiles;
    *out = NULL;
    v->moving.made = false;
    enum err_code rc = pick_tiles(v->store, cam, po, v->now, &n, e);
    double t1 = clock_s();
    if (!rc)
        rc = resident_flat(&v->resident, v->now, n, e);
    if (rc)
        return rc;
    const struct store_tile *tiles = store_tiles(v->store, &n_tiles);
    *out = &v->resident.flat;
    *stats = (struct view_stats){
        .n_tiles = n, .ms_pick = 1e3 * (t1 - t0), .ms_load = 1e3 * (clock_s() - t1)};
    for (size_t i = 0; i < n; i++)
        stats->n_gaussians += tiles[v->now[i]].count;
    return ERR_OK;
}

/* What VIEW_SUPERSAMPLE_AUTO is for these tiles. */
static uint32_t view_supersample(const struct view *v, const struct camera *cam,
                                 const struct view_tiles *drawn, const struct render_options *ro)
{
    size_t n_all;
    const struct store_tile *tiles = store_tiles(v->store, &n_all);
    double eye[3], count = 0.0, sigma_px = 0.0;
    camera_center(cam, eye);
    for (size_t i = 0; i < drawn->n; i++) {
        const struct store_tile *t = &tiles[drawn->tile[i]];
        const struct store_shape x = store_shape(v->store, t);
        double d2 = 0.0;
        for (int k = 0; k < 3; k++) {
            double d = 0.5 * (x.core_min_enu_m[k] + x.core_max_enu_m[k]) - eye[k];
            d2 += d * d;
        }
        count += t->count;
        sigma_px += t->count * x.sigma_median_m * cam->fx_px /
                    (ro->orthographic ? 1.0 : fmax(sqrt(d2), RENDER_NEAR_M));
    }
    bool fits = cam->width_px <= RENDER_SIZE_MAX_PX / 2 && cam->height_px <= RENDER_SIZE_MAX_PX / 2;
    return ro->aa != RENDER_AA_NONE && fits && sigma_px < VIEW_SMALL_PX * count ? 2 : 1;
}

/* The options of the renderer, for a picture with supersampling as settled. */
static struct render_options view_options(const struct view *v, const struct render_options *ro,
                                          uint32_t supersample)
{
    struct render_options o = *ro;
    o.picture = true;
    o.supersample = supersample;
    if (v->frame && !o.appearance_frame) {
        o.appearance_frame = v->frame;
        o.appearance_hidden = v->appearance->hidden;
    }
    return o;
}

enum err_code view_render_tiles(struct view *v, const struct view_tiles *tiles,
                                const struct camera *cam, const struct render_options *ro,
                                float *rgb, struct view_stats *stats, struct err *e)
{
    struct view_stats st = {.n_tiles = tiles->n};
    struct frustum f;
    double t0 = clock_s();
    v->moving.made = false;
    if (tiles->weight && v->appearance)
        return err_set(e, ERR_ARG, "view: tiles with appearance are drawn in full or not at all");
    if (ro->orthographic)
        frustum_make_orthographic(cam, &f);
    else
        frustum_make(cam, &f);
    for (size_t i = 0; i < tiles->n; i++)
        resident_weigh(&v->resident, tiles->tile[i], tiles->weight ? tiles->weight[i] : 1.0f);
    enum err_code rc = resident_show(&v->resident, tiles->tile, tiles->n, tiles->whole ? NULL : &f,
                                     &st.n_gaussians, e);
    double t1 = clock_s();
    st.ms_load = 1e3 * (t1 - t0);
    const struct render_options o =
        view_options(v, ro,
                     ro->supersample == VIEW_SUPERSAMPLE_AUTO ? view_supersample(v, cam, tiles, ro)
                                                              : ro->supersample);
    if (!rc)
        rc = render_forward(v->render, &v->resident.model, cam, &o, rgb, NULL, e);
    st.ms_render = 1e3 * (clock_s() - t1);
    st.n_visible = render_last_stats(v->render)->visible;
    if (!rc && stats)
        *stats = st;
    return rc;
}

enum err_code view_render(struct view *v, const struct camera *cam, const struct render_options *ro,
                          const struct pick_options *po, float *rgb, struct view_stats *stats,
                          struct err *e)
{
    struct pick_options pick = po ? *po : (struct pick_options){0};
    struct view_tiles tiles = {.tile = v->now, .whole = pick.whole_tiles};
    double t0 = clock_s(), ms_pick;
    pick.orthographic = ro->orthographic;
    enum err_code rc = pick_tiles(v->store, cam, &pick, v->now, &tiles.n, e);
    ms_pick = 1e3 * (clock_s() - t0);
    if (!rc)
        rc = view_render_tiles(v, &tiles, cam, ro, rgb, stats, e);
    if (!rc && stats)
        stats->ms_pick = ms_pick;
    return rc;
}

/* Whether the last picture of a moving camera was of these Gaussians, and the renderer's last. */
static bool view_is_next(const struct view *v, const struct render_options *ro,
                         const struct pick_options *po)
{
    const struct view_moving *m = &v->moving;
    const struct render_options *was = &m->ro;
    return m->made && m->frame == render_frames(v->render) && was->aa == ro->aa &&
           was->near_m == ro->near_m && was->kernel_px2 == ro->kernel_px2 &&
           was->sh_degree == ro->sh_degree && was->supersample == ro->supersample &&
           was->edge == ro->edge && m->max_gaussians == po->max_gaussians &&
           m->error_px == po->error_px;
}

static enum err_code view_draw_again(struct view *v, const struct camera *cam,
                                     const struct render_options *ro, float *rgb, struct err *e)
{
    struct render_options o = view_options(v, ro, ro->supersample);
    double t0 = clock_s();
    o.list_again = true;
    o.list_room_px = (float)v->moving.room_px;
    v->moving.made = false;
    enum err_code rc = render_forward(v->render, &v->resident.model, cam, &o, rgb, NULL, e);
    v->moving.stats.ms_pick = v->moving.stats.ms_load = 0.0;
    v->moving.stats.ms_render = 1e3 * (clock_s() - t0);
    return rc;
}

enum err_code view_render_moving(struct view *v, const struct camera *cam,
                                 const struct render_options *ro, const struct pick_options *po,
                                 float *rgb, struct view_stats *stats, struct err *e)
{
    const struct pick_options pick = po ? *po : (struct pick_options){0};
    struct view_moving *m = &v->moving;
    struct render_options o = *ro;
    if (ro->orthographic || ro->appearance_frame || ro->background_where || ro->depth_unit_m > 0 ||
        ro->supersample == VIEW_SUPERSAMPLE_AUTO || pick.before || pick.metric || pick.no_lod)
        return view_render(v, cam, ro, po, rgb, stats, e);
    const double fine = ro->supersample > 1 ? ro->supersample : 1;
    const bool next = view_is_next(v, ro, &pick);
    double step_px = HUGE_VAL, moved_px = HUGE_VAL;
    if (next) {
        step_px = fine * camera_moved_px(&m->cam, cam, m->near_m);
        moved_px = fine * camera_moved_px(&m->listed, cam, m->near_m);
    }
    enum err_code rc = ERR_OK;
    if (moved_px <= m->room_px + VIEW_BEYOND_PX) {
        rc = view_draw_again(v, cam, ro, rgb, e);
    } else {
        m->room_px = step_px <= VIEW_STEP_MOST_PX ? VIEW_ROOM_PX : 0.0;
        o.list_room_px = (float)m->room_px;
        rc = view_render(v, cam, &o, po, rgb, &m->stats, e);
        if (!rc)
            rc = render_depth_quantile(v->render, VIEW_NEAR, &m->near_m, e);
        m->listed = *cam;
        m->ro = *ro;
        m->max_gaussians = pick.max_gaussians;
        m->error_px = pick.error_px;
    }
    m->cam = *cam;
    m->frame = render_frames(v->render);
    m->made = !rc;
    if (!rc && stats)
        *stats = m->stats;
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
