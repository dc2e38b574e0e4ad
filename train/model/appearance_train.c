/* The appearance model in training: which parts learn when, Adam on the host, checkpoints.
 *
 * Only the embedding of the step's photograph changes. It has its own step count for the bias
 * correction. A table of thousands of photographs therefore costs nothing, and a photograph does
 * not drift on old momentum while others are shown. The arithmetic is sequential: the same input
 * gives the same bits.
 *
 * Method: REUrbanGS (ICCV 2025). docs/appearance.md explains the initial values.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/model/appearance_train.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "render/render.h"
#include "train/base/config.h"
#include "train/base/schedule.h"

#define APPEARANCE_TRAIN_BETA1 0.9
#define APPEARANCE_TRAIN_BETA2 0.999
#define APPEARANCE_TRAIN_EPS 1e-15
/* Embeddings of Gaussians and of photographs begin as the last unit vector plus noise: alike, so
 * that what is never asked for stays alike, and with a gradient through the normalisation.
 * Photographs that begin at N(0, 1) keep arbitrary differences (docs/appearance.md). */
#define APPEARANCE_TRAIN_NOISE 0.01
/* Learning rate of network and embeddings: at the start of the first level, and at the end of each.
 * The next levels start at half of the one before. */
#define APPEARANCE_TRAIN_LR 0.01
#define APPEARANCE_TRAIN_LR_FINAL 2.5e-4
enum {
    APPEARANCE_TRAIN_NEAREST = 3,
    APPEARANCE_TRAIN_STATE_VERSION = 1,
    /* length of a photograph's embedding, and width of the hidden layer; lab/studies/network.md */
    APPEARANCE_TRAIN_IMAGE_LEN = 32,
    APPEARANCE_TRAIN_HIDDEN = 32
};

bool appearance_train_wanted(const struct train_config *cfg)
{
    return cfg->appearance && cfg->embed_len > 0;
}

/* ---- room ---- */

void appearance_train_close(struct appearance_train *k)
{
    appearance_free(&k->model);
    mem_free(k->row);
    mem_free(k->alike);
    mem_free(k->weights.m1);
    mem_free(k->weights.m2);
    mem_free(k->images.m1);
    mem_free(k->images.m2);
    mem_free(k->image_steps);
    mem_free(k->frame);
    mem_free(k->frame_grad);
    mem_free(k->weight_grad);
    mem_free(k->image_grad);
    *k = (struct appearance_train){0};
}

static enum err_code appearance_train_room(struct appearance_train *k, size_t n_scene,
                                           struct err *e)
{
    const struct appearance *a = &k->model;
    size_t weights = appearance_weights(a), images = a->n_images * a->len_image;
    k->n_scene = n_scene;
    k->row = mem_array(n_scene, sizeof *k->row);
    k->alike = mem_array(a->n_images, sizeof *k->alike);
    k->weights.m1 = mem_array(weights, sizeof(float));
    k->weights.m2 = mem_array(weights, sizeof(float));
    k->images.m1 = mem_array(images, sizeof(float));
    k->images.m2 = mem_array(images, sizeof(float));
    k->image_steps = mem_array(a->n_images, sizeof *k->image_steps);
    k->frame = mem_array(appearance_frame_floats(a->len_gauss, a->hidden), sizeof(float));
    k->frame_grad = mem_array(appearance_frame_floats(a->len_gauss, a->hidden), sizeof(float));
    k->weight_grad = mem_array(weights, sizeof(float));
    k->image_grad = mem_array(a->len_image, sizeof(float));
    if (!k->row || !k->alike || !k->weights.m1 || !k->weights.m2 || !k->images.m1 ||
        !k->images.m2 || !k->image_steps || !k->frame || !k->frame_grad || !k->weight_grad ||
        !k->image_grad)
        return err_set(e, ERR_MEM, "appearance: out of memory for %zu photographs", a->n_images);
    for (size_t i = 0; i < n_scene; i++)
        k->row[i] = APPEARANCE_TRAIN_ROW_NONE;
    return ERR_OK;
}

