/* The appearance network on the host: memory, reference in double, gradients, baking, file bytes.
 *
 * One block holds weights, photographs and names. The photograph's half of the first layer becomes
 * part of a frame's bias, so the work for each Gaussian is len_gauss -> hidden -> 4. In the
 * backward pass the gradients of the photograph's half of W1 and of its embedding follow from the
 * gradient of that bias. Source: Robust and Efficient 3D Gaussian Splatting for Urban Scene
 * Reconstruction (ICCV 2025). Start values are uniform in +-1/sqrt(fan in), except for the opacity
 * output, which starts near 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/appearance.h"

#include <math.h>
#include <string.h>

#include "core/pool.h"

enum { IMAGES_MAX = 1 << 22, BLOB_VERSION = 1, BAKE_CHUNK = 4096 };
enum { STREAM_W1 = 7001, STREAM_B1, STREAM_W2, STREAM_IMAGE }; /* of appearance_init */
static const char blob_magic[4] = {'C', 'S', 'A', 'P'};
static const double length_min = 1e-12, opacity_bias = -5;

/* ---- memory ---- */

static size_t appearance_weights_count(uint32_t len_gauss, uint32_t len_image, uint32_t hidden)
{
    return (size_t)hidden * (len_gauss + len_image) + hidden + (size_t)APPEARANCE_OUT * hidden +
           APPEARANCE_OUT;
}

enum err_code appearance_alloc(struct appearance *a, uint32_t len_gauss, uint32_t len_image,
                               uint32_t hidden, size_t n_images, struct err *e)
{
    memset(a, 0, sizeof *a);
    if (len_gauss < 1 || len_gauss > GAUSS_EMBED_MAX || len_image < 1 ||
        len_image > APPEARANCE_IMAGE_MAX || hidden < 1 || hidden > APPEARANCE_HIDDEN_MAX ||
        n_images > IMAGES_MAX)
        return err_set(e, ERR_LIMIT,
                       "appearance: embeddings of %u and %u, %u hidden units, %zu photographs: at "
                       "least 1 and at most %d, %d, %d and %d",
                       len_gauss, len_image, hidden, n_images, GAUSS_EMBED_MAX,
                       APPEARANCE_IMAGE_MAX, APPEARANCE_HIDDEN_MAX, IMAGES_MAX);
    size_t weights = appearance_weights_count(len_gauss, len_image, hidden),
           images = n_images * len_image;
    float *block = mem_array(weights + images + n_images * (APPEARANCE_NAME_MAX / sizeof(float)),
                             sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "appearance: %zu photographs: out of memory", n_images);
    a->len_gauss = len_gauss;
    a->len_image = len_image;
    a->hidden = hidden;
    a->n_images = n_images;
    a->w1 = block;
    a->b1 = a->w1 + (size_t)hidden * (len_gauss + len_image);
    a->w2 = a->b1 + hidden;
    a->b2 = a->w2 + (size_t)APPEARANCE_OUT * hidden;
    a->images = block + weights;
    a->names = (char(*)[APPEARANCE_NAME_MAX])(void *)(a->images + images);
    a->block = block;
    return ERR_OK;
}

void appearance_free(struct appearance *a)
{
    mem_free(a->block);
    memset(a, 0, sizeof *a);
}

size_t appearance_weights(const struct appearance *a)
{
    return appearance_weights_count(a->len_gauss, a->len_image, a->hidden);
}

static void appearance_fill_uniform(float *out, size_t n, double limit, uint64_t seed,
                                    uint64_t stream)
{
    for (size_t i = 0; i < n; i++)
        out[i] = (float)(limit * (2 * rng_unit(seed, stream, i) - 1));
}

void appearance_init(struct appearance *a, uint64_t seed)
{
    size_t in = a->len_gauss + a->len_image, hidden = a->hidden;
    appearance_fill_uniform(a->w1, hidden * in, 1 / sqrt((double)in), seed, STREAM_W1);
    appearance_fill_uniform(a->b1, hidden, 1 / sqrt((double)in), seed, STREAM_B1);
    appearance_fill_uniform(a->w2, APPEARANCE_OUT * hidden, 1 / sqrt((double)hidden), seed,
                            STREAM_W2);
    for (size_t o = 0; o < APPEARANCE_OUT; o++)
        a->b2[o] = o == 3 ? (float)opacity_bias : 0.0f;
    for (size_t i = 0; i < a->n_images * a->len_image; i++)
        a->images[i] = (float)rng_normal(seed, STREAM_IMAGE, i);
}

