/* LPIPS on the device: see lpips.h. Both pictures go through the network together, so features of a
 * layer are kept only until they are compared.
 *
 * Names of weights are those of the authors' program: net.slice<S>.<N>.weight with N the number of
 * the layer in torchvision's `features`, and lin<K>.model.1.weight. features.<N>.weight and
 * lin<K>.weight are accepted too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/lpips.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "lab/eval/tensors.h"

extern const char lpips_cl[];

enum {
    LPIPS_TAPS = 5,
    LPIPS_LAYERS_MAX = 13,
    LPIPS_CHANNELS_MAX = 4096,
};

/* of version 0.1: (x - shift) / scale for x in -1..1 */
static const double lpips_shift[3] = {-0.030, -0.088, -0.188};
static const double lpips_scale[3] = {0.458, 0.448, 0.450};

struct lpips_plan { /* a convolution with its relu, and what comes before and after */
    int index, slice, k, stride, pad;
    int pool_k; /* maximum over pool_k x pool_k before it, stride 2; 0: none */
    bool tap;   /* features to compare come after it */
};

static const struct lpips_plan lpips_vgg[] = {
    {0, 1, 3, 1, 1, 0, false}, {2, 1, 3, 1, 1, 0, true},   {5, 2, 3, 1, 1, 2, false},
    {7, 2, 3, 1, 1, 0, true},  {10, 3, 3, 1, 1, 2, false}, {12, 3, 3, 1, 1, 0, false},
    {14, 3, 3, 1, 1, 0, true}, {17, 4, 3, 1, 1, 2, false}, {19, 4, 3, 1, 1, 0, false},
    {21, 4, 3, 1, 1, 0, true}, {24, 5, 3, 1, 1, 2, false}, {26, 5, 3, 1, 1, 0, false},
    {28, 5, 3, 1, 1, 0, true},
};
static const struct lpips_plan lpips_alex[] = {
    {0, 1, 11, 4, 2, 0, true}, {3, 2, 5, 1, 2, 3, true},  {6, 3, 3, 1, 1, 3, true},
    {8, 4, 3, 1, 1, 0, true},  {10, 5, 3, 1, 1, 0, true},
};

struct lpips_layer {
    struct lpips_plan plan;
    int cin, cout;
    cl_mem weights, bias, lin; /* lin: of a tap */
};

struct lpips_map { /* features of one picture */
    cl_mem mem;
    size_t bytes;
};

struct lpips {
    struct dev *dev;
    bool is_vgg;
    enum lpips_range range;
    struct lpips_layer layer[LPIPS_LAYERS_MAX];
    size_t n_layers;
    cl_program program;
    cl_kernel conv, conv_stride, pool, distance;
    struct lpips_map map[2][2]; /* [picture][in, out] */
    struct lpips_map distances;
    float *host;
    size_t host_floats;
};

/* ---- weights ---- */

static const struct tensor *lpips_find(const struct tensors *t, const struct lpips_plan *p,
                                       const char *what)
{
    char name[64];
    snprintf(name, sizeof name, "net.slice%d.%d.%s", p->slice, p->index, what);
    const struct tensor *found = tensors_find(t, name);
    snprintf(name, sizeof name, "features.%d.%s", p->index, what);
    return found ? found : tensors_find(t, name);
}

static const struct tensor *lpips_find_lin(const struct tensors *t, int tap)
{
    char name[64];
    snprintf(name, sizeof name, "lin%d.model.1.weight", tap);
    const struct tensor *found = tensors_find(t, name);
    snprintf(name, sizeof name, "lin%d.weight", tap);
    return found ? found : tensors_find(t, name);
}

/* [cout][cin][k][k] -> [groups][cin][k][k][8], and the bias padded likewise. */
static enum err_code lpips_pack(struct lpips *l, struct lpips_layer *y, const float *weights,
                                const float *bias, struct err *e)
{
    size_t taps = (size_t)y->cin * (size_t)(y->plan.k * y->plan.k), cout = (size_t)y->cout;
    size_t groups = (cout + LAYOUT_LPIPS_CHANNELS - 1) / LAYOUT_LPIPS_CHANNELS,
           n = groups * taps * LAYOUT_LPIPS_CHANNELS;
    float *packed = mem_array(n, sizeof *packed),
          *b = mem_array(groups * LAYOUT_LPIPS_CHANNELS, sizeof *b);
    enum err_code rc = packed && b ? ERR_OK : err_set(e, ERR_MEM, "lpips: out of memory");
    for (size_t o = 0; !rc && o < cout; o++) {
        for (size_t i = 0; i < taps; i++)
            packed[(o / LAYOUT_LPIPS_CHANNELS * taps + i) * LAYOUT_LPIPS_CHANNELS +
                   o % LAYOUT_LPIPS_CHANNELS] = weights[o * taps + i];
        b[o] = bias[o];
    }
    if (!rc)
        rc = dev_buffer(l->dev, n * sizeof *packed, packed, &y->weights, e);
    if (!rc)
        rc = dev_buffer(l->dev, groups * LAYOUT_LPIPS_CHANNELS * sizeof *b, b, &y->bias, e);
    mem_free(packed);
    mem_free(b);
    return rc;
}