static enum err_code appearance_train_fresh(struct appearance_train *k,
                                            const struct train_config *cfg, const struct scene *s,
                                            const uint32_t *images, size_t n_images, struct err *e)
{
    enum err_code rc =
        appearance_alloc(&k->model, (uint32_t)cfg->embed_len, APPEARANCE_TRAIN_IMAGE_LEN,
                         APPEARANCE_TRAIN_HIDDEN, n_images, e);
    if (rc)
        return rc;
    appearance_init(&k->model, (uint64_t)cfg->seed);
    for (size_t i = 0; i < n_images * k->model.len_image; i++) {
        bool last = i % k->model.len_image + 1 == k->model.len_image;
        k->model.images[i] =
            (last ? 1.0f : 0.0f) + (float)APPEARANCE_TRAIN_NOISE * k->model.images[i];
    }
    for (size_t i = 0; i < n_images; i++) {
        const char *name = s->images[images[i]].name;
        if (strlen(name) >= APPEARANCE_NAME_MAX)
            return err_set(e, ERR_LIMIT,
                           "photograph %.40s...: names of more than %d bytes do not fit the "
                           "appearance table: rename it",
                           name, APPEARANCE_NAME_MAX - 1);
        memcpy(k->model.names[i], name, strlen(name) + 1);
    }
    return ERR_OK;
}

static enum err_code appearance_train_copy(struct appearance_train *k,
                                           const struct train_config *cfg,
                                           const struct appearance *from, struct err *e)
{
    if (from->len_gauss != (uint32_t)cfg->embed_len ||
        from->len_image != APPEARANCE_TRAIN_IMAGE_LEN || from->hidden != APPEARANCE_TRAIN_HIDDEN)
        return err_set(e, ERR_DATA,
                       "the shared appearance model has lengths %u, %u and %u, the options say "
                       "%lld, %d and %d: train it anew with these options",
                       from->len_gauss, from->len_image, from->hidden, (long long)cfg->embed_len,
                       APPEARANCE_TRAIN_IMAGE_LEN, APPEARANCE_TRAIN_HIDDEN);
    enum err_code rc = appearance_alloc(&k->model, from->len_gauss, from->len_image, from->hidden,
                                        from->n_images, e);
    if (rc)
        return rc;
    memcpy(k->model.w1, from->w1, appearance_weights(from) * sizeof(float));
    memcpy(k->model.images, from->images, from->n_images * from->len_image * sizeof(float));
    memcpy(k->model.names, from->names, from->n_images * sizeof *from->names);
    k->shared = true;
    return ERR_OK;
}

struct appearance_train_name {
    const char *name;
    uint32_t row;
};

static int appearance_train_compare(const void *a, const void *b)
{
    return strcmp(((const struct appearance_train_name *)a)->name,
                  ((const struct appearance_train_name *)b)->name);
}

static enum err_code appearance_train_rows(const struct appearance *a, const struct scene *s,
                                           uint32_t *row, struct err *e)
{
    struct appearance_train_name *list = mem_array(a->n_images, sizeof *list);
    if (!list)
        return err_set(e, ERR_MEM, "appearance: out of memory for %zu photographs", a->n_images);
    for (size_t i = 0; i < a->n_images; i++)
        list[i] = (struct appearance_train_name){a->names[i], (uint32_t)i};
    qsort(list, a->n_images, sizeof *list, appearance_train_compare);
    for (size_t i = 0; i < s->n_images; i++) {
        struct appearance_train_name want = {s->images[i].name, 0};
        const struct appearance_train_name *hit =
            bsearch(&want, list, a->n_images, sizeof *list, appearance_train_compare);
        row[i] = hit ? hit->row : APPEARANCE_TRAIN_ROW_NONE;
    }
    mem_free(list);
    return ERR_OK;
}