ptrdiff_t appearance_find(const struct appearance *a, const char *name)
{
    for (size_t i = 0; i < a->n_images; i++)
        if (!strncmp(a->names[i], name, APPEARANCE_NAME_MAX))
            return (ptrdiff_t)i;
    return -1;
}

/* ---- the network ---- */

/* out = v / max(|v|, 1e-12); returns the divisor. */
static double appearance_normalise(const float *v, size_t n, double *out)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += (double)v[i] * (double)v[i];
    double len = fmax(sqrt(sum), length_min);
    for (size_t i = 0; i < n; i++)
        out[i] = (double)v[i] / len;
    return len;
}

size_t appearance_frame_floats(uint32_t len_gauss, uint32_t hidden)
{
    return appearance_weights_count(len_gauss, 0, hidden);
}

void appearance_frame(const struct appearance *a, const float *image, float *out)
{
    double p[APPEARANCE_IMAGE_MAX];
    size_t lg = a->len_gauss, li = a->len_image, in = lg + li, hidden = a->hidden;
    float *bias = out + hidden * lg;
    (void)appearance_normalise(image, li, p);
    for (size_t h = 0; h < hidden; h++) {
        double b = (double)a->b1[h];
        memcpy(out + h * lg, a->w1 + h * in, lg * sizeof *out);
        for (size_t j = 0; j < li; j++)
            b += (double)a->w1[h * in + lg + j] * p[j];
        bias[h] = (float)b;
    }
    memcpy(bias + hidden, a->w2, APPEARANCE_OUT * hidden * sizeof *out);
    memcpy(bias + hidden + APPEARANCE_OUT * hidden, a->b2, APPEARANCE_OUT * sizeof *out);
}

void appearance_eval(const struct appearance *a, const float *embed, const float *image,
                     double y[APPEARANCE_OUT])
{
    double x[GAUSS_EMBED_MAX + APPEARANCE_IMAGE_MAX], z[APPEARANCE_OUT];
    size_t in = a->len_gauss + a->len_image, hidden = a->hidden;
    (void)appearance_normalise(embed, a->len_gauss, x);
    (void)appearance_normalise(image, a->len_image, x + a->len_gauss);
    for (size_t o = 0; o < APPEARANCE_OUT; o++)
        z[o] = (double)a->b2[o];
    for (size_t h = 0; h < hidden; h++) {
        double sum = (double)a->b1[h];
        for (size_t j = 0; j < in; j++)
            sum += (double)a->w1[h * in + j] * x[j];
        for (size_t o = 0; o < APPEARANCE_OUT && sum > 0; o++)
            z[o] += (double)a->w2[o * hidden + h] * sum;
    }
    for (size_t o = 0; o < APPEARANCE_OUT; o++)
        y[o] = 1 / (1 + exp(-z[o]));
}

void appearance_backward(const struct appearance *a, const float *image, const float *frame_grad,
                         float *weights_grad, float *image_grad)
{
    double p[APPEARANCE_IMAGE_MAX], g[APPEARANCE_IMAGE_MAX] = {0}, along = 0;
    size_t lg = a->len_gauss, li = a->len_image, in = lg + li, hidden = a->hidden;
    const float *bias = frame_grad + hidden * lg; /* gradients of b1 + W1 p^ */
    double len = appearance_normalise(image, li, p);
    for (size_t h = 0; h < hidden && weights_grad; h++) {
        memcpy(weights_grad + h * in, frame_grad + h * lg, lg * sizeof *weights_grad);
        for (size_t j = 0; j < li; j++)
            weights_grad[h * in + lg + j] = (float)((double)bias[h] * p[j]);
    }
    if (weights_grad) /* b1, W2, b2 lie in the same order in both */
        memcpy(weights_grad + hidden * in, bias,
               (hidden + APPEARANCE_OUT * hidden + APPEARANCE_OUT) * sizeof *weights_grad);
    if (!image_grad)
        return;
    for (size_t h = 0; h < hidden; h++)
        for (size_t j = 0; j < li; j++)
            g[j] += (double)a->w1[h * in + lg + j] * (double)bias[h];
    /* v^ = v / |v|; below the least length the divisor is a constant. */
    for (size_t j = 0; j < li && len > length_min; j++)
        along += p[j] * g[j];
    for (size_t j = 0; j < li; j++)
        image_grad[j] = (float)((g[j] - p[j] * along) / len);
}

