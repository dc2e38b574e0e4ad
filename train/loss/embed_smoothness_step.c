/* The smoothness loss in training. The host reads the embeddings in place and adds their gradient,
 * in pieces, to Adam's moments. The next step then applies it (embed_smoothness.cl explains why
 * this is correct).
 *
 * It owns its kernel and a buffer for one piece.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "core/layout.h"
#include "train/loss/embed_smoothness.h"

extern const char vector_cl[], adam_cl[], embed_smoothness_cl[];

enum { EMBED_SMOOTHNESS_PIECE = 16384 /* rows: whole groups */ };
#define EMBED_SMOOTHNESS_SALT 0x80000000u /* no step is as high */

struct embed_smoothness_step {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel add;
    cl_mem rows; /* float [EMBED_SMOOTHNESS_PIECE][len] */
    uint32_t len;
};

void embed_smoothness_step_close(struct embed_smoothness_step **p)
{
    struct embed_smoothness_step *s = *p;
    if (!s)
        return;
    if (s->add)
        clReleaseKernel(s->add);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->rows);
    mem_free(s);
    *p = NULL;
}

enum err_code embed_smoothness_step_open(struct dev *dev, struct embed_smoothness_step **out,
                                         struct err *e)
{
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"render/adam.cl", adam_cl},
                                         {"train/loss/embed_smoothness.cl", embed_smoothness_cl}};
    struct embed_smoothness_step *s = mem_array(1, sizeof *s);
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "embed_smoothness: out of memory");
    s->dev = dev;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "embed_smoothness_add", &s->add, e);
    if (rc)
        embed_smoothness_step_close(&s);
    *out = s;
    return rc;
}

static enum err_code step_reserve(struct embed_smoothness_step *s, uint32_t len, struct err *e)
{
    if (s->len == len)
        return ERR_OK;
    dev_release(&s->rows);
    s->len = 0;
    enum err_code rc =
        dev_buffer(s->dev, EMBED_SMOOTHNESS_PIECE * len * sizeof(float), NULL, &s->rows, e);
    s->len = rc ? 0 : len;
    return rc;
}

/* Gradients of `count` rows from `row` on into the moments. */
static enum err_code step_add(struct embed_smoothness_step *s, const struct render_model *m,
                              const struct render_adam *adam, size_t row, size_t count,
                              const float *grad, struct err *e)
{
    cl_uint from = (cl_uint)row, n = (cl_uint)count, planes = m->planes, len = s->len,
            at = m->planes - len, salt = adam->step ^ EMBED_SMOOTHNESS_SALT;
    cl_float k1 = (1.0f - adam->beta1) / adam->beta1, k2 = (1.0f - adam->beta2) / adam->beta2;
    enum err_code rc = dev_write(s->dev, s->rows, 0, count * len * sizeof *grad, grad, e);
    cl_int bad = dev_arg(s->add, 0, s->rows);
    bad |= dev_arg(s->add, 1, from);
    bad |= dev_arg(s->add, 2, n);
    bad |= dev_arg(s->add, 3, planes);
    bad |= dev_arg(s->add, 4, at);
    bad |= dev_arg(s->add, 5, len);
    bad |= dev_arg(s->add, 6, k1);
    bad |= dev_arg(s->add, 7, k2);
    bad |= dev_arg(s->add, 8, salt);
    bad |= dev_arg(s->add, 9, adam->moments);
    if (!rc && bad != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "embed_smoothness_add: arguments: %s", dev_error_name(bad));
    const uint32_t width = s->dev->vector_width;
    return rc ? rc
              : dev_run(s->dev, s->add, "embed_smoothness_add", (n + width - 1) / width,
                        dev_local(s->dev), e);
}

static enum err_code step_launch(struct embed_smoothness_step *s, const struct render_model *m,
                                 const struct render_adam *adam,
                                 const struct embed_smoothness_input *in, double *loss,
                                 struct err *e)
{
    struct embed_smoothness *w = NULL;
    float *grad = mem_array(EMBED_SMOOTHNESS_PIECE, in->len * sizeof *grad);
    enum err_code rc = grad ? step_reserve(s, (uint32_t)in->len, e)
                            : err_set(e, ERR_MEM, "embed_smoothness: out of memory");
    if (!rc)
        rc = embed_smoothness_open(in, &w, loss, e);
    for (size_t i = 0; !rc && i < in->n; i += EMBED_SMOOTHNESS_PIECE) {
        size_t count = in->n - i < EMBED_SMOOTHNESS_PIECE ? in->n - i : EMBED_SMOOTHNESS_PIECE;
        embed_smoothness_rows(w, i, count, grad);
        rc = step_add(s, m, adam, i, count, grad, e);
    }
    embed_smoothness_close(&w);
    mem_free(grad);
    return rc;
}

enum err_code embed_smoothness_step_run(struct embed_smoothness_step *s,
                                        const struct render_model *m,
                                        const struct render_adam *adam,
                                        const struct embed_smoothness_input *like, double *loss,
                                        struct err *e)
{
    const size_t n = m->n, embed = layout_planes(m->sh_degree, 0), group = m->planes * LAYOUT_LANES;
    struct embed_smoothness_input in = *like;
    struct err why = {0};
    void *params = NULL;
    *loss = 0.0;
    if (!m->embed_len || !n)
        return ERR_OK;
    if (!(adam->beta1 > 0.0f) || !(adam->beta2 > 0.0f))
        return err_set(e, ERR_ARG, "embed_smoothness: Adam without momentum has no place for it");
    float *mean = mem_array(n, 3 * sizeof *mean);
    enum err_code rc =
        mean ? dev_map(s->dev, m->params, CL_MAP_READ, layout_floats(n, m->planes) * sizeof(float),
                       &params, e)
             : err_set(e, ERR_MEM, "embed_smoothness: out of memory for %zu Gaussians", n);
    for (size_t i = 0; !rc && i < n; i++)
        for (size_t k = 0; k < 3; k++)
            mean[3 * i + k] = ((const float *)params)[layout_at(i, m->planes) + k * LAYOUT_LANES];
    if (!rc) {
        in.mean_m = mean;
        in.embed = (const float *)params + embed * LAYOUT_LANES;
        in.embed_group = group;
        in.embed_lane = 1;
        in.embed_next = LAYOUT_LANES;
        in.n = n;
        in.len = m->embed_len;
        rc = step_launch(s, m, adam, &in, loss, e);
    }
    enum err_code done = dev_unmap(s->dev, m->params, &params, &why);
    mem_free(mean);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}