/* Photographs of one appearance group learn as one: the first of them does, for all. */
static enum err_code appearance_train_match_groups(struct appearance_train *k,
                                                   const struct scene *s, const uint32_t *images,
                                                   size_t n_images, struct err *e)
{
    uint32_t most = 0;
    for (size_t i = 0; i < n_images; i++)
        most = s->images[images[i]].group > most ? s->images[images[i]].group : most;
    if (most > s->n_images + n_images)
        return err_set(e, ERR_DATA, "%s: appearance group %u of %zu photographs", s->dir, most,
                       s->n_images);
    uint32_t *first = mem_array((size_t)most + 1, sizeof *first); /* row + 1, 0 = none yet */
    if (!first)
        return err_set(e, ERR_MEM, "appearance: out of memory for %u groups", most);
    for (size_t i = 0; i < n_images; i++) {
        uint32_t *f = &first[s->images[images[i]].group];
        if (!*f)
            *f = (uint32_t)i + 1;
        k->row[images[i]] = (uint32_t)i;
        k->alike[i] = *f - 1;
        memcpy(k->model.images + i * k->model.len_image,
               k->model.images + (size_t)k->alike[i] * k->model.len_image,
               k->model.len_image * sizeof(float));
    }
    mem_free(first);
    return ERR_OK;
}

static enum err_code appearance_train_match_shared(struct appearance_train *k,
                                                   const struct scene *s, const uint32_t *images,
                                                   size_t n_images, struct err *e)
{
    enum err_code rc = appearance_train_rows(&k->model, s, k->row, e);
    for (size_t i = 0; !rc && i < n_images; i++)
        if (k->row[images[i]] == APPEARANCE_TRAIN_ROW_NONE)
            rc = err_set(e, ERR_DATA,
                         "the shared appearance model does not know photograph %s: train it anew "
                         "for this scene",
                         s->images[images[i]].name);
    return rc;
}

enum err_code appearance_train_open(struct appearance_train *k, const struct train_config *cfg,
                                    const struct scene *s, const uint32_t *images, size_t n_images,
                                    const struct appearance *shared, struct err *e)
{
    *k = (struct appearance_train){0};
    enum err_code rc = shared ? appearance_train_copy(k, cfg, shared, e)
                              : appearance_train_fresh(k, cfg, s, images, n_images, e);
    if (!rc)
        rc = appearance_train_room(k, s->n_images, e);
    if (!rc)
        rc = shared ? appearance_train_match_shared(k, s, images, n_images, e)
                    : appearance_train_match_groups(k, s, images, n_images, e);
    if (rc)
        appearance_train_close(k);
    return rc;
}