void appearance_blend(const struct appearance *a, const uint32_t *index, const double *weight,
                      size_t n, float *out)
{
    for (size_t j = 0; j < a->len_image; j++) {
        double sum = 0;
        for (size_t i = 0; i < n; i++)
            sum += weight[i] * (double)a->images[(size_t)index[i] * a->len_image + j];
        out[j] = (float)sum;
    }
}

/* ---- baking ---- */

struct bake {
    uint32_t len, hidden;
    struct gauss *g;
    /* of the frame: W1 transposed, so that units are neighbours and compilers use vectors */
    float w1[GAUSS_EMBED_MAX][APPEARANCE_HIDDEN_MAX], b1[APPEARANCE_HIDDEN_MAX];
    float w2[APPEARANCE_OUT][APPEARANCE_HIDDEN_MAX], b2[APPEARANCE_OUT];
};

static void appearance_bake_row(const struct bake *b, size_t i)
{
    struct gauss *g = b->g;
    float unit[APPEARANCE_HIDDEN_MAX], *dc = g->sh + 3 * i * gauss_sh_count(g->sh_degree);
    double x[GAUSS_EMBED_MAX], y[APPEARANCE_OUT];
    (void)appearance_normalise(g->embed + i * b->len, b->len, x);
    memcpy(unit, b->b1, sizeof unit);
    for (size_t k = 0; k < b->len; k++)
        for (size_t h = 0; h < APPEARANCE_HIDDEN_MAX; h++) /* zeros beyond `hidden` */
            unit[h] += b->w1[k][h] * (float)x[k];
    for (size_t o = 0; o < APPEARANCE_OUT; o++) {
        double z = (double)b->b2[o];
        for (size_t h = 0; h < b->hidden; h++)
            z += unit[h] > 0 ? (double)(b->w2[o][h] * unit[h]) : 0;
        y[o] = 1 / (1 + exp(-z));
    }
    for (size_t c = 0; c < 3; c++)
        dc[c] += (float)((2 * y[c] - 1) / GAUSS_SH_C0);
    double opacity = 1 / (1 + exp(-(double)g->opacity_logit[i]));
    opacity = fmin(opacity + y[3], 1 - 1e-6);
    g->opacity_logit[i] = (float)log(opacity / (1 - opacity));
}

static enum err_code appearance_bake_chunk(void *user, size_t chunk, struct err *e)
{
    const struct bake *b = user;
    size_t end = (chunk + 1) * BAKE_CHUNK < b->g->n ? (chunk + 1) * BAKE_CHUNK : b->g->n;
    (void)e;
    for (size_t i = chunk * BAKE_CHUNK; i < end; i++)
        appearance_bake_row(b, i);
    return ERR_OK;
}

enum err_code appearance_bake(const struct appearance *a, const float *image, struct gauss *g,
                              struct err *e)
{
    size_t lg = a->len_gauss, hidden = a->hidden;
    if (g->embed_len != a->len_gauss)
        return err_set(e, ERR_DATA,
                       "appearance: Gaussians carry embeddings of %u values, the network takes %u",
                       g->embed_len, a->len_gauss);
    float *frame = mem_array(appearance_frame_floats(a->len_gauss, a->hidden), sizeof *frame);
    struct bake *b = mem_array(1, sizeof *b);
    enum err_code rc = ERR_OK;
    if (!frame || !b) {
        rc = err_set(e, ERR_MEM, "appearance: out of memory");
        goto out;
    }
    appearance_frame(a, image, frame);
    b->len = a->len_gauss;
    b->hidden = a->hidden;
    b->g = g;
    for (size_t h = 0; h < hidden; h++) {
        for (size_t k = 0; k < lg; k++)
            b->w1[k][h] = frame[h * lg + k];
        b->b1[h] = frame[hidden * lg + h];
        for (size_t o = 0; o < APPEARANCE_OUT; o++)
            b->w2[o][h] = frame[hidden * (lg + 1 + o) + h];
    }
    memcpy(b->b2, frame + hidden * (lg + 1 + APPEARANCE_OUT), sizeof b->b2);
    rc = pool_for((g->n + BAKE_CHUNK - 1) / BAKE_CHUNK, 0, appearance_bake_chunk, b, e);
out:
    mem_free(frame);
    mem_free(b);
    return rc;
}

/* ---- bytes ---- */