static enum err_code lpips_load_layer(struct lpips *l, const struct tensors *t,
                                      const struct lpips_plan *plan, int cin, int tap,
                                      struct err *e)
{
    struct lpips_layer *y = &l->layer[l->n_layers];
    const struct tensor *w = lpips_find(t, plan, "weight"), *b = lpips_find(t, plan, "bias");
    if (!w || !b)
        return err_set(e, ERR_FORMAT, "no weights net.slice%d.%d.weight and .bias", plan->slice,
                       plan->index);
    size_t k = (size_t)plan->k;
    if (w->ndim != 4 || w->shape[0] < 1 || w->shape[0] > LPIPS_CHANNELS_MAX ||
        w->shape[1] != (size_t)cin || w->shape[2] != k || w->shape[3] != k ||
        b->count != w->shape[0])
        return err_set(e, ERR_FORMAT, "%s: expected shape [channels, %d, %d, %d] with a bias each",
                       w->name, cin, plan->k, plan->k);
    y->plan = *plan;
    y->cin = cin;
    y->cout = (int)w->shape[0];
    l->n_layers++;
    enum err_code rc = lpips_pack(l, y, w->data, b->data, e);
    if (rc || !plan->tap)
        return rc;
    const struct tensor *lin = lpips_find_lin(t, tap);
    if (!lin || lin->count != w->shape[0])
        return err_set(e, ERR_FORMAT, "no lin%d.model.1.weight with %d numbers", tap, y->cout);
    return dev_buffer(l->dev, lin->count * sizeof(float), lin->data, &y->lin, e);
}

static enum err_code lpips_load(struct lpips *l, const struct tensors *t, struct err *e)
{
    const struct tensor *first = lpips_find(t, &lpips_vgg[0], "weight");
    enum err_code rc = ERR_OK;
    int cin = 3, tap = 0;
    if (!first || first->ndim != 4)
        return err_set(e, ERR_FORMAT, "no net.slice1.0.weight: not weights of LPIPS");
    l->is_vgg = first->shape[2] == 3;
    const struct lpips_plan *plan = l->is_vgg ? lpips_vgg : lpips_alex;
    size_t n =
        l->is_vgg ? sizeof lpips_vgg / sizeof *lpips_vgg : sizeof lpips_alex / sizeof *lpips_alex;
    for (size_t i = 0; !rc && i < n; i++) {
        rc = lpips_load_layer(l, t, &plan[i], cin, tap, e);
        tap += plan[i].tap;
        cin = l->layer[i].cout;
    }
    return rc;
}

static enum err_code lpips_build(struct lpips *l, struct err *e)
{
    const struct dev_source src = {.name = "lab/eval/lpips.cl", .text = lpips_cl};
    enum err_code rc = dev_build(l->dev, &src, 1, "", &l->program, e);
    if (!rc)
        rc = dev_kernel(l->program, "lpips_conv", &l->conv, e);
    if (!rc)
        rc = dev_kernel(l->program, "lpips_conv_stride", &l->conv_stride, e);
    if (!rc)
        rc = dev_kernel(l->program, "lpips_pool", &l->pool, e);
    if (!rc)
        rc = dev_kernel(l->program, "lpips_distance", &l->distance, e);
    return rc;
}

enum err_code lpips_open(struct dev *dev, const char *path, enum lpips_range range,
                         struct lpips **out, struct err *e)
{
    struct tensors t;
    *out = NULL;
    enum err_code rc = tensors_read(path, &t, e);
    if (rc)
        return rc;
    struct lpips *l = mem_array(1, sizeof *l);
    if (!l) {
        tensors_free(&t);
        return err_set(e, ERR_MEM, "lpips: out of memory");
    }
    l->dev = dev;
    l->range = range;
    rc = lpips_load(l, &t, e);
    tensors_free(&t);
    if (rc)
        err_add(e, "%s", path);
    else
        rc = lpips_build(l, e);
    if (!rc)
        *out = l;
    else
        lpips_close(&l);
    return rc;
}

void lpips_close(struct lpips **out)
{
    struct lpips *l = *out;
    if (!l)
        return;
    for (size_t i = 0; i < l->n_layers; i++) {
        dev_release(&l->layer[i].weights);
        dev_release(&l->layer[i].bias);
        dev_release(&l->layer[i].lin);
    }
    for (size_t i = 0; i < 4; i++)
        dev_release(&l->map[i / 2][i % 2].mem);
    dev_release(&l->distances.mem);
    cl_kernel kernels[] = {l->conv, l->conv_stride, l->pool, l->distance};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (l->program)
        clReleaseProgram(l->program);
    mem_free(l->host);
    mem_free(l);
    *out = NULL;
}

