/* The similarity loss in training: embeddings come to the host, their gradient goes into Adam's
 * moments, where the step that follows takes it up (similarity_loss.cl says why that is right).
 *
 * Owns its kernels and one buffer of rows, which serves both ways.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "core/layout.h"
#include "train/regular.h"

extern const char similarity_loss_cl[];

enum { SIMILARITY_LOCAL = 64 };

struct similarity_step {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel pack, add;
    cl_mem rows;
    size_t floats; /* room in rows */
};

void similarity_step_close(struct similarity_step **p)
{
    struct similarity_step *s = *p;
    if (!s)
        return;
    if (s->pack)
        clReleaseKernel(s->pack);
    if (s->add)
        clReleaseKernel(s->add);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->rows);
    mem_free(s);
    *p = NULL;
}

enum err_code similarity_step_open(struct dev *dev, struct similarity_step **out, struct err *e)
{
    const struct dev_source source = {"train/similarity_loss.cl", similarity_loss_cl};
    struct similarity_step *s = mem_array(1, sizeof(*s));
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "similarity: out of memory");
    s->dev = dev;
    enum err_code rc = dev_build(dev, &source, 1, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "similarity_pack", &s->pack, e);
    if (!rc)
        rc = dev_kernel(s->program, "similarity_add", &s->add, e);
    if (rc)
        similarity_step_close(&s);
    *out = s;
    return rc;
}

static enum err_code similarity_download(struct similarity_step *s, const struct render_model *m,
                                         uint32_t first, float *rows, struct err *e)
{
    cl_uint n = m->n, planes = m->planes, at = first, len = m->planes - first;
    size_t floats = (size_t)m->n * (3 + len);
    enum err_code rc = ERR_OK;
    if (floats > s->floats) {
        dev_release(&s->rows);
        s->floats = 0;
        rc = dev_buffer(s->dev, floats * sizeof(float), NULL, &s->rows, e);
        s->floats = rc ? 0 : floats;
    }
    if (rc)
        return rc;
    cl_int bad = dev_arg(s->pack, 0, m->params);
    bad |= dev_arg(s->pack, 1, n);
    bad |= dev_arg(s->pack, 2, planes);
    bad |= dev_arg(s->pack, 3, at);
    bad |= dev_arg(s->pack, 4, len);
    bad |= dev_arg(s->pack, 5, s->rows);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "similarity_pack: arguments: %s", dev_error_name(bad));
    rc = dev_run(s->dev, s->pack, "similarity_pack", n, SIMILARITY_LOCAL, e);
    return rc ? rc : dev_read(s->dev, s->rows, 0, floats * sizeof(float), rows, e);
}

static enum err_code similarity_upload(struct similarity_step *s, const struct render_model *m,
                                       const struct render_adam *adam, uint32_t first,
                                       const float *grad, struct err *e)
{
    cl_uint n = m->n, planes = m->planes, at = first, len = m->planes - first;
    cl_float k1 = (1.0f - adam->beta1) / adam->beta1, k2 = (1.0f - adam->beta2) / adam->beta2;
    enum err_code rc = dev_write(s->dev, s->rows, 0, (size_t)m->n * len * sizeof(*grad), grad, e);
    cl_int bad = dev_arg(s->add, 0, s->rows);
    bad |= dev_arg(s->add, 1, n);
    bad |= dev_arg(s->add, 2, planes);
    bad |= dev_arg(s->add, 3, at);
    bad |= dev_arg(s->add, 4, len);
    bad |= dev_arg(s->add, 5, k1);
    bad |= dev_arg(s->add, 6, k2);
    bad |= dev_arg(s->add, 7, adam->m1);
    bad |= dev_arg(s->add, 8, adam->m2);
    if (!rc && bad != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "similarity_add: arguments: %s", dev_error_name(bad));
    return rc ? rc : dev_run(s->dev, s->add, "similarity_add", n, SIMILARITY_LOCAL, e);
}

enum err_code similarity_step_run(struct similarity_step *s, const struct render_model *m,
                                  const struct render_adam *adam,
                                  const struct similarity_loss_input *like, double *loss,
                                  struct err *e)
{
    uint32_t first = render_planes(m->sh_degree), len = m->planes - first;
    size_t n = m->n, row = 3 + len;
    struct similarity_loss_input in = *like;
    *loss = 0.0;
    if (!len || !n)
        return ERR_OK;
    if (!(adam->beta1 > 0.0f) || !(adam->beta2 > 0.0f))
        return err_set(e, ERR_ARG, "similarity: Adam without momentum has no place for it");
    float *rows = mem_array(n, row * sizeof(*rows)), *mean = mem_array(n, 3 * sizeof(*mean)),
          *embed = mem_array(n, len * sizeof(*embed)), *grad = mem_array(n, len * sizeof(*grad));
    enum err_code rc = rows && mean && embed && grad
                           ? similarity_download(s, m, first, rows, e)
                           : err_set(e, ERR_MEM, "similarity: out of memory for %zu Gaussians", n);
    for (size_t i = 0; !rc && i < n; i++) {
        for (size_t k = 0; k < 3; k++)
            mean[3 * i + k] = rows[i * row + k];
        for (size_t k = 0; k < len; k++)
            embed[i * len + k] = rows[i * row + 3 + k];
    }
    in.mean_m = mean;
    in.embed = embed;
    in.n = n;
    in.len = len;
    if (!rc)
        rc = similarity_loss_run(&in, loss, grad, e);
    if (!rc)
        rc = similarity_upload(s, m, adam, first, grad, e);
    mem_free(rows);
    mem_free(mean);
    mem_free(embed);
    mem_free(grad);
    return rc;
}