/*
 *   0  "CSAP"   4  u32 version   8  u32 len_gauss   12  u32 len_image   16  u32 hidden
 *  20  u32 photographs   24  f32 weights (w1, b1, w2, b2)   ..  f32 photographs
 *  ..  names: u8 length and bytes each   ..  XXH3-128 of all before, low half first
 */

enum { BLOB_HEAD = 24, BLOB_HASH = 16 };

enum err_code appearance_write(const struct appearance *a, struct buf *out, struct err *e)
{
    size_t start = out->size, values = appearance_weights(a) + a->n_images * a->len_image;
    const uint32_t head[5] = {BLOB_VERSION, a->len_gauss, a->len_image, a->hidden,
                              (uint32_t)a->n_images};
    buf_add(out, blob_magic, sizeof blob_magic);
    for (size_t i = 0; i < 5; i++)
        buf_u32(out, head[i]);
    for (size_t i = 0; i < values; i++) /* photographs follow the weights in memory too */
        buf_f32(out, a->w1[i]);
    for (size_t i = 0; i < a->n_images; i++) {
        size_t n = strnlen(a->names[i], APPEARANCE_NAME_MAX - 1);
        buf_u8(out, (unsigned)n);
        buf_add(out, a->names[i], n);
    }
    if (!out->failed) {
        struct hash128 h = hash_bytes(out->data + start, out->size - start);
        buf_u64(out, h.lo);
        buf_u64(out, h.hi);
    }
    return buf_check(out, e);
}

static enum err_code appearance_blob_body(struct cursor *c, struct appearance *a, struct err *e)
{
    size_t values = appearance_weights(a) + a->n_images * a->len_image;
    for (size_t i = 0; i < values; i++) {
        a->w1[i] = cursor_f32(c);
        if (!isfinite(a->w1[i]))
            return err_set(e, ERR_FORMAT, "appearance: value %zu is not a finite number", i);
    }
    for (size_t i = 0; i < a->n_images; i++) {
        size_t n = cursor_u8(c);
        const uint8_t *name = n < APPEARANCE_NAME_MAX ? cursor_take(c, n) : NULL;
        if (!name || memchr(name, 0, n))
            return err_set(e, ERR_FORMAT, "appearance: name of photograph %zu is broken", i);
        memcpy(a->names[i], name, n);
    }
    if (c->bad || cursor_left(c) != 0)
        return err_set(e, ERR_FORMAT, "appearance: %zu bytes too many", cursor_left(c));
    return ERR_OK;
}

enum err_code appearance_read(const void *bytes, size_t n, struct appearance *out, struct err *e)
{
    memset(out, 0, sizeof *out);
    if (n < BLOB_HEAD + BLOB_HASH || memcmp(bytes, blob_magic, sizeof blob_magic) != 0)
        return err_set(e, ERR_FORMAT, "appearance: %zu bytes that are no appearance model", n);
    struct cursor c = cursor_over(bytes, n - BLOB_HASH),
                  tail = cursor_over((const uint8_t *)bytes + n - BLOB_HASH, BLOB_HASH);
    uint32_t head[5];
    (void)cursor_take(&c, sizeof blob_magic);
    for (size_t i = 0; i < 5; i++)
        head[i] = cursor_u32(&c);
    if (head[0] != BLOB_VERSION)
        return err_set(e, ERR_FORMAT, "appearance: version %u, this program reads %d", head[0],
                       BLOB_VERSION);
    struct hash128 h = hash_bytes(bytes, n - BLOB_HASH);
    uint64_t lo = cursor_u64(&tail), hi = cursor_u64(&tail);
    if (h.lo != lo || h.hi != hi)
        return err_set(e, ERR_FORMAT, "appearance: damaged: the checksum does not fit");
    /* Every photograph takes its embedding and a length: no more room than the bytes can fill. */
    if (head[4] > cursor_left(&c) / (1 + (size_t)4 * (head[2] ? head[2] : 1)))
        return err_set(e, ERR_FORMAT, "appearance: %u photographs in %zu bytes", head[4], n);
    enum err_code rc = appearance_alloc(out, head[1], head[2], head[3], head[4], e);
    if (!rc && appearance_weights(out) > cursor_left(&c) / 4)
        rc = err_set(e, ERR_FORMAT, "appearance: cut off after %zu bytes", n);
    if (!rc)
        rc = appearance_blob_body(&c, out, e);
    if (rc)
        appearance_free(out);
    return rc;
}
