/* Appearances of a tile store: from trained colours to colours in some light.
 *
 * Tiles hold trained colours and the embedding of each Gaussian. The blob "appearance" holds the
 * network, the photographs' embeddings and one more row, BAKE_DEFAULT, for clients that do not ask
 * for an appearance. All code that sends Gaussians reads them through this file, so all formats and
 * pictures agree. Any appearance can be made from a tile at any time.
 *
 * The default appearance is one embedding. Its colours are nearest to the mean of the colours in
 * all training photographs, in the mean square over a sample of Gaussians. Every photograph counts
 * the same. The mean of the embeddings is only the start of the search, because the network is not
 * linear.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/splat/appearance.h"
#include "core/splat/gauss.h"
#include "lod/store/bake.h"
#include "lod/store/key.h"
#include "lod/store/store_db.h"
#include "lod/store/tree.h"

enum {
    BAKE_SAMPLE = 2048, /* Gaussians the default appearance is fitted to */
    BAKE_PHOTOS = 512,  /* photographs, evenly taken */
    BAKE_STEPS = 300,
    BAKE_BLEND_MAX = 16,
};
#define BAKE_LR 0.02
#define BAKE_LR_FALL 0.02 /* of it is left at the end */

struct bake_name {
    const char *name; /* of the model */
    uint32_t row;
};
struct bake {
    struct appearance model;
    size_t default_row;
    struct bake_name *names; /* [n_images], sorted: servers look for several in each request */
};

/* ---- of a store ---- */

static void bake_free(struct bake *b)
{
    if (!b)
        return;
    appearance_free(&b->model);
    mem_free(b->names);
    mem_free(b);
}

static int bake_name_compare(const void *pa, const void *pb)
{
    const struct bake_name *a = pa, *b = pb;
    int order = strncmp(a->name, b->name, APPEARANCE_NAME_MAX);
    return order ? order : a->row < b->row ? -1 : a->row > b->row;
}