enum err_code appearance_train_embed(const struct appearance_train *k, uint64_t seed,
                                     struct gauss *g, struct err *e)
{
    struct gauss with = {0};
    uint32_t len = k->model.len_gauss;
    uint64_t stream = train_stream(TRAIN_STREAM_EMBED, 1, 0);
    enum err_code rc = gauss_alloc(&with, g->n, g->sh_degree, len, e);
    if (rc)
        return rc;
    with.antialiased = g->antialiased;
    memcpy(with.origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    rc = gauss_append(&with, g, NULL, g->n, e);
    for (size_t i = 0; !rc && i < with.n; i++)
        for (uint32_t c = 0; c < len; c++)
            with.embed[i * len + c] =
                (float)((c + 1 == len ? 1.0 : 0.0) +
                        APPEARANCE_TRAIN_NOISE * rng_normal(seed, stream, (uint64_t)i * len + c));
    if (rc) {
        gauss_free(&with);
        return rc;
    }
    gauss_free(g);
    *g = with;
    return ERR_OK;
}

/* ---- when ---- */

bool appearance_train_learns(const struct appearance_train *k, const struct schedule *s)
{
    return !k->shared && !s->derived; /* one made of a finer level has its network */
}

uint32_t appearance_train_warmup(const struct appearance_train *k, const struct train_config *cfg,
                                 const struct schedule *s)
{
    if (k->shared || s->turn > 1)
        return 0;
    return (uint32_t)floor((double)cfg->appearance_warmup * s->kappa + 0.5);
}

double appearance_train_lr(const struct appearance_train *k, const struct train_config *cfg,
                           const struct schedule *s, uint32_t step)
{
    uint32_t from = appearance_train_warmup(k, cfg, s);
    double first = APPEARANCE_TRAIN_LR * pow(0.5, (double)s->turn - 1.0);
    double last = fmin(APPEARANCE_TRAIN_LR_FINAL, first);
    if (step <= from || !(first > 0.0))
        return 0.0;
    double t = 1.0;
    if (!s->last && s->steps > from)
        t = (double)(step - from) / (double)(s->steps - from);
    return last > 0.0 ? exp((1.0 - t) * log(first) + t * log(last)) : first;
}

/* ---- a step ---- */

const float *appearance_train_frame(struct appearance_train *k, uint32_t image)
{
    if (!appearance_train_is_on(k) || image >= k->n_scene ||
        k->row[image] == APPEARANCE_TRAIN_ROW_NONE)
        return NULL;
    appearance_frame(&k->model, k->model.images + (size_t)k->row[image] * k->model.len_image,
                     k->frame);
    return k->frame;
}

static void appearance_train_adam(float *x, float *m1, float *m2, const float *grad, size_t n,
                                  uint32_t t, double lr)
{
    double c1 = 1.0 - pow(APPEARANCE_TRAIN_BETA1, t), c2 = 1.0 - pow(APPEARANCE_TRAIN_BETA2, t);
    for (size_t i = 0; i < n; i++) {
        double g = (double)grad[i];
        double a = APPEARANCE_TRAIN_BETA1 * (double)m1[i] + (1.0 - APPEARANCE_TRAIN_BETA1) * g;
        double b = APPEARANCE_TRAIN_BETA2 * (double)m2[i] + (1.0 - APPEARANCE_TRAIN_BETA2) * g * g;
        m1[i] = (float)a;
        m2[i] = (float)b;
        x[i] = (float)((double)x[i] - lr * (a / c1) / (sqrt(b / c2) + APPEARANCE_TRAIN_EPS));
    }
}

static bool appearance_train_finite(const float *x, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!isfinite(x[i]))
            return false;
    return true;
}

void appearance_train_update(struct appearance_train *k, uint32_t image, double lr)
{
    struct appearance *a = &k->model;
    size_t len = a->len_image, weights = appearance_weights(a);
    size_t row = k->alike[k->row[image]];
    appearance_backward(a, a->images + row * len, k->frame_grad, k->weight_grad, k->image_grad);
    if (!appearance_train_finite(k->weight_grad, weights) ||
        !appearance_train_finite(k->image_grad, len))
        return; /* as the device drops an update that is not finite */
    appearance_train_adam(a->w1, k->weights.m1, k->weights.m2, k->weight_grad, weights,
                          ++k->weight_steps, lr);
    appearance_train_adam(a->images + row * len, k->images.m1 + row * len, k->images.m2 + row * len,
                          k->image_grad, len, ++k->image_steps[row], lr);
    for (size_t i = row + 1; i < a->n_images; i++)
        if (k->alike[i] == row)
            memcpy(a->images + i * len, a->images + row * len, len * sizeof(float));
}

void appearance_train_restart(struct appearance_train *k)
{
    const struct appearance *a = &k->model;
    if (!appearance_train_is_on(k))
        return;
    memset(k->weights.m1, 0, appearance_weights(a) * sizeof(float));
    memset(k->weights.m2, 0, appearance_weights(a) * sizeof(float));
    memset(k->images.m1, 0, a->n_images * a->len_image * sizeof(float));
    memset(k->images.m2, 0, a->n_images * a->len_image * sizeof(float));
    memset(k->image_steps, 0, a->n_images * sizeof *k->image_steps);
    k->weight_steps = 0;
}