const char *lpips_key(const struct lpips *l)
{
    if (l->range == LPIPS_UNIT)
        return l->is_vgg ? "lpips_vgg_unit" : "lpips_alex_unit";
    return l->is_vgg ? "lpips_vgg" : "lpips_alex";
}

/* ---- a run ---- */

struct lpips_size {
    int w, h;
};

static size_t lpips_map_floats(struct lpips_size s, int channels)
{
    size_t pitch = 2 * LAYOUT_LPIPS_MARGIN + ((size_t)s.w + 15) / 16 * 16;
    return (size_t)channels * ((size_t)s.h + 2 * LAYOUT_LPIPS_ROWS) * pitch;
}

/* A map of at least so many floats, all zero. */
static enum err_code lpips_clear(struct lpips *l, struct lpips_map *m, size_t floats, struct err *e)
{
    size_t bytes = floats * sizeof(float);
    enum err_code rc = dev_reserve(l->dev, bytes, &m->mem, &m->bytes, e);
    return rc ? rc : dev_zero(l->dev, m->mem, 0, bytes, e);
}

static float lpips_input(const struct lpips *l, double v, int channel)
{
    if (l->range == LPIPS_SIGNED)
        v = 2.0 * v - 1.0;
    return (float)((v - lpips_shift[channel]) / lpips_scale[channel]);
}

/* One picture as the network's input; rgb or target is given. */
static enum err_code lpips_upload(struct lpips *l, struct lpips_map *m, const float *rgb,
                                  const uint8_t *target, const uint8_t *mask, struct lpips_size s,
                                  struct err *e)
{
    size_t floats = lpips_map_floats(s, 3), plane = floats / 3;
    size_t pitch = 2 * LAYOUT_LPIPS_MARGIN + ((size_t)s.w + 15) / 16 * 16;
    if (floats > l->host_floats) {
        mem_free(l->host);
        l->host = mem_array(floats, sizeof *l->host);
        l->host_floats = l->host ? floats : 0;
        if (!l->host)
            return err_set(e, ERR_MEM, "lpips: %d x %d px: out of memory", s.w, s.h);
    }
    memset(l->host, 0, floats * sizeof *l->host);
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < s.h; y++)
            for (int x = 0; x < s.w; x++) {
                size_t pixel = (size_t)y * (size_t)s.w + (size_t)x, at = 3 * pixel + (size_t)c;
                double v = mask && !mask[pixel] ? 0.0
                           : rgb                ? fmin(fmax((double)rgb[at], 0.0), 1.0)
                                                : target[at] / 255.0;
                l->host[(size_t)c * plane + ((size_t)y + LAYOUT_LPIPS_ROWS) * pitch +
                        LAYOUT_LPIPS_MARGIN + (size_t)x] = lpips_input(l, v, c);
            }
    enum err_code rc = lpips_clear(l, m, floats, e);
    return rc ? rc : dev_write(l->dev, m->mem, 0, floats * sizeof *l->host, l->host, e);
}

static void lpips_swap(struct lpips_map *pair)
{
    struct lpips_map keep = pair[0];
    pair[0] = pair[1];
    pair[1] = keep;
}

static enum err_code lpips_run_pool(struct lpips *l, struct lpips_map *pair, int channels,
                                    const struct lpips_plan *p, struct lpips_size from,
                                    struct lpips_size to, struct err *e)
{
    int stride = 2;
    enum err_code rc = lpips_clear(l, &pair[1], lpips_map_floats(to, channels), e);
    if (rc)
        return rc;
    dev_arg(l->pool, 0, pair[0].mem);
    dev_arg(l->pool, 1, pair[1].mem);
    dev_arg(l->pool, 2, channels);
    dev_arg(l->pool, 3, p->pool_k);
    dev_arg(l->pool, 4, from.w);
    dev_arg(l->pool, 5, from.h);
    dev_arg(l->pool, 6, to.w);
    dev_arg(l->pool, 7, to.h);
    dev_arg(l->pool, 8, stride);
    rc = dev_run(l->dev, l->pool, "lpips_pool", (size_t)channels * (size_t)to.w * (size_t)to.h,
                 dev_local(l->dev), e);
    lpips_swap(pair);
    return rc;
}