/* Row of a photograph, the first where several have the name; -1. */
static ptrdiff_t bake_row(const struct bake *b, const char *name)
{
    size_t lo = 0, hi = b->model.n_images;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (strncmp(b->names[mid].name, name, APPEARANCE_NAME_MAX) < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    bool is = lo < b->model.n_images && !strncmp(b->names[lo].name, name, APPEARANCE_NAME_MAX);
    return is ? (ptrdiff_t)b->names[lo].row : -1;
}

static void bake_close(struct store *s)
{
    bake_free(s->bake);
    s->bake = NULL;
    s->bake_known = false;
}

static enum err_code bake_parse(const struct buf *blob, struct bake **out, struct err *e)
{
    struct bake *b = mem_array(1, sizeof *b);
    if (!b)
        return err_set(e, ERR_MEM, "appearance: out of memory");
    enum err_code rc = appearance_read(blob->data, blob->size, &b->model, e);
    size_t n = rc ? 0 : b->model.n_images;
    b->names = mem_array(n, sizeof *b->names);
    if (!rc && !b->names)
        rc = err_set(e, ERR_MEM, "appearance: out of memory for %zu names", n);
    for (size_t i = 0; !rc && i < n; i++)
        b->names[i] = (struct bake_name){b->model.names[i], (uint32_t)i};
    if (!rc)
        qsort(b->names, n, sizeof *b->names, bake_name_compare);
    ptrdiff_t row = rc ? -1 : bake_row(b, BAKE_DEFAULT);
    if (!rc && row < 0)
        rc = err_set(e, ERR_FORMAT, "the appearance model has no row \"" BAKE_DEFAULT "\"");
    if (rc) {
        bake_free(b);
        return rc;
    }
    b->default_row = (size_t)row;
    *out = b;
    return ERR_OK;
}

enum err_code bake_of(struct store *s, const struct appearance **out, struct err *e)
{
    *out = s->bake ? &s->bake->model : NULL;
    if (s->bake_known)
        return ERR_OK; /* nothing is written: threads may be here at once */
    if (s->meta.embed_len > 0) {
        struct buf blob = {0};
        struct err none = {0};
        enum err_code rc = store_get_blob(s, BAKE_BLOB, &blob, &none);
        if (!rc)
            rc = bake_parse(&blob, &s->bake, e) ? err_add(e, "%s", s->path) : ERR_OK;
        else if (rc != ERR_NOENT)
            rc = err_set(e, none.code, "%s", none.msg);
        else
            rc = ERR_OK; /* embeddings of another program: nothing says what they mean */
        buf_free(&blob);
        if (rc)
            return rc;
    }
    s->bake_known = true;
    s->bake_free = bake_close;
    *out = s->bake ? &s->bake->model : NULL;
    return ERR_OK;
}

/* What differs between two models of Gaussians that are to be read by one; NULL: nothing. */
static const char *bake_difference(const struct appearance *a, const struct appearance *b)
{
    if (a->len_gauss != b->len_gauss || a->len_image != b->len_image || a->hidden != b->hidden)
        return "its sizes differ";
    if (memcmp(a->w1, b->w1, appearance_weights(a) * sizeof *a->w1) != 0)
        return "its network has other weights";
    for (size_t i = 0; i < a->n_images; i++) {
        ptrdiff_t at = strcmp(a->names[i], BAKE_DEFAULT) ? appearance_find(b, a->names[i]) : -1;
        size_t len = a->len_image;
        if (at >= 0 &&
            memcmp(a->images + i * len, b->images + (size_t)at * len, len * sizeof *a->images) != 0)
            return "a photograph has another embedding";
    }
    return NULL;
}

enum err_code bake_fits(struct store *s, const struct appearance *a, struct err *e)
{
    const struct appearance *own;
    enum err_code rc = bake_of(s, &own, e);
    if (rc)
        return rc;
    const char *what = !own && !a ? NULL
                       : !own     ? "the store has none"
                       : !a       ? "there is none, the store has one"
                                  : bake_difference(own, a);
    return what ? err_set(e, ERR_DATA, "%s: the appearance model is not the store's: %s", s->path,
                          what)
                : ERR_OK;
}

enum err_code bake_join(struct store *s, const struct appearance *a, struct buf *out, struct err *e)
{
    const struct appearance *own;
    struct appearance all = {0};
    size_t more = 0, at = 0;
    enum err_code rc = bake_fits(s, a, e);
    if (!rc)
        rc = bake_of(s, &own, e);
    if (rc || !own)
        return rc;
    for (size_t i = 0; i < a->n_images; i++)
        more += strcmp(a->names[i], BAKE_DEFAULT) != 0 && appearance_find(own, a->names[i]) < 0;
    if (!more) /* byte by byte: nothing made with it is outdated */
        return store_get_blob(s, BAKE_BLOB, out, e);
    rc = appearance_alloc(&all, own->len_gauss, own->len_image, own->hidden, own->n_images + more,
                          e);
    if (rc)
        return rc;
    size_t len = own->len_image;
    memcpy(all.w1, own->w1, appearance_weights(own) * sizeof(float));
    for (size_t i = 0; i < own->n_images + a->n_images; i++) {
        const struct appearance *from = i < own->n_images ? own : a;
        size_t row = i < own->n_images ? i : i - own->n_images;
        bool is_default = !strcmp(from->names[row], BAKE_DEFAULT);
        if (is_default || (from == a && appearance_find(own, from->names[row]) >= 0))
            continue;
        memcpy(all.images + at * len, from->images + row * len, len * sizeof(float));
        memcpy(all.names[at++], from->names[row], sizeof *all.names);
    }
    memcpy(all.images + at * len, own->images + s->bake->default_row * len, len * sizeof(float));
    memcpy(all.names[at], BAKE_DEFAULT, sizeof(BAKE_DEFAULT));
    rc = appearance_write(&all, out, e);
    appearance_free(&all);
    return rc;
}

enum err_code bake_hash(struct store *s, struct hash128 *out, struct err *e)
{
    struct buf blob = {0};
    *out = (struct hash128){0};
    enum err_code rc = store_get_blob(s, BAKE_BLOB, &blob, e);
    if (!rc)
        *out = hash_bytes(blob.data, blob.size);
    buf_free(&blob);
    return rc == ERR_NOENT ? ERR_OK : rc;
}

static enum err_code bake_apply(struct store *s, const float *image, struct gauss *g, struct err *e)
{
    const struct appearance *a;
    enum err_code rc = bake_of(s, &a, e);
    if (rc || !a)
        return rc;
    if (!image)
        image = a->images + s->bake->default_row * a->len_image;
    rc = appearance_bake(a, image, g, e);
    return rc ? err_add(e, "%s", s->path) : ERR_OK;
}

enum err_code bake_read(struct store *s, struct key k, const float *image, struct gauss *out,
                        struct err *e)
{
    enum err_code rc = store_read_gauss(s, k, out, e);
    if (!rc)
        rc = bake_apply(s, image, out, e);
    if (rc)
        gauss_free(out);
    return rc;
}

/* ---- by name ---- */

/* One "NAME" or "NAME:WEIGHT" of n bytes. */
static enum err_code bake_find_one(const struct bake *b, const char *text, size_t n, uint32_t *row,
                                   double *weight, struct err *e)
{
    const struct appearance *a = &b->model;
    char name[APPEARANCE_NAME_MAX + 32];
    if (n >= sizeof name)
        return err_set(e, ERR_NOENT, "no photograph has a name of %zu bytes", n);
    memcpy(name, text, n);
    name[n] = '\0';
    ptrdiff_t at = bake_row(b, name);
    char *colon = strrchr(name, ':');
    *weight = 1.0;
    if (at < 0 && colon) {
        if (!number_list(colon + 1, 1, weight))
            return err_set(e, ERR_ARG, "'%s': a number is expected after the last ':'", name);
        *colon = '\0';
        at = bake_row(b, name);
    }
    if (at < 0)
        return err_set(
            e, ERR_NOENT,
            "no photograph is called '%s'; there are %zu, the first '%s', and '" BAKE_DEFAULT "'",
            name, a->n_images - 1, a->names[0]);
    *row = (uint32_t)at;
    return ERR_OK;
}

void bake_text(const float *image, uint32_t len_image, char out[BAKE_TEXT_MAX])
{
    out[0] = '=';
    base64_write(image, len_image * sizeof *image, BASE64_URL, out + 1);
}

/* What bake_text wrote; `text` begins behind the "=". */
static enum err_code bake_untext(const char *text, uint32_t len_image, float *image, struct err *e)
{
    uint8_t bytes[4 * APPEARANCE_IMAGE_MAX];
    const uint32_t want = 4 * len_image;
    bool good = base64_read(text, bytes, want);
    for (uint32_t i = 0; good && i < len_image; i++) {
        const uint8_t *b = bytes + 4 * (size_t)i;
        uint32_t word = b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
        memcpy(&image[i], &word, sizeof word);
        good = isfinite(image[i]);
    }
    return good ? ERR_OK
                : err_set(e, ERR_ARG,
                          "an embedding is '=' and %u float32 values in base64url, %u characters",
                          len_image, (4 * want + 2) / 3);
}

enum err_code bake_find(struct store *s, const char *text, float *image, struct err *e)
{
    const struct appearance *a;
    uint32_t row[BAKE_BLEND_MAX];
    double weight[BAKE_BLEND_MAX], sum = 0.0;
    size_t n = 0;
    enum err_code rc = bake_of(s, &a, e);
    if (!rc && !a)
        rc = err_set(e, ERR_NOENT, "%s: was trained without appearance: it has one appearance only",
                     s->path);
    if (!rc && *text == '=')
        return bake_untext(text + 1, a->len_image, image, e);
    for (const char *p = text; !rc && *p;) {
        size_t len = strcspn(p, ",");
        if (n == BAKE_BLEND_MAX)
            return err_set(e, ERR_ARG, "a blend of more than %d appearances", BAKE_BLEND_MAX);
        rc = bake_find_one(s->bake, p, len, &row[n], &weight[n], e);
        sum += rc ? 0.0 : weight[n++];
        p += len + (p[len] == ',');
    }
    if (rc)
        return rc;
    if (!n || !(sum > 0.0))
        return err_set(e, ERR_ARG,
                       "'%s': the name of a photograph is expected, or "
                       "NAME:WEIGHT,NAME:WEIGHT with weights that add up to more than 0, or "
                       "=BASE64 of an embedding",
                       text);
    float unit[APPEARANCE_IMAGE_MAX];
    memset(image, 0, a->len_image * sizeof(float));
    for (size_t i = 0; i < n; i++) { /* of unit vectors: their lengths mean nothing */
        bake_unit(a, row[i], unit);
        for (uint32_t j = 0; j < a->len_image; j++)
            image[j] += (float)(weight[i] / sum * (double)unit[j]);
    }
    return ERR_OK;
}

void bake_unit(const struct appearance *a, size_t row, float *out)
{
    const float *v = a->images + row * a->len_image;
    double sum = 0.0;
    for (uint32_t j = 0; j < a->len_image; j++)
        sum += (double)v[j] * (double)v[j];
    double len = fmax(sqrt(sum), 1e-12);
    for (uint32_t j = 0; j < a->len_image; j++)
        out[j] = (float)((double)v[j] / len);
}

/* ---- the default appearance ---- */

struct bake_fit {
    const struct appearance *a;
    size_t n;     /* Gaussians of the sample */
    float *embed; /* [n][len_gauss] */
    double *want; /* [n][3] mean colour offsets */
    float *grad, *image_grad;
};

/* Hidden layer and outputs of one Gaussian in a frame. */
static void bake_forward(const struct appearance *a, const float *frame, const float *embed,
                         double *hidden, double y[APPEARANCE_OUT])
{
    const float *bias = frame + (size_t)a->hidden * a->len_gauss, *w2 = bias + a->hidden,
                *b2 = w2 + (size_t)APPEARANCE_OUT * a->hidden;
    double norm = 0.0;
    for (uint32_t c = 0; c < a->len_gauss; c++)
        norm += (double)embed[c] * (double)embed[c];
    norm = fmax(sqrt(norm), 1e-12);
    for (int o = 0; o < APPEARANCE_OUT; o++)
        y[o] = (double)b2[o];
    for (uint32_t h = 0; h < a->hidden; h++) {
        double u = 0.0;
        for (uint32_t c = 0; c < a->len_gauss; c++)
            u += (double)frame[h * a->len_gauss + c] * (double)embed[c];
        hidden[h] = fmax(0.0, u / norm + (double)bias[h]);
        for (uint32_t o = 0; o < APPEARANCE_OUT; o++)
            y[o] += (double)w2[o * a->hidden + h] * hidden[h];
    }
    for (int o = 0; o < APPEARANCE_OUT; o++)
        y[o] = 1.0 / (1.0 + exp(-y[o]));
}

/* Gradient of 1/2 mean |y - want|^2 with respect to the bias of the frame, the only thing in it
 * that depends on the photograph. Returns the error. */
static double bake_slope(const struct bake_fit *f, const float *frame)
{
    const struct appearance *a = f->a;
    const float *w2 = frame + (size_t)a->hidden * a->len_gauss + a->hidden;
    float *bias = f->grad + (size_t)a->hidden * a->len_gauss;
    double hidden[APPEARANCE_HIDDEN_MAX], y[APPEARANCE_OUT], sum[APPEARANCE_HIDDEN_MAX] = {0.0};
    double error = 0.0;
    for (size_t i = 0; i < f->n; i++) {
        bake_forward(a, frame, f->embed + i * a->len_gauss, hidden, y);
        for (uint32_t o = 0; o < 3; o++) {
            double d = y[o] - f->want[3 * i + o], z = d * y[o] * (1.0 - y[o]) / (double)f->n;
            error += 0.5 * d * d / (double)f->n;
            for (uint32_t h = 0; h < a->hidden; h++)
                sum[h] += hidden[h] > 0.0 ? z * (double)w2[o * a->hidden + h] : 0.0;
        }
    }
    for (uint32_t h = 0; h < a->hidden; h++)
        bias[h] = (float)sum[h];
    return error;
}

/* Adam from the mean of the photographs; the best embedding met is the answer. */
static void bake_search(struct bake_fit *f, float *frame, float *image)
{
    const struct appearance *a = f->a;
    double m1[APPEARANCE_IMAGE_MAX] = {0.0}, m2[APPEARANCE_IMAGE_MAX] = {0.0}, least = HUGE_VAL;
    float best[APPEARANCE_IMAGE_MAX];
    for (int t = 1; t <= BAKE_STEPS; t++) {
        appearance_frame(a, image, frame);
        double error = bake_slope(f, frame);
        if (error < least) {
            least = error;
            memcpy(best, image, a->len_image * sizeof(float));
        }
        appearance_backward(a, image, f->grad, NULL, f->image_grad);
        double lr = BAKE_LR * pow(BAKE_LR_FALL, (double)t / BAKE_STEPS);
        for (uint32_t j = 0; j < a->len_image; j++) {
            double g = (double)f->image_grad[j];
            m1[j] = 0.9 * m1[j] + 0.1 * g;
            m2[j] = 0.999 * m2[j] + 0.001 * g * g;
            double a1 = m1[j] / (1.0 - pow(0.9, t)), a2 = m2[j] / (1.0 - pow(0.999, t));
            image[j] = (float)((double)image[j] - lr * a1 / (sqrt(a2) + 1e-15));
        }
    }
    memcpy(image, best, a->len_image * sizeof(float));
}

static void bake_targets(struct bake_fit *f, float *frame, float *image)
{
    const struct appearance *a = f->a;
    double hidden[APPEARANCE_HIDDEN_MAX], y[APPEARANCE_OUT];
    size_t n = a->n_images < BAKE_PHOTOS ? a->n_images : BAKE_PHOTOS;
    memset(image, 0, a->len_image * sizeof(float));
    for (size_t p = 0; p < n; p++) {
        size_t row = p * a->n_images / n;
        float unit[APPEARANCE_IMAGE_MAX];
        bake_unit(a, row, unit);
        for (uint32_t j = 0; j < a->len_image; j++)
            image[j] += unit[j] / (float)n;
        appearance_frame(a, unit, frame);
        for (size_t i = 0; i < f->n; i++) {
            bake_forward(a, frame, f->embed + i * a->len_gauss, hidden, y);
            for (size_t o = 0; o < 3; o++)
                f->want[3 * i + o] += y[o] / (double)n;
        }
    }
}

enum err_code bake_read_cut(struct store *s, uint8_t zoom, const float *image, struct progress *bar,
                            struct gauss *out, struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    const struct store_meta *m = store_info(s);
    enum err_code rc = gauss_alloc(out, 0, m->sh_degree, m->embed_len, e);
    out->antialiased = m->antialiased;
    for (size_t i = 0; !rc && i < n; i++) {
        struct gauss g;
        if (bar)
            progress_step(bar, i + 1, NULL);
        if (t[i].key.z != zoom && !(tree_leaf(store_tree(s), i) && t[i].key.z < zoom))
            continue;
        rc = bake_read(s, t[i].key, image, &g, e);
        if (!rc)
            rc = gauss_append(out, &g, NULL, g.n, e);
        gauss_free(&g);
    }
    return rc;
}

enum err_code bake_default(const struct appearance *a, const struct gauss *g, float *image,
                           struct err *e)
{
    struct bake_fit f = {.a = a, .n = g->n < BAKE_SAMPLE ? g->n : BAKE_SAMPLE};
    size_t floats = appearance_frame_floats(a->len_gauss, a->hidden);
    float *frame = mem_array(floats, sizeof(float));
    if (g->embed_len != a->len_gauss || !a->n_images || !g->n) {
        mem_free(frame);
        return err_set(
            e, ERR_DATA,
            "default appearance: %zu photographs, %zu Gaussians with embeddings of %u values, "
            "the network takes %u",
            a->n_images, g->n, g->embed_len, a->len_gauss);
    }
    f.embed = mem_array(f.n * a->len_gauss, sizeof(float));
    f.want = mem_array(3 * f.n, sizeof(double));
    f.grad = mem_array(floats, sizeof(float));
    f.image_grad = mem_array(a->len_image, sizeof(float));
    enum err_code rc = frame && f.embed && f.want && f.grad && f.image_grad
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "default appearance: out of memory");
    for (size_t i = 0; !rc && i < f.n; i++)
        memcpy(f.embed + i * a->len_gauss, g->embed + i * g->n / f.n * a->len_gauss,
               a->len_gauss * sizeof(float));
    if (!rc) {
        bake_targets(&f, frame, image);
        bake_search(&f, frame, image);
    }
    mem_free(frame);
    mem_free(f.embed);
    mem_free(f.want);
    mem_free(f.grad);
    mem_free(f.image_grad);
    return rc;
}

enum err_code bake_with_default(const struct appearance *a, const struct gauss *g,
                                struct appearance *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = (struct appearance){0};
    if (appearance_find(a, BAKE_DEFAULT) >= 0)
        return err_set(e, ERR_DATA, "a photograph is called '" BAKE_DEFAULT "': rename it");
    rc = appearance_alloc(out, a->len_gauss, a->len_image, a->hidden, a->n_images + 1, e);
    if (rc)
        return rc;
    memcpy(out->w1, a->w1, appearance_weights(a) * sizeof(float));
    memcpy(out->images, a->images, a->n_images * a->len_image * sizeof(float));
    memcpy(out->names, a->names, a->n_images * sizeof *a->names);
    memcpy(out->names[a->n_images], BAKE_DEFAULT, sizeof(BAKE_DEFAULT));
    rc = bake_default(a, g, out->images + a->n_images * a->len_image, e);
    if (rc)
        appearance_free(out);
    return rc;
}