/* ---- cameras without an embedding ---- */

static double appearance_train_reach(const struct scene *s)
{
    double up = 0.0, ground = 0.0, center[3];
    if (!s->n_images || !s->n_points)
        return 1.0;
    for (size_t i = 0; i < s->n_images; i++) {
        camera_center(&s->images[i].cam, center);
        up += center[2] / (double)s->n_images;
    }
    for (size_t i = 0; i < s->n_points; i++)
        ground += s->points[i].enu_m[2] / (double)s->n_points;
    return fmax(fabs(up - ground), 1.0);
}

static double appearance_train_distance(const struct camera *a, const struct camera *b,
                                        double reach_m)
{
    double p[3], q[3], d = 0.0, c = 0.0;
    camera_center(a, p);
    camera_center(b, q);
    for (int k = 0; k < 3; k++) {
        d += (p[k] - q[k]) * (p[k] - q[k]);
        c += a->rot[6 + k] * b->rot[6 + k]; /* the third row is the viewing axis */
    }
    return sqrt(d) + reach_m * acos(fmin(fmax(c, -1.0), 1.0));
}

size_t appearance_train_nearest(const struct appearance *a, const struct scene *s,
                                const uint32_t *row, const struct camera *cam, double reach_m,
                                float *out)
{
    uint32_t index[APPEARANCE_TRAIN_NEAREST];
    double at[APPEARANCE_TRAIN_NEAREST], weight[APPEARANCE_TRAIN_NEAREST];
    size_t n = 0;
    for (size_t i = 0; i < s->n_images; i++) {
        double d = appearance_train_distance(cam, &s->images[i].cam, reach_m);
        if (row[i] == APPEARANCE_TRAIN_ROW_NONE ||
            (n == APPEARANCE_TRAIN_NEAREST && d >= at[n - 1]))
            continue;
        size_t k = n < APPEARANCE_TRAIN_NEAREST ? n++ : n - 1;
        for (; k > 0 && at[k - 1] > d; k--) {
            at[k] = at[k - 1];
            index[k] = index[k - 1];
        }
        at[k] = d;
        index[k] = row[i];
    }
    for (size_t k = 0; k < n; k++)
        weight[k] = 1.0 / (double)n;
    memset(out, 0, a->len_image * sizeof(float));
    if (n)
        appearance_blend(a, index, weight, n, out);
    return n;
}

enum err_code appearance_view_open(struct appearance_view *v, const struct appearance *model,
                                   const struct scene *s, struct err *e)
{
    *v = (struct appearance_view){.model = model,
                                  .scene = s,
                                  .reach_m = appearance_train_reach(s),
                                  .photograph = APPEARANCE_VIEW_NEAREST};
    v->row = mem_array(s->n_images, sizeof *v->row);
    v->image = mem_array(model->len_image, sizeof(float));
    v->frame = mem_array(appearance_frame_floats(model->len_gauss, model->hidden), sizeof(float));
    enum err_code rc = v->row && v->image && v->frame
                           ? appearance_train_rows(model, s, v->row, e)
                           : err_set(e, ERR_MEM, "appearance: out of memory");
    if (rc)
        appearance_view_close(v);
    return rc;
}

void appearance_view_close(struct appearance_view *v)
{
    mem_free(v->row);
    mem_free(v->image);
    mem_free(v->frame);
    *v = (struct appearance_view){0};
}

const float *appearance_view_frame(struct appearance_view *v, const struct camera *cam)
{
    uint32_t p = v->photograph;
    if (p < v->scene->n_images && v->row[p] != APPEARANCE_TRAIN_ROW_NONE)
        appearance_blend(v->model, &v->row[p], (const double[]){1.0}, 1, v->image);
    else if (!appearance_train_nearest(v->model, v->scene, v->row, cam, v->reach_m, v->image))
        return NULL;
    appearance_frame(v->model, v->image, v->frame);
    return v->frame;
}