static enum err_code lpips_run_conv(struct lpips *l, struct lpips_map *pair,
                                    const struct lpips_layer *y, struct lpips_size from,
                                    struct lpips_size to, struct err *e)
{
    bool wide = y->plan.stride == 1;
    cl_kernel k = wide ? l->conv : l->conv_stride;
    size_t groups = ((size_t)y->cout + LAYOUT_LPIPS_CHANNELS - 1) / LAYOUT_LPIPS_CHANNELS;
    size_t vw = wide ? l->dev->vector_width : 1, blocks = ((size_t)to.w + vw - 1) / vw;
    enum err_code rc = lpips_clear(l, &pair[1], lpips_map_floats(to, y->cout), e);
    if (rc)
        return rc;
    dev_arg(k, 0, pair[0].mem);
    dev_arg(k, 1, y->weights);
    dev_arg(k, 2, y->bias);
    dev_arg(k, 3, pair[1].mem);
    dev_arg(k, 4, y->cin);
    dev_arg(k, 5, y->cout);
    dev_arg(k, 6, y->plan.k);
    dev_arg(k, 7, y->plan.pad);
    dev_arg(k, 8, from.w);
    dev_arg(k, 9, from.h);
    dev_arg(k, 10, to.w);
    dev_arg(k, 11, to.h);
    if (!wide)
        dev_arg(k, 12, y->plan.stride);
    rc = dev_run(l->dev, k, wide ? "lpips_conv" : "lpips_conv_stride",
                 groups * blocks * (size_t)to.h, dev_local(l->dev), e);
    lpips_swap(pair);
    return rc;
}

/* Mean weighted distance of the two maps at hand. */
static enum err_code lpips_compare(struct lpips *l, const struct lpips_layer *y,
                                   struct lpips_size s, double *out, struct err *e)
{
    size_t n = (size_t)s.w * (size_t)s.h;
    enum err_code rc = lpips_clear(l, &l->distances, n, e);
    float *host = mem_array(n, sizeof *host);
    if (!rc && !host)
        rc = err_set(e, ERR_MEM, "lpips: out of memory");
    if (!rc) {
        dev_arg(l->distance, 0, l->map[0][0].mem);
        dev_arg(l->distance, 1, l->map[1][0].mem);
        dev_arg(l->distance, 2, y->lin);
        dev_arg(l->distance, 3, l->distances.mem);
        dev_arg(l->distance, 4, y->cout);
        dev_arg(l->distance, 5, s.w);
        dev_arg(l->distance, 6, s.h);
        rc = dev_run(l->dev, l->distance, "lpips_distance", n, dev_local(l->dev), e);
    }
    if (!rc)
        rc = dev_read(l->dev, l->distances.mem, 0, n * sizeof *host, host, e);
    double sum = 0.0;
    for (size_t i = 0; !rc && i < n; i++)
        sum += (double)host[i];
    *out += sum / (double)n;
    mem_free(host);
    return rc;
}

static enum err_code lpips_run_layer(struct lpips *l, const struct lpips_layer *y,
                                     struct lpips_size *s, double *out, struct err *e)
{
    const struct lpips_plan *p = &y->plan;
    struct lpips_size pooled = *s, to;
    if (p->pool_k) {
        pooled.w = (s->w - p->pool_k) / 2 + 1;
        pooled.h = (s->h - p->pool_k) / 2 + 1;
    }
    to.w = (pooled.w + 2 * p->pad - p->k) / p->stride + 1;
    to.h = (pooled.h + 2 * p->pad - p->k) / p->stride + 1;
    if (s->w < p->pool_k || s->h < p->pool_k || pooled.w + 2 * p->pad < p->k ||
        pooled.h + 2 * p->pad < p->k)
        return err_set(e, ERR_ARG, "lpips: the picture is too small for the network");
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 2; i++) {
        if (p->pool_k)
            rc = lpips_run_pool(l, l->map[i], y->cin, p, *s, pooled, e);
        if (!rc)
            rc = lpips_run_conv(l, l->map[i], y, pooled, to, e);
    }
    *s = to;
    return !rc && p->tap ? lpips_compare(l, y, to, out, e) : rc;
}

enum err_code lpips_run(struct lpips *l, const float *rgb, const uint8_t *target,
                        const uint8_t *mask, uint32_t width_px, uint32_t height_px, double *out,
                        struct err *e)
{
    struct lpips_size s = {(int)width_px, (int)height_px};
    *out = 0.0;
    if (!width_px || !height_px || width_px > INT16_MAX || height_px > INT16_MAX)
        return err_set(e, ERR_ARG, "lpips: impossible picture of %u x %u px", width_px, height_px);
    enum err_code rc = lpips_upload(l, &l->map[0][0], rgb, NULL, mask, s, e);
    if (!rc)
        rc = lpips_upload(l, &l->map[1][0], NULL, target, mask, s, e);
    for (size_t i = 0; !rc && i < l->n_layers; i++)
        rc = lpips_run_layer(l, &l->layer[i], &s, out, e);
    return rc;
}