/* ---- checkpoints ---- */

bool appearance_train_same(const struct appearance *a, const struct appearance *b)
{
    return a->len_gauss == b->len_gauss && a->len_image == b->len_image && a->hidden == b->hidden &&
           a->n_images == b->n_images &&
           !memcmp(a->w1, b->w1, appearance_weights(a) * sizeof(float)) &&
           !memcmp(a->images, b->images, a->n_images * a->len_image * sizeof(float)) &&
           !memcmp(a->names, b->names, a->n_images * sizeof *a->names);
}

struct appearance_train_part {
    void *data;
    size_t bytes;
};
enum { APPEARANCE_TRAIN_PARTS = 5 };
static void appearance_train_parts(const struct appearance_train *k,
                                   struct appearance_train_part out[APPEARANCE_TRAIN_PARTS])
{
    const struct appearance *a = &k->model;
    size_t weights = appearance_weights(a) * sizeof(float);
    size_t images = a->n_images * a->len_image * sizeof(float);
    out[0] = (struct appearance_train_part){k->weights.m1, weights};
    out[1] = (struct appearance_train_part){k->weights.m2, weights};
    out[2] = (struct appearance_train_part){k->images.m1, images};
    out[3] = (struct appearance_train_part){k->images.m2, images};
    out[4] = (struct appearance_train_part){k->image_steps, a->n_images * sizeof *k->image_steps};
}

enum err_code appearance_train_write_state(const struct appearance_train *k, struct buf *out,
                                           struct err *e)
{
    struct appearance_train_part part[APPEARANCE_TRAIN_PARTS];
    appearance_train_parts(k, part);
    buf_u32(out, APPEARANCE_TRAIN_STATE_VERSION);
    buf_u32(out, k->weight_steps);
    for (size_t i = 0; i < APPEARANCE_TRAIN_PARTS; i++)
        buf_add(out, part[i].data, part[i].bytes);
    return buf_check(out, e);
}

enum err_code appearance_train_read_state(struct appearance_train *k, const void *model,
                                          size_t n_model, const void *state, size_t n_state,
                                          struct err *e)
{
    struct appearance saved = {0};
    struct appearance_train_part part[APPEARANCE_TRAIN_PARTS];
    struct cursor c = cursor_over(state, n_state);
    enum err_code rc = appearance_read(model, n_model, &saved, e);
    if (rc)
        return rc;
    const struct appearance *a = &k->model;
    if (saved.len_gauss != a->len_gauss || saved.len_image != a->len_image ||
        saved.hidden != a->hidden || saved.n_images != a->n_images ||
        memcmp(saved.names, a->names, a->n_images * sizeof *a->names) != 0)
        rc = err_set(e, ERR_DATA, "the appearance model is that of other photographs or lengths");
    else if (k->shared && !appearance_train_same(&saved, a))
        rc = err_set(e, ERR_DATA,
                     "the shared appearance model was trained anew since: --overwrite trains "
                     "this cell with it");
    uint32_t version = cursor_u32(&c), steps = cursor_u32(&c);
    appearance_train_parts(k, part);
    for (size_t i = 0; !rc && i < APPEARANCE_TRAIN_PARTS; i++) {
        const uint8_t *from = cursor_take(&c, part[i].bytes);
        if (from)
            memcpy(part[i].data, from, part[i].bytes);
    }
    if (!rc && (c.bad || cursor_left(&c) || version != APPEARANCE_TRAIN_STATE_VERSION))
        rc = err_set(e, ERR_FORMAT, "'%s' does not hold what it should",
                     APPEARANCE_TRAIN_BLOB_STATE);
    if (!rc) {
        k->weight_steps = steps;
        memcpy(k->model.w1, saved.w1, appearance_weights(a) * sizeof(float));
        memcpy(k->model.images, saved.images, a->n_images * a->len_image * sizeof(float));
    }
    appearance_free(&saved);
    return rc;
}
